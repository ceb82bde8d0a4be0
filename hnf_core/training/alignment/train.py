"""Both encoders trained together, within a number of steps or of minutes; a killed run goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from math import cos, pi
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ...errors import UsageError
from ...files import content_hash
from ..checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from .batches import make_training_batch
from .encoders import RESNET50, Architecture, ResNetEncoder, load_backbone
from .gradient_cache import backward_with_gradient_cache
from .info_nce import TEMPERATURE, compute_info_nce
from .tuples import Tuples

Float = NDArray[np.float64]
ProgressCallback = Callable[[float, float], None]
CHECKPOINT_INTERVAL_S = 240.0


@dataclass(frozen=True)
class Recipe:
    """pixels: side of what is cut out of a view. batch: tuples that are told apart. chunk: of them embedded at once,
    with gradients cached where that is fewer. rate: of AdamW at its highest: a straight start over `warmup` of the run,
    then half a cosine to 0. decay: of weights. steps: after which it ends. minutes: after which it ends, if earlier;
    the rate then follows the clock, and no two runs are equal."""

    pixels: int = 48
    batch: int = 128
    chunk: int = 128
    rate: float = 1e-3
    warmup: float = 0.05
    decay: float = 0.05
    temperature: float = TEMPERATURE
    steps: int | None = None
    minutes: float | None = None
    seed: int = 0
    architecture: Architecture = field(default_factory=lambda: RESNET50)

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise UsageError("a training needs an end.", remedy="Say how many minutes or steps.")
        if self.batch < 2 or self.chunk < 2 or self.pixels < 32:
            raise UsageError("a batch and a chunk need two tuples at least, a picture 32 pixels.")

    def compute_progress(self, steps: int, seconds: float) -> float:
        """0 at the start, 1 at the end."""
        shares = [
            0.0 if self.steps is None else steps / max(self.steps, 1),
            0.0 if self.minutes is None else seconds / max(60.0 * self.minutes, 1e-9),
        ]
        return min(max(shares), 1.0)

    def compute_learning_rate(self, progress: float) -> float:
        """The learning rate."""
        if progress < self.warmup:
            return self.rate * (progress / self.warmup + 0.01)
        return self.rate * 0.5 * (1.0 + cos(pi * (progress - self.warmup) / (1.0 - self.warmup)))


@dataclass(frozen=True)
class FitResult:
    """vision, touch: in evaluation mode. history: (steps, 3) step, seconds of training so far, loss."""

    vision: ResNetEncoder
    touch: ResNetEncoder
    history: Float


def fit_encoders(
    tuples: Tuples,
    recipe: Recipe,
    checkpoint: Path | None = None,
    watch: ProgressCallback = lambda *_: None,
    start: Mapping[str, torch.Tensor] | None = None,
) -> FitResult:
    """Train two encoders on tuples (their labels are not looked at).

    checkpoint: file to go on from and to write to every few minutes; one of another recipe or of other tuples is passed
    over. watch(progress, loss) after every step. start: state dict of a trunk that both encoders start from
    (ImageNet's). Raises UsageError for fewer tuples than a batch.
    """
    if len(tuples) < recipe.batch:
        raise UsageError(
            f"{len(tuples)} tuples are fewer than a batch of {recipe.batch}.", remedy="Take a smaller one."
        )
    run = _TrainingRun(tuples, recipe)
    fingerprint = content_hash(repr(asdict(recipe)), tuples.row.tobytes(), tuples.sensor.tobytes())
    found = None if checkpoint is None else load_checkpoint(checkpoint, fingerprint)
    if found is not None:
        run.restore_checkpoint(found)
    elif start is not None:
        for encoder in (run.vision, run.touch):
            load_backbone(encoder, start, "the trunk to start from")
    written = time.monotonic()
    while (progress := recipe.compute_progress(len(run.history), run.seconds)) < 1.0:
        loss = run.step(progress)
        watch(progress, loss)
        if checkpoint is not None and time.monotonic() - written > CHECKPOINT_INTERVAL_S:
            save_checkpoint(checkpoint, run.make_checkpoint(), fingerprint)
            written = time.monotonic()
    return FitResult(run.vision.eval(), run.touch.eval(), np.array(run.history).reshape(-1, 3))


def set_torch_threads(threads: int) -> str:
    """Let torch use so many; its version."""
    torch.set_num_threads(threads)
    return str(torch.__version__)


class _TrainingRun:
    """What a step changes."""

    def __init__(self, tuples: Tuples, recipe: Recipe) -> None:
        torch.manual_seed(recipe.seed)
        self.tuples, self.recipe = tuples, recipe
        self.vision, self.touch = (
            ResNetEncoder(recipe.architecture).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
            for _ in range(2)
        )
        self.history: list[tuple[float, float, float]] = []
        self.seconds = 0.0
        parameters = [*self.vision.parameters(), *self.touch.parameters()]
        # Decay is for what multiplies: neither biases nor normalisation.
        groups = [
            {"params": [each for each in parameters if each.ndim > 1], "weight_decay": recipe.decay},
            {"params": [each for each in parameters if each.ndim <= 1], "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=recipe.rate, fused=True)

    def step(self, progress: float) -> float:
        """One batch; the loss."""
        began, recipe, number = time.monotonic(), self.recipe, len(self.history)
        for group in self.optimiser.param_groups:
            group["lr"] = recipe.compute_learning_rate(progress)
        rng = np.random.default_rng([recipe.seed, 1, number])
        batch = make_training_batch(self.tuples, self._select_rows(number), recipe.pixels, rng)
        self.optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16):
            loss = self._backward([batch.vision, batch.touch])
        self.optimiser.step()
        self.seconds += time.monotonic() - began
        self.history.append((number + 1, self.seconds, loss))
        return loss

    def _backward(self, inputs: list[torch.Tensor]) -> float:
        recipe = self.recipe

        def loss(vision: torch.Tensor, touch: torch.Tensor) -> torch.Tensor:
            return compute_info_nce(vision, touch, recipe.temperature)

        if recipe.chunk < recipe.batch:
            return float(backward_with_gradient_cache([self.vision, self.touch], inputs, loss, recipe.chunk))
        value = loss(self.vision(inputs[0]), self.touch(inputs[1]))
        value.backward()  # type: ignore[no-untyped-call]
        return float(value.detach())

    def _select_rows(self, number: int) -> NDArray[np.int64]:
        """Of one batch: every epoch goes through all tuples in an order of its own, the last few left out."""
        epoch, place = divmod(number, len(self.tuples) // self.recipe.batch)
        order = np.random.default_rng([self.recipe.seed, 0, epoch]).permutation(len(self.tuples))
        return order[place * self.recipe.batch : (place + 1) * self.recipe.batch]

    def make_checkpoint(self) -> Checkpoint:
        tensors = {f"vision.{name}": value for name, value in self.vision.state_dict().items()}
        tensors |= {f"touch.{name}": value for name, value in self.touch.state_dict().items()}
        for index, state in self.optimiser.state_dict()["state"].items():
            tensors |= {f"adam.{index}.{name}": torch.as_tensor(value) for name, value in state.items()}
        arrays = {name: value.detach().contiguous().numpy() for name, value in tensors.items()}
        arrays["seconds"] = np.array(self.seconds)
        return Checkpoint(len(self.history), arrays, np.array(self.history))

    def restore_checkpoint(self, found: Checkpoint) -> None:
        tensors = {name: torch.from_numpy(np.array(value)) for name, value in found.tensors.items()}
        for prefix, encoder in (("vision.", self.vision), ("touch.", self.touch)):
            encoder.load_state_dict({n.removeprefix(prefix): v for n, v in tensors.items() if n.startswith(prefix)})
        # The fused optimiser walks through memory: moments must lie as their parameter does.
        parameters = [each for group in self.optimiser.param_groups for each in group["params"]]
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, index, key = name.split(".")
                own = torch.empty(()) if key == "step" else torch.empty_like(parameters[int(index)])
                state.setdefault(int(index), {})[key] = own.copy_(value.reshape(own.shape))
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": state})
        self.seconds = float(tensors["seconds"].item())
        self.history = [tuple(row) for row in found.history.tolist()]
