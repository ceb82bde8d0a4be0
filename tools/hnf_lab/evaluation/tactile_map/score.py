"""How far one sensor image, or one field of slopes, lies from another.

From tokens to long-run spectra through the field, and how far two sets of spectra lie apart.

Every method on every tile: the slopes it gives, the token and the spectra that follow, and how far off they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS
from hnf_core.errors import UsageError
from hnf_core.field.field import Field, evaluate, steady_amplitude
from hnf_core.field.linear_contact import Condition as States
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.encoder_registry import Encoder
from hnf_core.material.fuse import fuse
from hnf_core.material.ranking import SAME_CATEGORY_APTNESS
from hnf_core.material.token import LEVELS, Token
from hnf_core.metrics.spectra import select_compared_bins
from hnf_core.simulation.material_classes import get_category
from hnf_core.tactile.optics import get_sensor
from hnf_core.tactile.tactile_map import Route
from hnf_core.training.simulated_strokes import make_middle_conditions, make_speed_grid

from ..methods import compute_window_densities
from ..scoring import FREQUENCY_HZ
from .naive_baselines import NaiveBaselines
from .tiles import TOKEN_VIEWS, HeldOutTile, describe_slopes, render_sensor_image

Float = NDArray[np.float64]

K1, K2, SSIM_SIDE, SSIM_SIGMA = 0.01, 0.03, 11, 1.5
"""Constants of SSIM: Wang, Bovik, Sheikh & Simoncelli 2004, section III-C."""


def compute_psnr_db(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """10 log10(L² / mean square difference), L = data_range; inf where they are equal. Raises UsageError on shapes that
    differ and on a range that is not positive."""
    x, y = _check_images(image, reference, data_range)
    square = float(np.mean(np.square(x - y)))
    return float("inf") if square == 0.0 else float(10.0 * np.log10(data_range**2 / square))


def compute_ssim(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """Mean structural similarity (Wang et al. 2004) of (H, W) or (H, W, C) pictures, channels averaged.

    Local moments under an 11 × 11 Gaussian of σ = 1.5 pixels with unit sum, at the places where it fits wholly inside;
    C1 = (0.01 L)², C2 = (0.03 L)², L = data_range. Raises UsageError as psnr_db, and below 11 × 11 pixels.
    """
    x, y = _check_images(image, reference, data_range)
    if min(x.shape[:2]) < SSIM_SIDE:
        raise UsageError(f"similarity needs {SSIM_SIDE} × {SSIM_SIDE} pixels, not {x.shape}.")
    mean_x, mean_y = _compute_local_means(x), _compute_local_means(y)
    var_x, var_y = _compute_local_means(x * x) - mean_x**2, _compute_local_means(y * y) - mean_y**2
    covariance = _compute_local_means(x * y) - mean_x * mean_y
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    likeness = (2.0 * mean_x * mean_y + c1) * (2.0 * covariance + c2)
    return float(np.mean(likeness / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))))


def compute_normal_angle_deg(slopes: ArrayLike, reference: ArrayLike) -> float:
    """Mean angle in degrees between the normals of two fields of slopes (2, H, W)."""
    (gx, gy), (rx, ry) = np.asarray(slopes, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    # |n × m| and n · m of unnormalised normals: exact for small angles, where an arc cosine is all rounding.
    across = np.sqrt((gy - ry) ** 2 + (gx - rx) ** 2 + (gx * ry - gy * rx) ** 2)
    return float(np.degrees(np.mean(np.arctan2(across, 1.0 + gx * rx + gy * ry))))


def compute_rms_slope(slopes: ArrayLike) -> float:
    """√(mean of both components' squares)."""
    return float(np.sqrt(np.mean(np.square(np.asarray(slopes, dtype=np.float64)))))


def _check_images(image: ArrayLike, reference: ArrayLike, data_range: float) -> tuple[Float, Float]:
    x, y = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim not in (2, 3) or not data_range > 0.0:
        raise UsageError(f"pictures of {x.shape} and {y.shape} with a range of {data_range:g} cannot be compared.")
    return x, y


def _compute_local_means(values: Float) -> Float:
    """Gaussian means along both axes, where the window fits."""
    place = np.arange(SSIM_SIDE) - SSIM_SIDE // 2
    weight = np.exp(-0.5 * np.square(place / SSIM_SIGMA))
    weight /= weight.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, SSIM_SIDE, axis=axis)
        values = np.asarray(windows @ weight)
    return values


PROBE_NAME = "pen"
BINS_HZ = FREQUENCY_HZ[1:101]


