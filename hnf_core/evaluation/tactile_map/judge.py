"""Every method on every tile: the slopes it gives, the token and the spectra that follow, and how far off they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS
from ...field.field import Field
from ...material.encoders import Encoder
from ...material.fuse import fuse
from ...material.prior import SAME_CATEGORY_APTNESS
from ...material.token import LEVELS, Token
from ...simulation.classes import get_category
from ...tactile.optics import get_sensor
from ...tactile.tactile_map import Route
from .image_quality import compute_normal_angle_deg, compute_psnr_db, compute_rms_slope, compute_ssim
from .learned import NaiveBaselines
from .spectra import SpectrumError, compute_log_mean, compute_spectrum_error, predict_long_run_spectra
from .tiles import TOKEN_VIEWS, HeldOutTile, describe_slopes, render_sensor_image

Float = NDArray[np.float64]
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
