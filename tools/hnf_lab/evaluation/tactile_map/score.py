"""Metrics of predicted tactile maps: image similarity, slope angles, and errors of the resulting spectra.

`score_spectra` goes from each method's slopes to a token, through the field to long-run spectra, and compares these
with the spectra of the true map. `score_images` compares sensor images view by view.
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
from hnf_lab.shared_field.simulated_strokes import make_middle_conditions, make_speed_grid

from ..methods import compute_window_densities
from ..scoring import FREQUENCY_HZ
from .naive_baselines import NaiveBaselines
from .tiles import TOKEN_VIEWS, HeldOutTile, describe_slopes, render_sensor_image

Float = NDArray[np.float64]

K1, K2, SSIM_SIDE, SSIM_SIGMA = 0.01, 0.03, 11, 1.5
"""Constants of SSIM: Wang, Bovik, Sheikh & Simoncelli 2004, section III-C."""


def compute_psnr_db(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """Return 10 log10(L² / mean squared difference) with L = data_range; inf for equal images.

    Raises
    ------
    UsageError
        If the shapes differ or the range is not positive.
    """
    x, y = _check_images(image, reference, data_range)
    square = float(np.mean(np.square(x - y)))
    return float("inf") if square == 0.0 else float(10.0 * np.log10(data_range**2 / square))


def compute_ssim(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """Return the mean structural similarity (Wang et al. 2004) of (H, W) or (H, W, C) images.

    Channels are averaged. Local moments use an 11 × 11 Gaussian of σ = 1.5 pixels with unit sum where it fits inside
    the image; C1 = (0.01 L)², C2 = (0.03 L)², L = data_range.

    Raises
    ------
    UsageError
        If the shapes differ, the range is not positive, or an image is smaller than 11 × 11 pixels.
    """
    x, y = _check_images(image, reference, data_range)
    if min(x.shape[:2]) < SSIM_SIDE:
        raise UsageError(f"similarity needs {SSIM_SIDE} × {SSIM_SIDE} pixels, not {x.shape}.")
    mean_x, mean_y = _compute_local_means(x), _compute_local_means(y)
    var_x, var_y = _compute_local_means(x * x) - mean_x**2, _compute_local_means(y * y) - mean_y**2
    covariance = _compute_local_means(x * y) - mean_x * mean_y
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    numerator = (2.0 * mean_x * mean_y + c1) * (2.0 * covariance + c2)
    return float(np.mean(numerator / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))))


def compute_normal_angle_deg(slopes: ArrayLike, reference: ArrayLike) -> float:
    """Return the mean angle [degrees] between the normals of two slope fields (2, H, W)."""
    (gx, gy), (rx, ry) = np.asarray(slopes, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    # Uses |n × m| and n · m of unnormalised normals, since an arc cosine loses all precision at small angles.
    across = np.sqrt((gy - ry) ** 2 + (gx - rx) ** 2 + (gx * ry - gy * rx) ** 2)
    return float(np.degrees(np.mean(np.arctan2(across, 1.0 + gx * rx + gy * ry))))


def compute_rms_slope(slopes: ArrayLike) -> float:
    """Return the root mean square over both slope components."""
    return float(np.sqrt(np.mean(np.square(np.asarray(slopes, dtype=np.float64)))))


def _check_images(image: ArrayLike, reference: ArrayLike, data_range: float) -> tuple[Float, Float]:
    x, y = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim not in (2, 3) or not data_range > 0.0:
        raise UsageError(f"pictures of {x.shape} and {y.shape} with a range of {data_range:g} cannot be compared.")
    return x, y


def _compute_local_means(values: Float) -> Float:
    """Compute Gaussian means along both axes where the window fits."""
    offset = np.arange(SSIM_SIDE) - SSIM_SIDE // 2
    weight = np.exp(-0.5 * np.square(offset / SSIM_SIGMA))
    weight /= weight.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, SSIM_SIDE, axis=axis)
        values = np.asarray(windows @ weight)
    return values


PROBE_NAME = "pen"
BINS_HZ = FREQUENCY_HZ[1:101]


def predict_long_run_spectra(field: Field, tokens: NDArray[np.float32], mechanics: Sequence[Mechanics]) -> Float:
    """Return the (n, 6, 100) density at 10 … 1000 Hz that the field expects of long steady strokes.

    The strokes use the pen under the six conditions of `make_middle_conditions`.

    Parameters
    ----------
    field
        The shared field.
    tokens
        (n, TOKEN_DIM) tokens.
    mechanics
        Mechanics of the n materials.
    """
    count, grid = len(tokens), make_speed_grid()
    spectra = []
    for condition in make_middle_conditions():
        states = States(
            tokens=np.asarray(tokens, dtype=np.float64),
            mechanics=tuple(mechanics),
            material=np.arange(count, dtype=np.int32),
            direction=np.tile([np.cos(condition.angle), np.sin(condition.angle)], (count, 1)),
            speed=np.full(count, grid[condition.speed]),
            force=np.full(count, condition.force),
            contact=np.ones(count, dtype=bool),
            probe=PROBE_NAME,
        )
        amplitude = steady_amplitude(field.config, evaluate(field, states)).sum(axis=1)
        spectra.append(compute_window_densities(field.config.carriers, np.square(amplitude), states.speed))
    return np.stack(spectra, axis=1)


@dataclass(frozen=True)
class SpectrumError:
    """Error of predicted spectra [dB], averaged over conditions; per condition total² = level² + shape².

    Attributes
    ----------
    total
        RMS over the counted bins (see hnf_core.metrics.spectra).
    level
        Absolute mean difference, which a single gain would remove.
    bias
        Mean difference with its sign.
    shape
        RMS of the remainder.
    """

    total: float
    level: float
    bias: float
    shape: float


def compute_spectrum_error(spectra: Float, reference: Float) -> SpectrumError:
    """Compare spectra (6, 100) as returned by predict_long_run_spectra.

    Bins are selected by the level of the reference.
    """
    errors = []
    for predicted, true in zip(spectra, reference, strict=True):
        bins = select_compared_bins(true, BINS_HZ)
        floor = 1e-12 * float(true[bins].max())
        difference_db = 10.0 * np.log10(np.maximum(predicted[bins], floor) / true[bins])
        errors.append(
            (np.sqrt(np.mean(difference_db**2)), abs(difference_db.mean()), difference_db.mean(), difference_db.std())
        )
    total, level, bias, shape = np.mean(errors, axis=0)
    return SpectrumError(float(total), float(level), float(bias), float(shape))


def compute_log_mean(spectra: Float) -> Float:
    """Return the mean level over the first axis."""
    return np.asarray(np.exp(np.mean(np.log(np.maximum(spectra, 1e-30)), axis=0)))


Single = NDArray[np.float32]

TRUTH, FULL_TILE, FLOOR = "true map", "true map, whole tile", "true map, second tile (floor)"
PREDICTED = "predicted"
"""Prefix of the networks' rows; alone, the main network (`make_network_entries` names the rows of both)."""
NO_DEPTH, NO_COLOUR = f"{PREDICTED}, depth unknown", f"{PREDICTED}, color unknown"
DIGIT = f"{PREDICTED}, DIGIT"
NEIGHBOUR, GREY, FLAT = "nearest neighbor", "gray level is height", "flat (mean map)"
CLASS_MEAN, MEAN = "class mean", "mean of all"
FUSED = f"{PREDICTED}, fused with the category's token"
"""Network prediction fused with a prior of the right category (hnf_core.material.fuse), as in the product."""
MIN_RANGE = 1e-4
"""Least value range of a sensor image; below it the image is flat to the eye and in 8 bits."""