def predict_long_run_spectra(field: Field, tokens: NDArray[np.float32], mechanics: Sequence[Mechanics]) -> Float:
    """(n, 6, 100) density at 10 … 1000 Hz that the field expects of long steady strokes with the pen, under the six
    middle conditions of training.conditions. tokens: (n, TOKEN_DIM). mechanics: n."""
    count, grid = len(tokens), make_speed_grid()
    spectra = []
    for each in make_middle_conditions():
        states = States(
            tokens=np.asarray(tokens, dtype=np.float64),
            mechanics=tuple(mechanics),
            material=np.arange(count, dtype=np.int32),
            direction=np.tile([np.cos(each.angle), np.sin(each.angle)], (count, 1)),
            speed=np.full(count, grid[each.speed]),
            force=np.full(count, each.force),
            contact=np.ones(count, dtype=bool),
            probe=PROBE_NAME,
        )
        amplitude = steady_amplitude(field.config, evaluate(field, states)).sum(axis=1)
        spectra.append(compute_window_densities(field.config.carriers, np.square(amplitude), states.speed))
    return np.stack(spectra, axis=1)


@dataclass(frozen=True)
class SpectrumError:
    """In dB, averaged over conditions. total: RMS over the counted bins (metrics.average_spectrum). level: what one
    gain would mend, the absolute mean difference; bias: the same with its sign. shape: RMS of the rest. Within a
    condition total² = level² + shape²."""

    total: float
    level: float
    bias: float
    shape: float


def compute_spectrum_error(spectra: Float, reference: Float) -> SpectrumError:
    """(6, 100) each, as long_run_spectra has them. The reference's peaks choose the bins."""
    parts = []
    for ours, theirs in zip(spectra, reference, strict=True):
        bins = select_compared_bins(theirs, BINS_HZ)
        floor = 1e-12 * float(theirs[bins].max())
        over = 10.0 * np.log10(np.maximum(ours[bins], floor) / theirs[bins])
        parts.append((np.sqrt(np.mean(over**2)), abs(over.mean()), over.mean(), over.std()))
    total, level, bias, shape = np.mean(parts, axis=0)
    return SpectrumError(float(total), float(level), float(bias), float(shape))


def compute_log_mean(spectra: Float) -> Float:
    """Over the first axis, of levels."""
    return np.asarray(np.exp(np.mean(np.log(np.maximum(spectra, 1e-30)), axis=0)))


Single = NDArray[np.float32]

TRUTH, FULL_TILE, FLOOR = "true map", "true map, whole tile", "true map, second tile (floor)"
PREDICTED = "predicted"
"""By a network; alone, of the main one (networks.networks_of names the rows of both)."""
NO_DEPTH, NO_COLOUR = f"{PREDICTED}, depth unknown", f"{PREDICTED}, colour unknown"
DIGIT = f"{PREDICTED}, DIGIT"
NEIGHBOUR, GREY, FLAT = "nearest neighbour", "grey level is height", "flat (mean map)"
CLASS_MEAN, MEAN = "class mean", "mean of all"
FUSED = f"{PREDICTED}, fused with the category's token"
"""As the product fuses a picture with a prior (material.fuse) that is of the right category and no more."""
MIN_RANGE = 1e-4
"""Least own range of a sensor image: below, it is flat to the eye, and to eight bits."""


@dataclass(frozen=True)
class ImageScore:
    """One method on one view, as an image. psnr_db, ssim: with data range 1, the scale of the linear image.
    own_psnr_db, own_ssim: with the range that the true image covers. angle_deg: mean angle between normals. level_db:
    of the RMS slope over the true one's."""

    method: str
    sensor: str
    pitch_m: float
    tile: str
    psnr_db: float
    ssim: float
    own_psnr_db: float
    own_ssim: float
    angle_deg: float
    level_db: float


@dataclass(frozen=True)
class TileResult:
    """errors: method → distance of its spectra from those of the true map in the same views. bands_db: method → (7,)
    level of each of the token's bands over the true one's."""

    tile: str
    class_name: str
    errors: Mapping[str, SpectrumError]
    bands_db: Mapping[str, Float]


Maps = Mapping[str, tuple[str, Single]]
"""Method → (sensor, slopes (views, 2, 64, 64) of the tile's first views)."""


