"""Train the encoder E by regression on the band descriptor of the complete tile (`hnf train encoder`).

Batches are membranes of the pairs, rotated, scaled, lit by perturbed lamps and with noise. Every output is in units of
its spread. `train_encoder` goes from a folder of pairs to weights with metrics.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from hnf_core.datasets.tactile_pairs import HELD_OUT_INSTANCES, PAIR_SENSORS, TRAIN, Pairs, load_pairs
from hnf_core.errors import FileError
from hnf_core.material.alexnet_encoder import (
    CONTRAST_FLOOR,
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    LEVEL_INDICES,
    OUTPUT_COUNT,
    AlexNet,
    AlexNetConfig,
    build_view_conditions,
    describe_with_alexnet,
    plane_basis,
)
from hnf_core.material.encoder_registry import Encoder
from hnf_core.material.token import (
    ALEXNET_ID,
    BAND_FEATURES,
)
from hnf_core.tactile.optics import SENSORS, Sensor
from hnf_core.tactile.views import PITCHES_M

from .evaluate import TokenErrors, evaluate_encoder, format_errors
from .network import TorchAlexNet, load_backbone
from .variation import encode_targets, perturb_sensor

Single = NDArray[np.float32]

LAMP_SET_COUNT = 256
"""Number of perturbed sensors of each kind from which batches choose."""
NOMINAL_LAMP_SHARE = 2 / 3
"""Fraction of views under nominal lamps; the others have perturbed lamps."""
BACKGROUND_ERROR = 0.02
NOISE_SHARE, NOISE_LOG10 = 0.5, (-3.5, -1.6)
"""Fraction of views with sensor noise, and range of log10 of its deviation (full scale 1), uniform."""
SCALE_LOG10 = (-0.5, 0.1)
"""Range of log10 of the height factor, uniform, for more levels than the tiles have."""
ROTATED_SHARE = 0.75
"""Fraction of widest views rotated by any angle, since most materials are aligned with their tile."""
UPSAMPLING = 2
FAINT_DECADES = 3.0
"""Levels further below the view's strongest band are clamped to this distance, as they are not visible."""
QUARTER_TURN_SIGNS = np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
MIRROR_SIGNS = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
"""Signs of a band's features under a quarter turn and under a reflection (left and right)."""


@dataclass(frozen=True)
class Batch:
    """Views (n, 3, 64, 64) of contrast 1, conditions (n, CONDITION_COUNT), and targets (n, OUTPUT_COUNT)."""

    views: Tensor
    given: Tensor
    target: Tensor


@dataclass(frozen=True)
class LampSets:
    """Shading (sensors, sets + 1, 3, 3) and ambient (sensors, sets + 1, 3); the last set is nominal."""

    shading: Tensor
    ambient: Tensor
    sensors: tuple[Sensor, ...]


def draw_lamps(seed: int, sets: int = LAMP_SET_COUNT) -> LampSets:
    """Draw perturbed lamps for both sensors."""
    rng = np.random.default_rng(seed)
    sensors = tuple(SENSORS[name] for name in PAIR_SENSORS)
    variants = [[*(perturb_sensor(sensor, rng) for _ in range(sets)), sensor] for sensor in sensors]
    return LampSets(
        torch.tensor(np.array([[variant.shading for variant in row] for row in variants]), dtype=torch.float32),
        torch.tensor(np.array([[variant.ambient for variant in row] for row in variants]), dtype=torch.float32),
        sensors,
    )


