"""Symmetric InfoNCE: each picture must find its own touch among those of the batch, and each touch its picture.

Gradients of a large contrastive batch in the memory of a small one (Gao et al. 2021, "Scaling deep contrastive
learning batch size under memory limited setup").

The loss couples all rows, but only through their embeddings. So: embed chunk by chunk without a graph; take the loss's
gradient with respect to the embeddings of the whole batch; embed each chunk once more, with a graph, and send its share
of that gradient down. One forward pass more than the plain batch costs, and the graph of one chunk at a time.

Batch normalisation knows its chunk only, in both passes alike (the "ghost batch" of Hoffer et al. 2017): what comes out
are exactly the gradients of a plain batch whose chunks are embedded one by one, and with normalisation that does not
look at the batch (frozen statistics, groups) those of the plain batch itself. Running statistics move once for each
chunk, in the second pass.

Both encoders trained together, within a number of steps or of minutes; a killed run goes on where it was.

Two trained encoders in a folder: weights under the standard names, and how they came about.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from math import cos, pi
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from hnf_core.errors import FileError, UsageError, WeightsError
from hnf_core.files import content_hash, write_bytes, write_text
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_core.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint

from .encoders import RESNET50, Architecture, ResNetEncoder, load_backbone, make_training_batch
from .inputs import Tuples

TEMPERATURE = 0.07
"""As van den Oord et al. (2018) is used by CMC (Tian et al. 2020) and by the paper."""


def compute_info_nce(vision: Tensor, touch: Tensor, temperature: float = TEMPERATURE) -> Tensor:
    """Mean of −log p(touch i | vision i) and −log p(vision i | touch i) over a batch; a scalar.

    vision, touch: (n, d) of length 1; row i of one belongs to row i of the other. p is the softmax of the cosines over
    the temperature. By log-sum-exp, in float32 at least whatever autocast says: no exponential of a logit is ever
    formed, so that neither 1 / 0.07 nor thousands of rows cost precision. 0 is never reached: n rows at right angles
    give log(1 + (n − 1) exp(−1 / temperature)).
    """
    with torch.autocast(vision.device.type, enabled=False):
        wide = torch.promote_types(torch.promote_types(vision.dtype, touch.dtype), torch.float32)
        logits = vision.to(wide) @ touch.to(wide).T / temperature
        right = logits.diagonal()
        return (0.5 * (logits.logsumexp(dim=0) + logits.logsumexp(dim=1)) - right).mean()


Loss = Callable[..., Tensor]


def backward_with_gradient_cache(
    encoders: Sequence[nn.Module], inputs: Sequence[Tensor], loss: Loss, chunk: int
) -> Tensor:
    """Add the gradients of loss(encoders[0](inputs[0]), encoders[1](inputs[1]), …) to the encoders' parameters and
    return the loss, detached.

    inputs: (n, …) each. chunk: rows that are embedded at once. Encoders must give the same answer twice (no dropout).
    """
    embedded = []
    with torch.no_grad():
        for encoder, batch in zip(encoders, inputs, strict=True):
            with freeze_running_statistics(encoder):
                embedded.append(torch.cat([encoder(part) for part in torch.split(batch, chunk)]))
    leaves = [each.requires_grad_() for each in embedded]
    value = loss(*leaves)
    gradients = torch.autograd.grad(value, leaves)
    for encoder, batch, gradient in zip(encoders, inputs, gradients, strict=True):
        for part, share in zip(torch.split(batch, chunk), torch.split(gradient, chunk), strict=True):
            encoder(part).backward(share)
    return value.detach()


@contextmanager
def freeze_running_statistics(network: nn.Module) -> Iterator[None]:
    """Batch normalisation as in training, but its running statistics stay as they are."""
    tracking = [each for each in network.modules() if isinstance(each, _BatchNorm) and each.track_running_stats]
    training = [each for each in tracking if each.training]
    for each in training:
        each.track_running_stats = False
    try:
        yield
    finally:
        for each in training:
            each.track_running_stats = True


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


MODEL_FORMAT = "hnf-alignment-1"
RECORD_FILE = "alignment.json"


@dataclass(frozen=True)
class AlignedEncoders:
    """vision, touch: frozen encoders. pixels: what they were trained on. record: what RECORD says."""

    vision: ResNetEncoder
    touch: ResNetEncoder
    pixels: int
    record: Mapping[str, Any]

    @property
    def sensor(self) -> str:
        """gelsight, digit or both: what its tuples were of."""
        return str(self.record["sensor"])


def save_encoders(folder: Path, fitted: FitResult, recipe: Recipe, details: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write vision.safetensors, touch.safetensors and RECORD, which holds what is `told` (sensor: …), the recipe, the
    curve of the loss and the weights' checksums; return the record. Raises FileError."""
    sums = {}
    for name, encoder in (("vision", fitted.vision), ("touch", fitted.touch)):
        tensors = {key: value.contiguous().numpy() for key, value in encoder.state_dict().items()}
        data = dump_tensors(tensors, {"format": MODEL_FORMAT, "encoder": name})
        write_bytes(folder / f"{name}.safetensors", data)
        sums[name] = hashlib.sha256(data).hexdigest()
    curve = fitted.history[_space_indices(len(fitted.history), 50)]
    record = {
        "format": MODEL_FORMAT, **details, "recipe": asdict(recipe), "steps": len(fitted.history),
        "seconds": round(float(fitted.history[-1, 1]), 1) if len(fitted.history) else 0.0, "sha256": sums,
        "curve": [[int(step), round(seconds, 1), round(loss, 4)] for step, seconds, loss in curve.tolist()],
    }  # fmt: skip
    write_text(folder / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    return record


def load_encoders(folder: Path) -> AlignedEncoders:
    """Raises FileError where the folder holds no such weights, WeightsError where they do not fit the record."""
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        if record["format"] != MODEL_FORMAT:
            raise ValueError(f"format {record['format']!r}")
        recipe = record["recipe"]
        shape = recipe["architecture"]
        architecture = Architecture(tuple(shape["blocks"]), int(shape["width"]), int(shape["outputs"]))
        data = {name: (folder / f"{name}.safetensors").read_bytes() for name in ("vision", "touch")}
        states = {name: load_tensors(each)[0] for name, each in data.items()}
        sums, pixels = record["sha256"], int(recipe["pixels"])
        str(record["sensor"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            f"these are no aligned encoders ({error}).", where=str(folder), remedy="Train them: hnf train alignment."
        ) from error
    encoders = {}
    for name, state in states.items():
        if hashlib.sha256(data[name]).hexdigest() != sums.get(name):
            raise WeightsError(
                f"{name}.safetensors is not the file that {RECORD_FILE} describes.",
                where=str(folder),
                remedy="Train again.",
            )
        encoder = ResNetEncoder(architecture)
        try:
            encoder.load_state_dict({key: torch.from_numpy(np.array(value)) for key, value in state.items()})
        except RuntimeError as error:
            raise WeightsError(f"{name}.safetensors does not fit its record.", where=str(folder)) from error
        encoders[name] = encoder.to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    return AlignedEncoders(encoders["vision"], encoders["touch"], pixels, record)


def _space_indices(count: int, most: int) -> list[int]:
    """Up to `most` of the numbers below count, the last among them."""
    return sorted({count - 1 - (count - 1) * index // most for index in range(most)}) if count else []
