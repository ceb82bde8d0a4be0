"""Batches for E: membranes of the pairs, turned, scaled, lit by scattered lamps and seen through noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from ...datasets.tactile_pairs import PAIR_SENSORS, Pairs
from ...material.alexnet.network import (
    CONTRAST_FLOOR,
    LEVEL_INDICES,
    build_view_conditions,
    encode_targets,
    plane_basis,
)
from ...material.token import BAND_FEATURES
from ...tactile.lamps import perturb_sensor
from ...tactile.optics import SENSORS, Sensor
from ...tactile.views import PITCHES_M

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