def make_batch(pairs: Pairs, rows: NDArray[np.intp], lamps: LampSets, rng: np.random.Generator) -> Batch:
    """Make a batch of the pairs' views (rows) with random augmentation."""
    count = len(rows)
    sensor_index = rng.integers(0, len(PAIR_SENSORS), count)
    pitch = pairs.pitch_index[rows]
    slopes = pairs.slopes[rows, sensor_index].astype(np.float32)
    scale = 10.0 ** rng.uniform(*SCALE_LOG10, count)
    slopes *= scale[:, None, None, None].astype(np.float32)
    for row in np.flatnonzero(pitch == 0):
        # The widest view is the complete periodic tile, so any cyclic shift is valid.
        slopes[row] = np.roll(slopes[row], tuple(rng.integers(0, 64, 2)), axis=(1, 2))
    turn, angle = rng.integers(0, 8, count), rng.uniform(-np.pi / 4.0, np.pi / 4.0, count)
    token = pairs.token[pairs.tile_index[rows]].astype(np.float64)
    slopes, token = apply_symmetry(slopes, token, turn)
    rotated = np.flatnonzero((pitch == 0) & (rng.random(count) < ROTATED_SHARE))
    slopes[rotated], token[rotated] = rotate_views(slopes[rotated], token[rotated], angle[rotated])
    limit = np.array([sensor.max_slope for sensor in lamps.sensors], dtype=np.float32)[sensor_index]
    sets = lamps.shading.shape[1] - 1
    chosen = np.where(rng.random(count) < NOMINAL_LAMP_SHARE, sets, rng.integers(0, sets, count))
    nominal = rng.random(count) < 0.5
    image = shade_views(
        torch.tensor(slopes),
        torch.tensor(limit),
        lamps.shading[sensor_index, chosen],
        lamps.ambient[sensor_index, chosen],
    )
    background_set = np.where(nominal, sets, chosen)
    background = lamps.shading[sensor_index, background_set][:, :, 2] + lamps.ambient[sensor_index, background_set]
    error = 1.0 + BACKGROUND_ERROR * rng.standard_normal((count, 3)) * (chosen != sets)[:, None]
    noise_level = (rng.random(count) < NOISE_SHARE) * 10.0 ** rng.uniform(*NOISE_LOG10, count)
    noise = torch.tensor(rng.standard_normal(image.shape, dtype=np.float32))
    image = image + noise * torch.tensor(noise_level, dtype=torch.float32)[:, None, None, None]
    views, contrast = normalise_views(image, background * torch.tensor(error, dtype=torch.float32))
    given = np.stack(
        [
            build_view_conditions(float(c), lamps.sensors[m], PITCHES_M[p])
            for c, m, p in zip(contrast.numpy(), sensor_index, pitch, strict=True)
        ]
    )
    target = clamp_faint_levels(encode_targets(token, contrast.numpy().astype(np.float64), pitch))
    target[:, LEVEL_INDICES] += np.log10(scale)[:, None]
    return Batch(views, torch.tensor(given), torch.tensor(target, dtype=torch.float32))


def apply_symmetry(
    slopes: Single, token: NDArray[np.float64], turn: NDArray[np.int64]
) -> tuple[Single, NDArray[np.float64]]:
    """Transform slopes (n, 2, 64, 64) and tokens (n, TOKEN_DIM) by symmetries of the square.

    They are mirrored left to right if turn & 4, then rotated counter-clockwise by turn & 3 quarter turns.
    """
    slopes, token = slopes.copy(), token.copy()
    bands = token[:, :-2].reshape(len(token), -1, len(BAND_FEATURES))
    for row, symmetry in enumerate(turn):
        gx, gy = slopes[row]
        if symmetry & 4:
            gx, gy = -gx[:, ::-1], gy[:, ::-1]
            bands[row] *= MIRROR_SIGNS
        for _ in range(int(symmetry) & 3):
            gx, gy = -np.rot90(gy), np.rot90(gx)
            bands[row] *= QUARTER_TURN_SIGNS
        slopes[row] = np.stack([gx, gy])
    token[:, :-2] = bands.reshape(len(token), -1)
    return slopes, token