@dataclass(frozen=True)
class ImageScore:
    """Image metrics of one method on one view.

    Attributes
    ----------
    psnr_db, ssim
        With data range 1, the scale of the linear image.
    own_psnr_db, own_ssim
        With the range that the true image covers.
    angle_deg
        Mean angle between normals [degrees].
    level_db
        RMS slope relative to the true one [dB].
    """

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
    """Errors of every method on one tile.

    Attributes
    ----------
    errors
        Method → error of its spectra against those of the true map in the same views.
    bands_db
        Method → (7,) level of each of the token's bands relative to the true one [dB].
    """

    tile: str
    class_name: str
    errors: Mapping[str, SpectrumError]
    bands_db: Mapping[str, Float]


Maps = Mapping[str, tuple[str, Single]]
"""Method → (sensor, slopes (views, 2, 64, 64) of the tile's first views)."""


def score_spectra(
    field: Field, encoder: Encoder, tile: HeldOutTile, maps: Maps, baselines: NaiveBaselines | None, main: str = ""
) -> TileResult:
    """Score every method on one tile by the spectra that follow from its slopes.

    Parameters
    ----------
    field, encoder
        The shared field and the token encoder.
    tile
        Tile with true slopes.
    maps
        Slopes of each method in at least TOKEN_VIEWS views.
    baselines
        Baselines from the training set; None omits class mean, mean of all and FUSED.
    main
        Method whose token is fused with the category's, "" = none.
    """
    pitches = [view.pitch_m for view in tile.views[:TOKEN_VIEWS]]

    def token(slopes: Single, sensor: str = PAIR_SENSORS[0]) -> Token:
        return describe_slopes(list(slopes[:TOKEN_VIEWS]), pitches, sensor, encoder)

    truths = {sensor: token(tile.slopes[:, index], sensor).values for index, sensor in enumerate(PAIR_SENSORS)}
    first = PAIR_SENSORS[0]
    tokens = {TRUTH: truths[first], FULL_TILE: tile.full_token, FLOOR: token(tile.second_slopes).values}
    reference_sensor = dict.fromkeys(tokens, first)
    for name, (sensor, slopes) in maps.items():
        predicted = token(slopes, sensor)
        tokens[name], reference_sensor[name] = predicted.values, sensor
        if name == main and baselines is not None:
            tokens[FUSED] = fuse(
                predicted, _compute_category_token(tile, baselines), SAME_CATEGORY_APTNESS, Route.PREDICTED
            ).values
            reference_sensor[FUSED] = sensor
    all_tokens = [*tokens.values(), *truths.values()]
    spectra = predict_long_run_spectra(field, np.stack(all_tokens), [tile.mechanics] * len(all_tokens))
    truth = dict(zip(PAIR_SENSORS, spectra[len(tokens) :], strict=True))
    errors = {
        name: compute_spectrum_error(predicted_spectra, truth[reference_sensor[name]])
        for name, predicted_spectra in zip(tokens, spectra, strict=False)
    }
    if baselines is not None:
        for name, mean in _compute_mean_spectra(field, tile, baselines).items():
            errors[name] = compute_spectrum_error(mean, truth[first])
    bands = {
        name: 20.0 * (values[LEVELS].astype(np.float64) - truths[reference_sensor[name]][LEVELS])
        for name, values in tokens.items()
    }
    return TileResult(tile.name, tile.order.class_name, errors, bands)


