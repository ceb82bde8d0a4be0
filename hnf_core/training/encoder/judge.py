"""How far the token of one view is from that of its whole tile, for any make of E."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS, Pairs
from ...material.encoders import Encoder
from ...material.fuse import SIGNIFICANT_DECADES
from ...material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, SMOOTH_LEVEL, TOKEN_DIM
from ...tactile.optics import get_sensor, shade
from ...tactile.tactile_map import Route, TactileMap
from ...tactile.views import PITCHES_M

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

BANDS, WIDTH = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
DB_PER_DECADE = 20.0


@dataclass(frozen=True)
class TokenErrors:
    """level_db: (7,) RMS error of the level per band, longest first. two_fold, four_fold: (7,) RMS error of (cos2,
    sin2) and (cos4, sin4), per component. peak, offset: (7,) RMS error. median_level_db: of |error| over all bands.
    NaN where no view knows a band."""

    level_db: Float
    two_fold: Float
    four_fold: Float
    peak: Float
    offset: Float
    median_level_db: float

    def compute_overall_db(self) -> float:
        """RMS over the bands."""
        return float(np.sqrt(np.nanmean(np.square(self.level_db))))


def make_view_map(pairs: Pairs, row: int, sensor: str) -> TactileMap:
    """The tactile map of one view under a sensor's own lamps."""
    slopes = pairs.slopes[row, PAIR_SENSORS.index(sensor)].astype(np.float64)
    image = shade(slopes[0], slopes[1], get_sensor(sensor))
    pitch = PITCHES_M[int(pairs.pitch_index[row])]
    mask = np.ones(image.shape[:2], dtype=bool)
    return TactileMap(image, None, mask, pitch, sensor, 2.0 * pitch, Route.PREDICTED, "one view")


def describe_single_views(encoder: Encoder, pairs: Pairs, rows: Sequence[int], sensor: str) -> tuple[Float, Mask]:
    """(n, TOKEN_DIM) tokens, each of one view alone, and which of their components are known."""
    tokens = [encoder.describe(make_view_map(pairs, row, sensor)) for row in rows]
    return (
        np.array([token.values for token in tokens], dtype=np.float64).reshape(-1, TOKEN_DIM),
        np.array([token.known for token in tokens], dtype=bool).reshape(-1, TOKEN_DIM),
    )


def compute_token_errors(tokens: Float, known: Mask, expected: Float) -> TokenErrors:
    """Against whole tiles' tokens wanted (n, TOKEN_DIM); bands of the tile with next to nothing in them (see fuse)
    do not count, nor do the directions and peaks of what is not there."""
    levels = expected[:, LEVELS]
    strongest = levels.max(axis=1, keepdims=True)
    counts = known[:, LEVELS] & (levels > np.maximum(strongest - SIGNIFICANT_DECADES, SMOOTH_LEVEL + 0.3))
    error = (tokens - expected)[:, : BANDS * WIDTH].reshape(-1, BANDS, WIDTH)
    level = DB_PER_DECADE * error[:, :, 0]

    def rms(values: Float) -> Float:
        total = np.where(counts, np.square(values), 0.0).sum(axis=0)
        number = counts.sum(axis=0)
        return np.asarray(np.sqrt(np.where(number > 0, total / np.maximum(number, 1), np.nan)))

    return TokenErrors(
        rms(level),
        rms(np.hypot(error[:, :, 1], error[:, :, 2]) / np.sqrt(2.0)),
        rms(np.hypot(error[:, :, 3], error[:, :, 4]) / np.sqrt(2.0)),
        rms(error[:, :, 5]),
        rms(error[:, :, 6]),
        float(np.median(np.abs(level[counts]))) if counts.any() else float("nan"),
    )


def evaluate_encoder(
    encoder: Encoder, pairs: Pairs, rows: Sequence[int] | None = None, sensor: str = "gelsight"
) -> TokenErrors:
    """Errors of an encoder on single views (all where rows is None)."""
    chosen = range(len(pairs)) if rows is None else rows
    tokens, known = describe_single_views(encoder, pairs, chosen, sensor)
    return compute_token_errors(tokens, known, pairs.token[pairs.tile_index[np.asarray(chosen)]].astype(np.float64))


def format_errors(errors: TokenErrors) -> str:
    """One line for metadata and terminals."""
    bands = ", ".join(
        f"{wavelength * 1e3:g} mm {level:.1f}"
        for wavelength, level in zip(BAND_WAVELENGTHS_M, errors.level_db, strict=True)
    )
    return (
        f"level {errors.compute_overall_db():.2f} dB RMS (median {errors.median_level_db:.2f}; {bands}), two-fold "
        f"{_compute_rms(errors.two_fold):.3f}, four-fold {_compute_rms(errors.four_fold):.3f}, peak {_compute_rms(errors.peak):.3f}, offset "
        f"{_compute_rms(errors.offset):.3f} octaves"
    )


def _compute_rms(values: Float) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
