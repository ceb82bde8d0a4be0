"""How far a stroke leaves what the field was trained on: said in words, never clamped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..material.token import LEVELS, TOKEN_NAMES, band_slice
from .field import Field, Ranges
from .stroke import StrokeInput

SLACK = 1.05
SLOW_SHARE = 0.25
"""Every stroke starts and ends slowly and lightly; only more than this share of it is worth a word."""
UNTRAINED = 0.2


def examine(field: Field, stroke: StrokeInput, action: Action) -> tuple[float, tuple[str, ...]]:
    """Confidence 0 … 1 and warnings, from speed, force and tokens against field.ranges."""
    ranges = field.ranges
    if ranges is None:
        return UNTRAINED, ("The field is not trained.",)
    factors, warnings = [1.0], []
    touching = action.contact & (action.force > 0.0)
    moving = touching & (action.speed > 1e-4)
    if not touching.any():
        return 1.0, ("The stroke never touches anything: the signal is silent.",)
    for name, unit, scale, values, limits in (
        ("speed", "mm/s", 1e3, action.speed[moving], ranges.speed),
        ("force", "N", 1.0, action.force[touching], ranges.force),
    ):
        if len(values) == 0:
            continue
        span = f"{limits[0] * scale:g}–{limits[1] * scale:g} {unit}"
        if values.max() > limits[1] * SLACK:
            factors.append(limits[1] / float(values.max()))
            warnings.append(f"{name.capitalize()} reaches {values.max() * scale:.3g} {unit}, trained on {span}.")
        if np.mean(values < limits[0] / SLACK) > SLOW_SHARE:
            factors.append(0.8)
            warnings.append(f"{name.capitalize()} stays below {limits[0] * scale:g} {unit}, trained on {span}.")
    worst, excess = _worst_feature(stroke, ranges)
    if excess > SLACK - 1.0:
        factors.append(1.0 / (1.0 + excess))
        warnings.append(f"Its surface is unlike any in training ({_in_words(worst)}): the signal is a guess there.")
    return float(np.prod(factors)), tuple(warnings)


def _worst_feature(stroke: StrokeInput, ranges: Ranges) -> tuple[int, float]:
    """The token feature furthest outside training among the touched materials, and how far (in training widths)."""
    touched = stroke.tokens[np.unique(stroke.token_index[stroke.action.contact])]
    width = np.maximum(ranges.token_high - ranges.token_low, 1e-3)
    excess = np.maximum(ranges.token_low - touched, touched - ranges.token_high) / width
    excess = np.where(_tells(touched), excess, 0.0).max(axis=0)
    worst = int(np.argmax(excess))
    return worst, float(excess[worst])


def _tells(tokens: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(M, TOKEN_DIM) which features matter: how waves run says little in a band 20 dB below the strongest, where it
    is mostly what leaks from the neighbours."""
    out = np.ones(tokens.shape, dtype=bool)
    levels = tokens[:, LEVELS]
    faint = levels < levels.max(axis=1, keepdims=True) - 1.0
    for band in range(levels.shape[1]):
        features = band_slice(band)
        out[faint[:, band], features.start + 1 : features.stop] = False
    return out


def _in_words(feature: int) -> str:
    name, _, wave = TOKEN_NAMES[feature].partition("@")
    if not wave:
        return "the shape of its pits and grains"
    what = {"level": "the height", "peak": "the regularity", "offset": "the pitch"}.get(name, "the direction")
    return f"{what} of its waves about {wave.removesuffix('mm')} mm long"