def score_images(tile: HeldOutTile, maps: Maps) -> list[ImageScore]:
    """Score each method on each view that it predicted."""
    scores = []
    for name, (sensor, slopes) in maps.items():
        true = tile.slopes[:, PAIR_SENSORS.index(sensor)]
        for view, own, truth in zip(tile.views, slopes, true, strict=False):
            image, reference = render_sensor_image(own, sensor), render_sensor_image(truth, sensor)
            contrast = reference - get_sensor(sensor).background
            span = max(float(contrast.max() - contrast.min()), MIN_RANGE)
            scores.append(
                ImageScore(
                    name, sensor, view.pitch_m, tile.name,
                    compute_psnr_db(image, reference, 1.0), compute_ssim(image, reference, 1.0),
                    compute_psnr_db(image, reference, span), _compute_contrast_ssim(image, reference, sensor, span),
                    compute_normal_angle_deg(own, truth),
                    20.0 * float(np.log10(max(compute_rms_slope(own), 1e-9) / max(compute_rms_slope(truth), 1e-9))),
                )
            )  # fmt: skip
    return scores


def _compute_contrast_ssim(image: Single, reference: Single, sensor: str, span: float) -> float:
    """Compute SSIM without the background, which is equal in both images and would raise the similarity."""
    background = get_sensor(sensor).background
    return compute_ssim(image - background, reference - background, span)


def _compute_mean_spectra(field: Field, tile: HeldOutTile, baselines: NaiveBaselines) -> dict[str, Float]:
    """Return mean log spectra over training tiles with this tile's own mechanics; classes weigh equally.

    Class mean: the classes of the tile's category, or all classes if training has none of it.
    """
    names = sorted(set(baselines.class_name))
    spectra = predict_long_run_spectra(field, baselines.tokens, [tile.mechanics] * len(baselines.tokens))
    class_means = {
        name: compute_log_mean(
            spectra[[row for row, class_name in enumerate(baselines.class_name) if class_name == name]]
        )
        for name in names
    }
    return {
        CLASS_MEAN: compute_log_mean(np.stack([class_means[name] for name in _find_similar_classes(tile, baselines)])),
        MEAN: compute_log_mean(np.stack(list(class_means.values()))),
    }


def _compute_category_token(tile: HeldOutTile, baselines: NaiveBaselines) -> Single:
    """Return the mean token of the training classes of the tile's category, or of all if there are none."""
    names = _find_similar_classes(tile, baselines)
    rows = [[row for row, own in enumerate(baselines.class_name) if own == name] for name in names]
    return np.asarray(np.mean([baselines.tokens[own].mean(axis=0) for own in rows], axis=0), dtype=np.float32)


def _find_similar_classes(tile: HeldOutTile, baselines: NaiveBaselines) -> list[str]:
    names = sorted(set(baselines.class_name))
    return [name for name in names if get_category(name) == tile.category] or names


def average_image_scores(scores: Sequence[ImageScore], method: str, sensor: str, pitch_m: float) -> dict[str, float]:
    """Return means over the views of one method, sensor and pitch; empty if there are none."""
    rows = [
        score for score in scores
        if score.method == method and score.sensor == sensor and abs(score.pitch_m / pitch_m - 1.0) < 1e-6
    ]  # fmt: skip
    if not rows:
        return {}
    numbers = ("psnr_db", "ssim", "own_psnr_db", "own_ssim", "angle_deg", "level_db")
    return {
        "views": float(len(rows)),
        **{name: float(np.mean([getattr(row, name) for row in rows])) for name in numbers},
    }
