"""Contrastive training of the two encoders, and their files.

The loss is symmetric InfoNCE: each image must find its own touch in the batch, and each touch its image.

Large batches use gradient caching (Gao et al. 2021, "Scaling deep contrastive learning batch size under memory limited
setup"). The loss couples all rows only through their embeddings: embed chunk by chunk without a graph, take the
gradient with respect to all embeddings, then embed each chunk again with a graph and propagate its part of the
gradient. This costs one more forward pass and the memory of one chunk. Batch normalisation uses the statistics of the
chunk in both passes (the "ghost batch" of Hoffer et al. 2017), so the gradients are exactly those of a batch whose
chunks are embedded separately; running statistics are updated once per chunk, in the second pass.

Training runs for a number of steps or minutes and resumes from a checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from math import cos, pi
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS
from hnf_core.errors import FileError, UsageError, WeightsError
from hnf_core.files import content_hash, write_bytes, write_text
from hnf_core.material.shared_space import SharedSpace, save_space
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_core.tactile.views import VIEW_PIXELS
from hnf_core.training.fit import Checkpoint, load_checkpoint, save_checkpoint

from .encoders import (
    RESNET50,
    Architecture,
    Batch,
    Encoder,
    HeadArchitecture,
    ResNetEncoder,
    StatisticsEncoder,
    compute_varied_statistics,
    embed_touches,
    load_backbone,
    make_encoder,
    make_training_batch,
)
from .inputs import GeneratedImagePairs, Tuples

TEMPERATURE = 0.07
"""Temperature, as in CMC (Tian et al. 2020) and the paper."""


def compute_info_nce(vision: Tensor, touch: Tensor, temperature: float = TEMPERATURE) -> Tensor:
    """Return the symmetric InfoNCE loss of a batch, a scalar.

    Parameters
    ----------
    vision, touch
        (n, d) unit vectors; row i of one belongs to row i of the other.
    temperature
        Divisor of the cosines.

    Notes
    -----
    The loss is the mean of −log p(touch i | vision i) and −log p(vision i | touch i) (van den Oord et al. 2018), with p
    the
    softmax of the cosines over the temperature. It is computed by log-sum-exp in float32 at least, whatever autocast is
    set, so that no exponential of a logit is formed. It never reaches 0: n orthogonal rows give
    log(1 + (n − 1) exp(−1 / temperature)).
    """
    with torch.autocast(vision.device.type, enabled=False):
        dtype = torch.promote_types(torch.promote_types(vision.dtype, touch.dtype), torch.float32)
        logits = vision.to(dtype) @ touch.to(dtype).T / temperature
        matching = logits.diagonal()
        return (0.5 * (logits.logsumexp(dim=0) + logits.logsumexp(dim=1)) - matching).mean()


Loss = Callable[..., Tensor]


def backward_with_gradient_cache(
    encoders: Sequence[nn.Module], inputs: Sequence[Tensor], loss: Loss, chunk: int
) -> Tensor:
    """Add the gradients of loss(encoders[0](inputs[0]), encoders[1](inputs[1]), …) to the parameters.

    Parameters
    ----------
    encoders
        Networks that return the same output for the same input (no dropout).
    inputs
        One (n, …) tensor per encoder.
    loss
        Function of all embeddings.
    chunk
        Number of rows embedded at once.

    Returns
    -------
    Tensor
        The detached loss.
    """
    embedded = []
    with torch.no_grad():
        for encoder, batch in zip(encoders, inputs, strict=True):
            with freeze_running_statistics(encoder):
                embedded.append(torch.cat([encoder(rows) for rows in torch.split(batch, chunk)]))
    leaves = [embedding.requires_grad_() for embedding in embedded]
    value = loss(*leaves)
    gradients = torch.autograd.grad(value, leaves)
    for encoder, batch, gradient in zip(encoders, inputs, gradients, strict=True):
        for rows, rows_gradient in zip(torch.split(batch, chunk), torch.split(gradient, chunk), strict=True):
            encoder(rows).backward(rows_gradient)
    return value.detach()


@contextmanager
def freeze_running_statistics(network: nn.Module) -> Iterator[None]:
    """Keep batch normalisation in training mode without updating its running statistics."""
    tracking = [module for module in network.modules() if isinstance(module, _BatchNorm) and module.track_running_stats]
    training = [module for module in tracking if module.training]
    for module in training:
        module.track_running_stats = False
    try:
        yield
    finally:
        for module in training:
            module.track_running_stats = True


Float = NDArray[np.float64]
Rows = NDArray[np.int64]
PIECE_TEMPERATURE = 0.1
"""Temperature of the loss of views of one piece."""
ProgressCallback = Callable[[float, float], None]
CHECKPOINT_INTERVAL_S = 240.0
"""Time between checkpoints [s]."""


@dataclass(frozen=True)
class Recipe:
    """Hyperparameters of a training.

    Attributes
    ----------
    pixels
        Side of the crop of a view.
    batch
        Number of tuples that are contrasted.
    chunk
        Number of them embedded at once; with cached gradients if smaller than the batch.
    rate
        Peak learning rate of AdamW: linear warm-up over the fraction `warmup` of the run, then half a cosine to 0.
    decay
        Weight decay.
    steps
        Number of steps after which training ends.
    minutes
        Time after which training ends, if earlier; the rate then follows the clock and runs are not reproducible.
    piece_weight
        Of heads: weight of the loss that other views of a piece are alike, for looks and for touches, beside that of
        looks and touches. It keeps what only one of them shows, as color.
    """

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
    piece_weight: float = 0.0
    architecture: Architecture | HeadArchitecture = field(default_factory=lambda: RESNET50)

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise UsageError("a training needs an end.", remedy="Say how many minutes or steps.")
        if self.batch < 2 or self.chunk < 2 or self.pixels < 32:
            raise UsageError("a batch and a chunk need two tuples at least, a picture 32 pixels.")

    def compute_progress(self, steps: int, seconds: float) -> float:
        """Return the progress, 0 at the start and 1 at the end."""
        fractions = [
            0.0 if self.steps is None else steps / max(self.steps, 1),
            0.0 if self.minutes is None else seconds / max(60.0 * self.minutes, 1e-9),
        ]
        return min(max(fractions), 1.0)

    def compute_learning_rate(self, progress: float) -> float:
        """Return the learning rate at a progress."""
        if progress < self.warmup:
            return self.rate * (progress / self.warmup + 0.01)
        return self.rate * 0.5 * (1.0 + cos(pi * (progress - self.warmup) / (1.0 - self.warmup)))


@dataclass(frozen=True)
class FitResult:
    """Trained encoders in evaluation mode. history: (steps, 3) step, seconds of training so far, loss."""

    vision: Encoder
    touch: Encoder
    history: Float


def fit_encoders(
    tuples: Tuples,
    recipe: Recipe,
    checkpoint: Path | None = None,
    watch: ProgressCallback = lambda *_: None,
    start: Mapping[str, torch.Tensor] | None = None,
    get_look: Callable[[int], Batch] | None = None,
) -> FitResult:
    """Train two encoders on tuples; labels are not used.

    Parameters
    ----------
    tuples
        Training tuples.
    recipe
        Hyperparameters.
    checkpoint
        File to resume from and to write every few minutes; one of another recipe or other tuples is ignored.
    watch
        Progress callback (progress, loss), called after every step.
    start
        State dict of a backbone from which both encoders start (ImageNet weights).
    get_look
        Statistics of the tuples by the number of the variation, if they are known already.

    Returns
    -------
    FitResult
        Encoders and history.

    Raises
    ------
    UsageError
        If there are fewer tuples than a batch.
    """
    if len(tuples) < recipe.batch:
        raise UsageError(
            f"{len(tuples)} tuples are fewer than a batch of {recipe.batch}.", remedy="Take a smaller one."
        )
    run = _TrainingRun(tuples, recipe, get_look)
    fingerprint = content_hash(repr(asdict(recipe)), tuples.row.tobytes(), tuples.sensor.tobytes())
    stored = None if checkpoint is None else load_checkpoint(checkpoint, fingerprint)
    if stored is not None:
        run.restore_checkpoint(stored)
    elif start is not None:
        for encoder in (run.vision, run.touch):
            if isinstance(encoder, ResNetEncoder):
                load_backbone(encoder, start, "the trunk to start from")
    saved_at = time.monotonic()
    while (progress := recipe.compute_progress(len(run.history), run.seconds)) < 1.0:
        loss = run.step(progress)
        watch(progress, loss)
        if checkpoint is not None and time.monotonic() - saved_at > CHECKPOINT_INTERVAL_S:
            save_checkpoint(checkpoint, run.make_checkpoint(), fingerprint)
            saved_at = time.monotonic()
    return FitResult(run.vision.eval(), run.touch.eval(), np.array(run.history).reshape(-1, 3))


def set_torch_threads(threads: int) -> str:
    """Set the number of threads of torch; return its version."""
    torch.set_num_threads(threads)
    return str(torch.__version__)


def _index_pieces(group: Rows) -> tuple[Rows, Rows, Rows, Rows]:
    """Return for each row where its group starts in `order`, the group's size, `order`, and the row's place in it."""
    order = np.argsort(group, kind="stable")
    _, index, size = np.unique(group, return_inverse=True, return_counts=True)
    start = (np.cumsum(size) - size)[index]
    position = np.empty(len(group), dtype=np.int64)
    position[order] = np.arange(len(group)) - start[order]
    return start, size[index], order, position


class _TrainingRun:
    """State of a training."""

    def __init__(self, tuples: Tuples, recipe: Recipe, get_look: Callable[[int], Batch] | None = None) -> None:
        torch.manual_seed(recipe.seed)
        self.tuples, self.recipe = tuples, recipe
        self.vision, self.touch = (make_encoder(recipe.architecture).train() for _ in range(2))
        self.get_look = get_look or lru_cache(partial(compute_varied_statistics, tuples, recipe.seed))
        if isinstance(self.vision, StatisticsEncoder) and isinstance(self.touch, StatisticsEncoder):
            first = self._get_look(0)
            self.pieces = _index_pieces(tuples.group)
            self.vision.standardise(first.vision)
            self.touch.standardise(first.touch)
        self.history: list[tuple[float, float, float]] = []
        self.seconds = 0.0
        parameters = [*self.vision.parameters(), *self.touch.parameters()]
        # Weight decay applies to matrices only, not to biases or normalisation.
        groups = [
            {"params": [parameter for parameter in parameters if parameter.ndim > 1], "weight_decay": recipe.decay},
            {"params": [parameter for parameter in parameters if parameter.ndim <= 1], "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=recipe.rate, fused=True)

    def step(self, progress: float) -> float:
        """Train on one batch and return the loss."""
        start, recipe, number = time.monotonic(), self.recipe, len(self.history)
        for group in self.optimiser.param_groups:
            group["lr"] = recipe.compute_learning_rate(progress)
        rng = np.random.default_rng([recipe.seed, 1, number])
        chosen = self._select_rows(number)
        self.optimiser.zero_grad(set_to_none=True)
        if isinstance(self.vision, StatisticsEncoder) and isinstance(self.touch, StatisticsEncoder):
            loss = self._backward_heads((self.vision, self.touch), chosen, number, rng)
        else:
            batch = make_training_batch(self.tuples, chosen, recipe.pixels, rng)
            with torch.autocast("cpu", torch.bfloat16):
                loss = self._backward([batch.vision, batch.touch])
        self.optimiser.step()
        self.seconds += time.monotonic() - start
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

    def _backward_heads(
        self, heads: tuple[StatisticsEncoder, StatisticsEncoder], chosen: Rows, number: int, rng: np.random.Generator
    ) -> float:
        epoch, weight = number // (len(self.tuples) // self.recipe.batch), self.recipe.piece_weight
        look = self._get_look(epoch)
        torch.manual_seed(int(rng.integers(2**31)))  # dropout draws alike after a kill
        features = [
            head.pool_features(each[chosen]) for head, each in zip(heads, (look.vision, look.touch), strict=True)
        ]
        vision, touch = (head.project(x) for head, x in zip(heads, features, strict=True))
        loss = compute_info_nce(vision, touch, self.recipe.temperature)
        if weight:
            other, partner = self._get_look(epoch + 1), self._draw_partners(chosen, rng)
            for head, x, each in zip(heads, features, (other.vision, other.touch), strict=True):
                alike = head.project_piece(x), head.project_piece(head.pool_features(each[partner]))
                loss = loss + weight * compute_info_nce(*alike, PIECE_TEMPERATURE)
        loss.backward()  # type: ignore[no-untyped-call]
        return float(loss.detach())

    def _draw_partners(self, chosen: Rows, rng: np.random.Generator) -> Rows:
        """Return for each row another one of the same piece, or itself if there is none."""
        start, size, order, position = self.pieces
        step = np.where(size[chosen] > 1, rng.integers(1, np.maximum(size[chosen], 2)), 0)
        return np.asarray(order[start[chosen] + (position[chosen] + step) % size[chosen]])

    def _get_look(self, epoch: int) -> Batch:
        """Return the statistics of all tuples, as they are varied in an epoch; variations come round again."""
        assert isinstance(self.recipe.architecture, HeadArchitecture)
        return self.get_look(epoch % self.recipe.architecture.looks)

    def _select_rows(self, number: int) -> NDArray[np.int64]:
        """Return the rows of one batch; every epoch permutes all tuples and omits the last incomplete batch."""
        epoch, index = divmod(number, len(self.tuples) // self.recipe.batch)
        order = np.random.default_rng([self.recipe.seed, 0, epoch]).permutation(len(self.tuples))
        return order[index * self.recipe.batch : (index + 1) * self.recipe.batch]

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
        # The fused optimiser needs moments with the memory layout of their parameters.
        parameters = [parameter for group in self.optimiser.param_groups for parameter in group["params"]]
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, index, key = name.split(".")
                moment = torch.empty(()) if key == "step" else torch.empty_like(parameters[int(index)])
                state.setdefault(int(index), {})[key] = moment.copy_(value.reshape(moment.shape))
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": state})
        self.seconds = float(tensors["seconds"].item())
        self.history = [tuple(row) for row in found.history.tolist()]


MODEL_FORMAT = "hnf-alignment-1"
RECORD_FILE = "alignment.json"


@dataclass(frozen=True)
class AlignedEncoders:
    """Frozen encoders with the side of their crops, and the contents of RECORD_FILE."""

    vision: Encoder
    touch: Encoder
    pixels: int
    record: Mapping[str, Any]

    @property
    def sensor(self) -> str:
        """Sensor of the training tuples: gelsight, digit or both."""
        return str(self.record["sensor"])


STATISTICS_RECIPE = MappingProxyType(
    {
        "pixels": VIEW_PIXELS,
        "batch": 1024,
        "chunk": 1024,
        "rate": 2e-3,
        "piece_weight": 0.2,
        "architecture": HeadArchitecture(),
    }
)
"""Settings of the recipe of heads on texture statistics."""


def save_encoders(folder: Path, fitted: FitResult, recipe: Recipe, details: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write vision.safetensors, touch.safetensors and RECORD_FILE; return the record.

    The record holds `details` (sensor and others), the recipe, the loss curve and the checksums of the weights. Raises
    FileError.
    """
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
    """Load encoders from a folder.

    Raises
    ------
    FileError
        If the folder holds no such weights.
    WeightsError
        If the weights do not match the record.
    """
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        if record["format"] != MODEL_FORMAT:
            raise ValueError(f"format {record['format']!r}")
        recipe = record["recipe"]
        shape = recipe["architecture"]
        architecture = (
            Architecture(tuple(shape["blocks"]), int(shape["width"]), int(shape["outputs"]))
            if "blocks" in shape
            else HeadArchitecture(int(shape["hidden"]), outputs=int(shape["outputs"]))
        )
        data = {name: (folder / f"{name}.safetensors").read_bytes() for name in ("vision", "touch")}
        states = {name: load_tensors(content)[0] for name, content in data.items()}
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
        encoder = make_encoder(architecture)
        try:
            encoder.load_state_dict({key: torch.from_numpy(np.array(value)) for key, value in state.items()})
        except RuntimeError as error:
            raise WeightsError(f"{name}.safetensors does not fit its record.", where=str(folder)) from error
        encoders[name] = encoder.eval()
    return AlignedEncoders(encoders["vision"], encoders["touch"], pixels, record)


