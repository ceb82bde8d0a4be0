"""Batches for E: membranes of the pairs, turned, scaled, lit by scattered lamps and seen through noise.

Fit E: regression on the band descriptor of the whole tile, every output in units of its own spread.

From pairs to an encoder: `hnf train encoder`, and how the shipped weights come about.
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
    encode_targets,
    plane_basis,
)
from hnf_core.material.encoder_registry import Encoder
from hnf_core.material.token import ALEXNET_ID, BAND_FEATURES
from hnf_core.tactile.optics import SENSORS, Sensor, perturb_sensor
from hnf_core.tactile.views import PITCHES_M

from .evaluate import TokenErrors, evaluate_encoder, format_errors
from .network import TorchAlexNet, load_backbone

Single = NDArray[np.float32]

LAMP_SET_COUNT = 256
"""Scattered sensors of each make that batches choose from."""
NOMINAL_LAMP_SHARE = 2 / 3
"""Share of views under the lamps that the sensor's make names; the others under scattered ones."""
BACKGROUND_ERROR = 0.02
NOISE_SHARE, NOISE_LOG10 = 0.5, (-3.5, -1.6)
"""Share of views with sensor noise, and log10 of its deviation (full scale 1), uniform."""
SCALE_LOG10 = (-0.5, 0.1)
"""Heights are multiplied by a factor, log-uniform: more levels than the tiles have."""
ROTATED_SHARE = 0.75
"""Share of the widest views turned by any angle: most materials lie along the axes of their tile."""
UPSAMPLING = 2
FAINT_DECADES = 3.0
"""Levels further below the view's strongest band are taught as this far below: no picture shows them."""
QUARTER_TURN_SIGNS = np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
MIRROR_SIGNS = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
"""What a quarter turn and a mirror (left and right) make of a band's features."""


@dataclass(frozen=True)
class Batch:
    """views: (n, 3, 64, 64) of contrast 1. given: (n, CONDITIONS). target: (n, OUTPUTS)."""

    views: Tensor
    given: Tensor
    target: Tensor


@dataclass(frozen=True)
class LampSets:
    """shading: (makes, sets + 1, 3, 3), ambient: (makes, sets + 1, 3); the last set is the make's own."""

    shading: Tensor
    ambient: Tensor
    sensors: tuple[Sensor, ...]


def draw_lamps(seed: int, sets: int = LAMP_SET_COUNT) -> LampSets:
    """Sensors of both makes with scattered lamps."""
    rng = np.random.default_rng(seed)
    makes = tuple(SENSORS[name] for name in PAIR_SENSORS)
    pieces = [[*(perturb_sensor(make, rng) for _ in range(sets)), make] for make in makes]
    return LampSets(
        torch.tensor(np.array([[each.shading for each in row] for row in pieces]), dtype=torch.float32),
        torch.tensor(np.array([[each.ambient for each in row] for row in pieces]), dtype=torch.float32),
        makes,
    )


def make_batch(pairs: Pairs, rows: NDArray[np.intp], lamps: LampSets, rng: np.random.Generator) -> Batch:
    """Views of the pairs (rows) under conditions drawn from rng."""
    count = len(rows)
    make = rng.integers(0, len(PAIR_SENSORS), count)
    pitch = pairs.pitch_index[rows]
    slopes = pairs.slopes[rows, make].astype(np.float32)
    scale = 10.0 ** rng.uniform(*SCALE_LOG10, count)
    slopes *= scale[:, None, None, None].astype(np.float32)
    for row in np.flatnonzero(pitch == 0):
        # The widest view is the whole tile, which repeats: it can be shifted at will.
        slopes[row] = np.roll(slopes[row], tuple(rng.integers(0, 64, 2)), axis=(1, 2))
    turn, angle = rng.integers(0, 8, count), rng.uniform(-np.pi / 4.0, np.pi / 4.0, count)
    token = pairs.token[pairs.tile_index[rows]].astype(np.float64)
    slopes, token = apply_symmetry(slopes, token, turn)
    whole = np.flatnonzero((pitch == 0) & (rng.random(count) < ROTATED_SHARE))
    slopes[whole], token[whole] = rotate_views(slopes[whole], token[whole], angle[whole])
    limit = np.array([sensor.max_slope for sensor in lamps.sensors], dtype=np.float32)[make]
    sets = lamps.shading.shape[1] - 1
    chosen = np.where(rng.random(count) < NOMINAL_LAMP_SHARE, sets, rng.integers(0, sets, count))
    nominal = rng.random(count) < 0.5
    image = shade_views(
        torch.tensor(slopes), torch.tensor(limit), lamps.shading[make, chosen], lamps.ambient[make, chosen]
    )
    told = np.where(nominal, sets, chosen)
    background = lamps.shading[make, told][:, :, 2] + lamps.ambient[make, told]
    error = 1.0 + BACKGROUND_ERROR * rng.standard_normal((count, 3)) * (chosen != sets)[:, None]
    noisy = (rng.random(count) < NOISE_SHARE) * 10.0 ** rng.uniform(*NOISE_LOG10, count)
    noise = torch.tensor(rng.standard_normal(image.shape, dtype=np.float32))
    image = image + noise * torch.tensor(noisy, dtype=torch.float32)[:, None, None, None]
    views, contrast = normalise_views(image, background * torch.tensor(error, dtype=torch.float32))
    given = np.stack(
        [
            build_view_conditions(float(c), lamps.sensors[m], PITCHES_M[p])
            for c, m, p in zip(contrast.numpy(), make, pitch, strict=True)
        ]
    )
    target = clamp_faint_levels(encode_targets(token, contrast.numpy().astype(np.float64), pitch))
    target[:, LEVEL_INDICES] += np.log10(scale)[:, None]
    return Batch(views, torch.tensor(given), torch.tensor(target, dtype=torch.float32))