def rotate_views(
    slopes: Single, token: NDArray[np.float64], angle: NDArray[np.float64]
) -> tuple[Single, NDArray[np.float64]]:
    """Rotate slopes and tokens counter-clockwise by any angle [rad], for tiles that repeat.

    The tile is upsampled by its Fourier series before cubic interpolation, which then hardly affects the shortest band.
    """
    if not len(slopes):
        return slopes, token
    side, half = slopes.shape[-1], slopes.shape[-1] // 2
    fine_side = UPSAMPLING * side
    spectrum = np.fft.rfft2(slopes.astype(np.float64))
    fine_spectrum = np.zeros((*slopes.shape[:2], fine_side, fine_side // 2 + 1), dtype=np.complex128)
    fine_spectrum[..., :half, :half] = spectrum[..., :half, :half]
    fine_spectrum[..., -half + 1 :, :half] = spectrum[..., half + 1 :, :half]
    fine = UPSAMPLING**2 * np.fft.irfft2(fine_spectrum, s=(fine_side, fine_side))
    # Position of a pixel relative to the centre [pixels]: x to the right, y up.
    along = np.arange(side) - (side - 1) / 2.0
    x, y = np.broadcast_arrays(along[None, :], -along[:, None])
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    positions = UPSAMPLING * (np.stack([sin * x - cos * y, cos * x + sin * y], axis=1) + (side - 1) / 2.0)
    sampled = np.empty_like(slopes)
    for index in np.ndindex(slopes.shape[:2]):
        ndimage.map_coordinates(fine[index], positions[index[0]], sampled[index], order=3, mode="grid-wrap")
    gx, gy = sampled[:, 0], sampled[:, 1]
    narrow_cos, narrow_sin = cos.astype(np.float32), sin.astype(np.float32)
    rotated = np.stack([narrow_cos * gx - narrow_sin * gy, narrow_sin * gx + narrow_cos * gy], axis=1)
    bands = token[:, :-2].reshape(len(token), -1, len(BAND_FEATURES)).copy()
    for fold, first in ((2, 1), (4, 3)):
        c, s = np.cos(fold * angle)[:, None], np.sin(fold * angle)[:, None]
        even, odd = bands[:, :, first].copy(), bands[:, :, first + 1].copy()
        bands[:, :, first], bands[:, :, first + 1] = c * even - s * odd, s * even + c * odd
    return rotated, np.concatenate([bands.reshape(len(token), -1), token[:, -2:]], axis=1)


def shade_views(slopes: Tensor, limit: Tensor, shading: Tensor, ambient: Tensor) -> Tensor:
    """Return (n, 3, 64, 64) sensor images, as optics.shade, of slopes (n, 2, 64, 64) clamped to limit (n,)."""
    length = slopes.square().sum(dim=1, keepdim=True).sqrt()
    slopes = slopes * torch.clamp(limit[:, None, None, None] / length.clamp(min=1e-9), max=1.0)
    upward = torch.ones_like(length)
    normal = torch.cat([-slopes, upward], dim=1) / (1.0 + slopes.square().sum(dim=1, keepdim=True)).sqrt()
    return torch.einsum("nck,nkhw->nchw", shading, normal) + ambient[:, :, None, None]


def normalise_views(image: Tensor, background: Tensor) -> tuple[Tensor, Tensor]:
    """Normalise images (n, 3, 64, 64) like the run-time encoder; background: (n, 3)."""
    relative = image / background[:, :, None, None] - 1.0
    basis = torch.tensor(plane_basis(image.shape[2], image.shape[3]), dtype=torch.float32)
    weights = torch.einsum("hwk,nchw->nck", basis, relative)
    relative = relative - torch.einsum("hwk,nck->nchw", basis, weights)
    contrast = relative.square().mean(dim=(1, 2, 3)).sqrt()
    return relative / contrast.clamp(min=CONTRAST_FLOOR)[:, None, None, None], contrast


def clamp_faint_levels(target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return targets (n, OUTPUT_COUNT) with levels at most FAINT_DECADES below the view's strongest."""
    clamped = target.copy()
    levels = clamped[:, LEVEL_INDICES]
    clamped[:, LEVEL_INDICES] = np.maximum(levels, levels.max(axis=1, keepdims=True) - FAINT_DECADES)
    return clamped


ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True)
class Schedule:
    """Schedule of a training.

    Attributes
    ----------
    steps
        Number of steps.
    minutes
        Time after which training ends, if sooner; None: results are reproducible on one machine.
    batch
        Views per step.
    learning_rate
        Peak rate; it rises over the fraction `warm_up` of the run, then falls as a cosine to 0.
    level_weight
        Weight of the levels relative to the other outputs.
    narrow
        Convolutions in bfloat16.
    """

    steps: int = 12000
    minutes: float | None = None
    batch: int = 64
    learning_rate: float = 1e-3
    warm_up: float = 0.05
    decay: float = 1e-4
    level_weight: float = 3.0
    narrow: bool = True


STATISTICS_VIEWS, INITIALISATION_VIEWS = 1024, 256
"""Views for the units of the outputs, and for the scale of the initial weights."""
SMALLEST_SPREAD = 0.02
HUBER_DELTA = 0.2
"""Error above which the loss is linear, in units of spread, so that outliers do not dominate."""


def fit_encoder(
    design: AlexNetConfig,
    pairs: Pairs,
    schedule: Schedule,
    seed: int,
    *,
    backbone: dict[str, Tensor] | None = None,
    start: AlexNet | None = None,
    refresh: Callable[[], Pairs] | None = None,
    watch: ProgressCallback | None = None,
) -> TorchAlexNet:
    """Train the complete network, or only the head on a fixed backbone.

    Parameters
    ----------
    design
        Configuration of the network.
    pairs
        Training pairs.
    schedule
        Length and rates.
    seed
        Seed of weights and augmentation.
    backbone
        Fixed weights with torchvision's names.
    start
        Encoder of the same design to continue from, with its units.
    refresh
        Returns the pairs for every further epoch, for a folder that still grows.
    watch
        Progress callback (step, progress, mean loss of the last steps), called about a hundred times.

    Returns
    -------
    TorchAlexNet
        The trained network.
    """
    torch.set_num_threads(1)
    twin = TorchAlexNet(design)
    twin.initialise(seed)
    if backbone is not None:
        twin.load_state_dict(backbone, strict=False)
        twin.features.requires_grad_(False)
    lamps = draw_lamps(seed)
    if start is None:
        _initialise_outputs(twin, pairs, lamps, seed)
    else:
        twin.load_state_dict({name: torch.tensor(value) for name, value in start.tensors.items()})
    twin.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    trainable = [parameter for parameter in twin.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(trainable, lr=schedule.learning_rate, weight_decay=schedule.decay)
    rng = np.random.default_rng([seed, 1])
    rows = np.zeros(0, dtype=np.intp)
    start_time, step, next_report, losses = time.monotonic(), 0, 0.0, []
    while (progress := _compute_progress(schedule, step, time.monotonic() - start_time)) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = schedule.learning_rate * _compute_rate_factor(progress, schedule.warm_up)
        if len(rows) < schedule.batch:
            if refresh is not None and step:
                pairs, rows = refresh(), rows[:0]
            rows = np.concatenate([rows, rng.permutation(len(pairs))])
        batch = make_batch(pairs, rows[: schedule.batch], lamps, rng)
        rows = rows[schedule.batch :]
        with torch.autocast("cpu", torch.bfloat16, enabled=schedule.narrow):
            outputs = twin(batch.views, batch.given)
        loss = compute_loss(twin, outputs, batch.target, schedule.level_weight)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(trainable, 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        step += 1
        if watch is not None and progress >= next_report:
            watch(step, progress, float(np.mean(losses)))
            next_report, losses = progress + 0.01, []
    twin.eval()
    return twin


def compute_loss(network: TorchAlexNet, found: Tensor, target: Tensor, level_weight: float) -> Tensor:
    """Return the mean Huber loss over outputs in units of spread, with weighted levels."""
    expected = (target - network.output_mean) / network.output_spread
    weight = torch.ones(OUTPUT_COUNT)
    weight[list(LEVEL_INDICES)] = level_weight
    losses = functional.huber_loss(found, expected, reduction="none", delta=HUBER_DELTA) / HUBER_DELTA
    return (losses * weight).mean() / weight.mean()


def _initialise_outputs(network: TorchAlexNet, pairs: Pairs, lamps: LampSets, seed: int) -> None:
    """Set the units of the outputs, and scale the layers for the start."""
    rng = np.random.default_rng([seed, 2])
    batch = make_batch(pairs, rng.integers(0, len(pairs), STATISTICS_VIEWS), lamps, rng)
    network.output_mean.copy_(batch.target.mean(dim=0))
    network.output_spread.copy_(batch.target.std(dim=0, correction=0).clamp(min=SMALLEST_SPREAD))
    network.standardise_layers(batch.views[:INITIALISATION_VIEWS], batch.given[:INITIALISATION_VIEWS])


def _compute_progress(schedule: Schedule, step: int, seconds: float) -> float:
    by_time = 0.0 if schedule.minutes is None else seconds / (60.0 * schedule.minutes)
    return max(step / schedule.steps, by_time)


def _compute_rate_factor(done: float, warm_up: float) -> float:
    if done < warm_up:
        return max(done / warm_up, 0.02)
    return 0.5 + 0.5 * math.cos(math.pi * (done - warm_up) / (1.0 - warm_up))


LICENCE = "GPL-3.0-or-later"
USER_BACKBONE_LICENCE = "the trunk's own terms apply; the head: GPL-3.0-or-later"
EVALUATED_VIEWS = 400
"""Number of held-out views for the metrics stored in the weights."""
USER_BACKBONE_PIXELS = 128
"""Side to which views are enlarged for a backbone trained on photographs of 224 pixels."""


@dataclass(frozen=True)
class TrainedEncoder:
    """A trained encoder. errors: on held-out instances, None if the folder has none."""

    network: AlexNet
    errors: TokenErrors | None


def train_encoder(
    folder: Path,
    schedule: Schedule,
    seed: int,
    *,
    backbone: Path | None = None,
    design: AlexNetConfig | None = None,
    start: AlexNet | None = None,
    partial: bool = False,
    watch: ProgressCallback | None = None,
) -> TrainedEncoder:
    """Train on the pairs in a folder: the complete network, or only the head on a backbone file.

    Parameters
    ----------
    folder
        Folder of training pairs.
    schedule
        Length and rates.
    seed
        Seed of weights and augmentation.
    backbone
        File of fixed backbone weights.
    design
        Configuration of the network.
    start
        Encoder to continue from.
    partial
        Train on the shards present, and reload them at every epoch.
    watch
        Progress callback, see fit_encoder.

    Raises
    ------
    FileError
        If pairs or the backbone cannot be read.
    WeightsError
        If the backbone does not fit.
    """
    pairs = load_pairs(folder, TRAIN, partial=partial)
    if backbone is None:
        design, weights, source = (
            design or (start.config if start else AlexNetConfig()),
            None,
            "trunk and head trained together",
        )
    else:
        design = design or AlexNetConfig(pixels=USER_BACKBONE_PIXELS, mean=IMAGENET_MEAN, deviation=IMAGENET_DEVIATION)
        weights, digest = load_backbone(backbone)
        source = f"trunk of {backbone.name} (SHA-256 {digest}) as it is, head trained"

    def reload_pairs() -> Pairs:
        nonlocal pairs
        pairs = load_pairs(folder, TRAIN, partial=True)
        return pairs

    refresh = reload_pairs if partial else None
    twin = fit_encoder(design, pairs, schedule, seed, backbone=weights, start=start, refresh=refresh, watch=watch)
    metadata = {
        "training_data": f"{len(pairs)} views of {pairs.tiles} tiles made by this project's generator of surfaces; "
        f"no recorded data; {source}",
        "seed": str(seed),
        **({"continued": json.dumps({"from": start.content_id, **start.metadata}, sort_keys=True)} if start else {}),
        "licence": LICENCE if backbone is None else USER_BACKBONE_LICENCE,
    }
    network = twin.to_numpy(metadata)
    errors = _evaluate_held_out(network, folder, partial)
    if errors is not None:
        metrics = f"single views of held-out instances against their whole tiles: {format_errors(errors)}"
        network = AlexNet(network.config, network.tensors, {**metadata, "metrics": metrics})
    return TrainedEncoder(network, errors)


def _evaluate_held_out(network: AlexNet, folder: Path, partial: bool) -> TokenErrors | None:
    try:
        held_out = load_pairs(folder, HELD_OUT_INSTANCES, partial=partial)
    except FileError:
        if partial:
            return None
        raise
    # A random choice, since views of one pitch are at equal intervals.
    rows = sorted(np.random.default_rng(0).permutation(len(held_out))[:EVALUATED_VIEWS].tolist())
    return evaluate_encoder(
        Encoder(ALEXNET_ID, "", lambda tactile_map: describe_with_alexnet(network, tactile_map)), held_out, rows
    )