SPACE_FILE = "space.safetensors"


def save_shared_space(path: Path, models: AlignedEncoders, tuples: Tuples, seed: int = 0) -> bool:
    """Write the heads and the labelled GelSight tuples of generated pairs as one file for `hnf describe --space`.

    Return False, and write nothing, for other encoders or tuples: only generated pairs have tokens and a scale.
    """
    heads = {"vision": models.vision, "touch": models.touch}
    pictures = tuples.images
    if not isinstance(pictures, GeneratedImagePairs) or not all(
        isinstance(head, StatisticsEncoder) for head in heads.values()
    ):
        return False
    found = tuples.select((tuples.label >= 0) & (tuples.sensor == PAIR_SENSORS.index("gelsight")))
    if not len(found):
        return False
    pairs = pictures.pairs
    tiles, tile_index = np.unique(pairs.tile_index[found.row], return_inverse=True)
    space = SharedSpace(
        {name: head.export() for name, head in heads.items() if isinstance(head, StatisticsEncoder)},
        embed_touches(models.touch, found, models.pixels, seed).points, pairs.pitch_index[found.row],
        tile_index.astype(np.int64), pairs.token[tiles], tuple(pairs.class_name[tile] for tile in tiles),
        {"trained_on": models.sensor, "data": "generated pairs of this project", "seed": str(seed)},
    )  # fmt: skip
    save_space(path, space)
    return True


def _space_indices(count: int, most: int) -> list[int]:
    """Return up to `most` evenly spaced indices below count, including the last."""
    return sorted({count - 1 - (count - 1) * index // most for index in range(most)}) if count else []