def apply_symmetry(
    slopes: Single, token: NDArray[np.float64], turn: NDArray[np.int64]
) -> tuple[Single, NDArray[np.float64]]:
    """Slopes (n, 2, 64, 64) and tokens (n, TOKEN_DIM) of the surfaces after turn & 3 quarter turns counter-clockwise,
    mirrored (left and right) before where turn & 4."""
    slopes, token = slopes.copy(), token.copy()
    bands = token[:, :-2].reshape(len(token), -1, len(BAND_FEATURES))
    for row, way in enumerate(turn):
        gx, gy = slopes[row]
        if way & 4:
            gx, gy = -gx[:, ::-1], gy[:, ::-1]
            bands[row] *= MIRROR_SIGNS
        for _ in range(int(way) & 3):
            gx, gy = -np.rot90(gy), np.rot90(gx)
            bands[row] *= QUARTER_TURN_SIGNS
        slopes[row] = np.stack([gx, gy])
    token[:, :-2] = bands.reshape(len(token), -1)
    return slopes, token


def rotate_views(
    slopes: Single, token: NDArray[np.float64], angle: NDArray[np.float64]
) -> tuple[Single, NDArray[np.float64]]:
    """The same as seen after a turn counter-clockwise by any angle in radians, for tiles that repeat.

    The tile is enlarged by its Fourier series before it is read by cubic splines, which then cost the shortest band
    nothing that counts.
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
    # A pixel's place, from the middle, in pixels: x to the right, y up.
    along = np.arange(side) - (side - 1) / 2.0
    x, y = np.broadcast_arrays(along[None, :], -along[:, None])
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    places = UPSAMPLING * (np.stack([sin * x - cos * y, cos * x + sin * y], axis=1) + (side - 1) / 2.0)
    seen = np.empty_like(slopes)
    for index in np.ndindex(slopes.shape[:2]):
        ndimage.map_coordinates(fine[index], places[index[0]], seen[index], order=3, mode="grid-wrap")
    gx, gy = seen[:, 0], seen[:, 1]
    narrow_cos, narrow_sin = cos.astype(np.float32), sin.astype(np.float32)
    out = np.stack([narrow_cos * gx - narrow_sin * gy, narrow_sin * gx + narrow_cos * gy], axis=1)
    bands = token[:, :-2].reshape(len(token), -1, len(BAND_FEATURES)).copy()
    for fold, first in ((2, 1), (4, 3)):
        c, s = np.cos(fold * angle)[:, None], np.sin(fold * angle)[:, None]
        even, odd = bands[:, :, first].copy(), bands[:, :, first + 1].copy()
        bands[:, :, first], bands[:, :, first + 1] = c * even - s * odd, s * even + c * odd
    return out, np.concatenate([bands.reshape(len(token), -1), token[:, -2:]], axis=1)


def shade_views(slopes: Tensor, limit: Tensor, shading: Tensor, ambient: Tensor) -> Tensor:
    """(n, 3, 64, 64) sensor images, as tactile.optics.shade, of slopes (n, 2, 64, 64) held at limit (n,)."""
    length = slopes.square().sum(dim=1, keepdim=True).sqrt()
    slopes = slopes * torch.clamp(limit[:, None, None, None] / length.clamp(min=1e-9), max=1.0)
    upward = torch.ones_like(length)
    normal = torch.cat([-slopes, upward], dim=1) / (1.0 + slopes.square().sum(dim=1, keepdim=True)).sqrt()
    return torch.einsum("nck,nkhw->nchw", shading, normal) + ambient[:, :, None, None]


def normalise_views(image: Tensor, background: Tensor) -> tuple[Tensor, Tensor]:
    """Twin of material.alexnet.network.view_input for batches (n, 3, 64, 64), background (n, 3)."""
    relative = image / background[:, :, None, None] - 1.0
    basis = torch.tensor(plane_basis(image.shape[2], image.shape[3]), dtype=torch.float32)
    weights = torch.einsum("hwk,nchw->nck", basis, relative)
    relative = relative - torch.einsum("hwk,nck->nchw", basis, weights)
    contrast = relative.square().mean(dim=(1, 2, 3)).sqrt()
    return relative / contrast.clamp(min=CONTRAST_FLOOR)[:, None, None, None], contrast


def clamp_faint_levels(target: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, OUTPUTS) with no level further than FAINT_DECADES below the strongest of its view."""
    out = target.copy()
    levels = out[:, LEVEL_INDICES]
    out[:, LEVEL_INDICES] = np.maximum(levels, levels.max(axis=1, keepdims=True) - FAINT_DECADES)
    return out


ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True)
class Schedule:
    """steps of `batch` views, or `minutes` where they are sooner over (None: steps alone, and then the same seed gives
    the same weights on the same machine). learning_rate: its peak; warm_up: share of the run until there, then a
    cosine down to nothing. level_weight: of the levels against the other outputs. narrow: convolutions in bfloat16.
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
"""Views that the units of the outputs, and the scale of the first weights, are taken from."""
SMALLEST_SPREAD = 0.02
HUBER_DELTA = 0.2
"""In units of spread: below it errors count as squares, above as they are: chance peaks must not lead."""


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
    """Train the whole network, or with a trunk (torchvision's names) the head alone, the trunk as it is.

    start: an encoder of the same design to go on from, with its units. refresh: asked for the pairs of every further
    epoch, for a folder that still grows. watch(step, share done, mean loss of the last steps) is called about a hundred
    times.
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
    learnt = [parameter for parameter in twin.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(learnt, lr=schedule.learning_rate, weight_decay=schedule.decay)
    rng = np.random.default_rng([seed, 1])
    rows = np.zeros(0, dtype=np.intp)
    began, step, told, losses = time.monotonic(), 0, 0.0, []
    while (done := _compute_progress(schedule, step, time.monotonic() - began)) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = schedule.learning_rate * _compute_rate_factor(done, schedule.warm_up)
        if len(rows) < schedule.batch:
            if refresh is not None and step:
                pairs, rows = refresh(), rows[:0]
            rows = np.concatenate([rows, rng.permutation(len(pairs))])
        batch = make_batch(pairs, rows[: schedule.batch], lamps, rng)
        rows = rows[schedule.batch :]
        with torch.autocast("cpu", torch.bfloat16, enabled=schedule.narrow):
            found = twin(batch.views, batch.given)
        loss = compute_loss(twin, found, batch.target, schedule.level_weight)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(learnt, 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        step += 1
        if watch is not None and done >= told:
            watch(step, done, float(np.mean(losses)))
            told, losses = done + 0.01, []
    twin.eval()
    return twin


def compute_loss(network: TorchAlexNet, found: Tensor, target: Tensor, level_weight: float) -> Tensor:
    """Mean Huber loss over outputs in units of spread, levels weighted."""
    wanted = (target - network.output_mean) / network.output_spread
    weight = torch.ones(OUTPUT_COUNT)
    weight[list(LEVEL_INDICES)] = level_weight
    each = functional.huber_loss(found, wanted, reduction="none", delta=HUBER_DELTA) / HUBER_DELTA
    return (each * weight).mean() / weight.mean()


def _initialise_outputs(network: TorchAlexNet, pairs: Pairs, lamps: LampSets, seed: int) -> None:
    """Units of the outputs, and layers that start where they can learn."""
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
"""Views of held-out instances that the metrics in the weights come from."""
USER_BACKBONE_PIXELS = 128
"""Views are enlarged to this for a trunk that was trained on photographs of 224 pixels."""


@dataclass(frozen=True)
class TrainedEncoder:
    """errors: on held-out instances, None where the folder has none."""

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
    """Train on the pairs in folder: everything, or with a trunk file the head alone. Raises FileError, WeightsError.

    start: an encoder to go on from. partial: train on the shards that are there, and take in at every epoch what has
    come since.
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

    def there_now() -> Pairs:
        nonlocal pairs
        pairs = load_pairs(folder, TRAIN, partial=True)
        return pairs

    refresh = there_now if partial else None
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
        words = f"single views of held-out instances against their whole tiles: {format_errors(errors)}"
        network = AlexNet(network.config, network.tensors, {**metadata, "metrics": words})
    return TrainedEncoder(network, errors)


def _evaluate_held_out(network: AlexNet, folder: Path, partial: bool) -> TokenErrors | None:
    try:
        held = load_pairs(folder, HELD_OUT_INSTANCES, partial=partial)
    except FileError:
        if partial:
            return None
        raise
    # Chosen at random: views of one pitch stand at equal distances.
    rows = sorted(np.random.default_rng(0).permutation(len(held))[:EVALUATED_VIEWS].tolist())
    return evaluate_encoder(Encoder(ALEXNET_ID, "", lambda each: describe_with_alexnet(network, each)), held, rows)