def score_spectra(
    field: Field, encoder: Encoder, tile: HeldOutTile, maps: Maps, baselines: NaiveBaselines | None, main: str = ""
) -> TileResult:
    """maps: any number of views from TOKEN_VIEWS on. learned: None leaves class mean, mean of all and FUSED out. main:
    the method whose token is fused with the category's, "" = none."""
    pitches = [view.pitch_m for view in tile.views[:TOKEN_VIEWS]]

    def token(slopes: Single, sensor: str = PAIR_SENSORS[0]) -> Token:
        return describe_slopes(list(slopes[:TOKEN_VIEWS]), pitches, sensor, encoder)

    truths = {sensor: token(tile.slopes[:, index], sensor).values for index, sensor in enumerate(PAIR_SENSORS)}
    first = PAIR_SENSORS[0]
    tokens = {TRUTH: truths[first], FULL_TILE: tile.full_token, FLOOR: token(tile.second_slopes).values}
    against = dict.fromkeys(tokens, first)
    for name, (sensor, slopes) in maps.items():
        told = token(slopes, sensor)
        tokens[name], against[name] = told.values, sensor
        if name == main and baselines is not None:
            tokens[FUSED] = fuse(
                told, _compute_category_token(tile, baselines), SAME_CATEGORY_APTNESS, Route.PREDICTED
            ).values
            against[FUSED] = sensor
    wanted = [*tokens.values(), *truths.values()]
    spectra = predict_long_run_spectra(field, np.stack(wanted), [tile.mechanics] * len(wanted))
    truth = dict(zip(PAIR_SENSORS, spectra[len(tokens) :], strict=True))
    errors = {
        name: compute_spectrum_error(own, truth[against[name]]) for name, own in zip(tokens, spectra, strict=False)
    }
    if baselines is not None:
        for name, mean in _compute_mean_spectra(field, tile, baselines).items():
            errors[name] = compute_spectrum_error(mean, truth[first])
    bands = {
        name: 20.0 * (each[LEVELS].astype(np.float64) - truths[against[name]][LEVELS]) for name, each in tokens.items()
    }
    return TileResult(tile.name, tile.order.class_name, errors, bands)


def score_images(tile: HeldOutTile, maps: Maps) -> list[ImageScore]:
    """Each method on each view that it was asked about."""
    out = []
    for name, (sensor, slopes) in maps.items():
        true = tile.slopes[:, PAIR_SENSORS.index(sensor)]
        for view, own, right in zip(tile.views, slopes, true, strict=False):
            image, reference = render_sensor_image(own, sensor), render_sensor_image(right, sensor)
            contrast = reference - get_sensor(sensor).background
            span = max(float(contrast.max() - contrast.min()), MIN_RANGE)
            out.append(
                ImageScore(
                    name, sensor, view.pitch_m, tile.name,
                    compute_psnr_db(image, reference, 1.0), compute_ssim(image, reference, 1.0),
                    compute_psnr_db(image, reference, span), _compute_contrast_ssim(image, reference, sensor, span),
                    compute_normal_angle_deg(own, right),
                    20.0 * float(np.log10(max(compute_rms_slope(own), 1e-9) / max(compute_rms_slope(right), 1e-9))),
                )
            )  # fmt: skip
    return out


def _compute_contrast_ssim(image: Single, reference: Single, sensor: str, span: float) -> float:
    """Without the background, which is the same in both and would pass for likeness."""
    background = get_sensor(sensor).background
    return compute_ssim(image - background, reference - background, span)


def _compute_mean_spectra(field: Field, tile: HeldOutTile, baselines: NaiveBaselines) -> dict[str, Float]:
    """Mean of log spectra over training tiles, with this tile's own mechanics: only the map is guessed. Classes count
    alike. Class mean: of the classes of the tile's category; of all where training knows none."""
    names = sorted(set(baselines.class_name))
    spectra = predict_long_run_spectra(field, baselines.tokens, [tile.mechanics] * len(baselines.tokens))
    of_class = {
        name: compute_log_mean(spectra[[row for row, own in enumerate(baselines.class_name) if own == name]])
        for name in names
    }
    return {
        CLASS_MEAN: compute_log_mean(np.stack([of_class[name] for name in _find_similar_classes(tile, baselines)])),
        MEAN: compute_log_mean(np.stack(list(of_class.values()))),
    }


def _compute_category_token(tile: HeldOutTile, baselines: NaiveBaselines) -> Single:
    """Mean token of the training classes of the tile's category, classes alike; of all where training knows none."""
    names = _find_similar_classes(tile, baselines)
    rows = [[row for row, own in enumerate(baselines.class_name) if own == name] for name in names]
    return np.asarray(np.mean([baselines.tokens[own].mean(axis=0) for own in rows], axis=0), dtype=np.float32)


def _find_similar_classes(tile: HeldOutTile, baselines: NaiveBaselines) -> list[str]:
    names = sorted(set(baselines.class_name))
    return [name for name in names if get_category(name) == tile.category] or names


def average_image_scores(scores: Sequence[ImageScore], method: str, sensor: str, pitch_m: float) -> dict[str, float]:
    """Means over the views of one method, sensor and pitch; empty where there are none."""
    rows = [
        each for each in scores
        if each.method == method and each.sensor == sensor and abs(each.pitch_m / pitch_m - 1.0) < 1e-6
    ]  # fmt: skip
    if not rows:
        return {}
    numbers = ("psnr_db", "ssim", "own_psnr_db", "own_ssim", "angle_deg", "level_db")
    return {
        "views": float(len(rows)),
        **{name: float(np.mean([getattr(row, name) for row in rows])) for name in numbers},
    }
