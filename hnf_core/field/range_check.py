"""How far a stroke leaves what the field was trained on: said in words, never clamped.

Each quantity has an excess: 0 inside its range, growing with the distance outside it (octaves of speed, force and
stiffness, an eighth of a turn of direction, widths of the token's range). It multiplies the confidence by
1 / (1 + excess), so that every octave outside halves it, then thirds it, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..material.contact_model import Mechanics
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, TOKEN_NAMES, band_slice
from .field import LOG_AMPLITUDE_CEILING, Field, FieldConfig
from .stroke import StrokeInput
from .training_ranges import SECTOR_RAD, TrainingRanges, compute_angle_to_sectors, find_nearest_in_hull

Float = NDArray[np.float64]
Remark = tuple[float, str]
"""An excess above 0, and what to say of it."""

SLACK = 1.05
SLOW_SHARE = 0.25
"""Every stroke starts and ends slowly and lightly; only more than this share of it is worth a word."""
PATH_SHARE = 0.1
"""A pair of speed and force, or a direction, counts where more than this share of the path is further out: starts and
ends cover little of it."""
HULL_SLACK_OCTAVES = 0.25
DIRECTION_SLACK_RAD = SECTOR_RAD
"""Directions between trained ones are interpolated: up to two sectors without training between two that had it."""
EIGHTH_TURN_RAD = np.pi / 4.0
MIN_TOKEN_WIDTH = 0.5
"""Range of a token feature trained on one material, or nearly: 10 dB of a level."""
FAR_WIDTHS = 0.25
"""Beyond this a surface is called unlike any in training."""
MIN_ANISOTROPY = 0.3
"""Share of the waves' power that runs one way from which a direction can be felt."""
CATEGORY_EXCESS = 1.0
"""Excess of what has no distance: another probe, a value given that never was (or left open that never was)."""
MIN_MOVING_SPEED_M_S = 1e-4
CEILING_SHARE = 0.5
UNTRAINED_CONFIDENCE = 0.2
_UNITS = {
    "stiffness_n_m": ("Stiffness", " N/m"),
    "damping_ratio": ("The damping ratio", ""),
    "friction": ("Friction", ""),
}


def check_ranges(field: Field, stroke: StrokeInput, action: Action) -> tuple[float, tuple[str, ...]]:
    """Confidence 0 … 1 and warnings, with values and units, from all that field.ranges has on record.

    Inside every range it is exactly 1 and nothing is said. action: the stroke's own, at the rate it is felt at.
    """
    ranges = field.ranges
    if ranges is None:
        return UNTRAINED_CONFIDENCE, ("The field is not trained.",)
    touching = action.contact & (action.force > 0.0)
    if not touching.any():
        return 1.0, ("The stroke never touches anything: the signal is silent.",)
    moving = touching & (action.speed > MIN_MOVING_SPEED_M_S)
    touched = np.unique(stroke.token_index[stroke.action.contact])
    tokens, mechanics = stroke.tokens[touched], [stroke.mechanics[index] for index in touched]
    remarks = [
        *_check_span("Speed", " mm/s", 1e3, action.speed[moving], ranges.speed),
        *_check_span("Force", " N", 1.0, action.force[touching], ranges.force),
        *_check_speed_force_pair(action.speed[moving], action.force[moving], ranges),
        *_check_direction(action.direction[moving], action.speed[moving], field, tokens),
        *_check_token(tokens, ranges),
        *_check_mechanics(mechanics, ranges),
        *_check_probe(action.probe, ranges),
    ]
    confidence = np.prod([1.0 / (1.0 + excess) for excess, _ in remarks])
    return float(confidence), tuple(text for _, text in remarks)


def check_ceiling(config: FieldConfig, loudest: float) -> tuple[str, ...]:
    """A warning where the field's output nears its ceiling, LOG_AMPLITUDE_CEILING, or was held there.

    loudest: its largest accumulated amplitude, m/s²; memory's weights may leave some of a ceiling off.
    """
    ceiling = float(np.exp(LOG_AMPLITUDE_CEILING))
    if config.emission != "log" or loudest < CEILING_SHARE * ceiling:
        return ()
    held = f"its output is held at {_format_number(ceiling)} m/s²; no touch is so loud"
    return (f"The field comes to {_format_number(loudest)} m/s² in one band, where {held}.",)


def _check_span(name: str, unit: str, scale: float, values: Float, limits: tuple[float, float]) -> Iterator[Remark]:
    if len(values) == 0:
        return
    trained = f"trained on {_format_number(limits[0] * scale)}–{_format_number(limits[1] * scale)}{unit}"
    high, low = float(values.max()), float(np.quantile(values, SLOW_SHARE))
    if high > limits[1] * SLACK:
        yield float(np.log2(high / limits[1])), f"{name} reaches {_format_number(high * scale)}{unit}, {trained}."
    if low < limits[0] / SLACK:
        text = f"{name} is {_format_number(low * scale)}{unit} or less for {SLOW_SHARE:.0%} of the stroke, {trained}."
        yield float(np.log2(limits[0] / low)), text


def _check_speed_force_pair(speed: Float, force: Float, ranges: TrainingRanges) -> Iterator[Remark]:
    """Speed and force each in range, but never met together: a corner of the box without training."""
    if ranges.hull is None or len(speed) == 0:
        return
    box = np.log2(np.array([ranges.speed, ranges.force]))
    # What lies outside the box was said already; inside it the nearest trained pair is what counts.
    pairs = np.clip(np.log2(np.stack([speed, force], axis=1)), box[:, 0], box[:, 1])
    near = find_nearest_in_hull(np.log2(ranges.hull), pairs)
    excess = np.linalg.norm(pairs - near, axis=1)
    at = _find_path_quantile(excess, speed)
    if excess[at] > HULL_SLACK_OCTAVES:
        (v, f), (trained_v, trained_f) = np.exp2(pairs[at]), np.exp2(near[at])
        nearest = f"{_format_number(trained_v * 1e3)} mm/s with {_format_number(trained_f)} N"
        pair = f"{_format_number(v * 1e3)} mm/s together with {_format_number(f)} N"
        yield float(excess[at]), f"{pair} was never trained; the nearest is {nearest}."


def _check_direction(direction: Float, speed: Float, field: Field, tokens: NDArray[np.float32]) -> Iterator[Remark]:
    sectors = None if field.ranges is None else field.ranges.sectors
    if sectors is None or len(speed) == 0:
        return
    if not sectors or not field.config.directed:
        share = _measure_anisotropy(tokens)
        if share > MIN_ANISOTROPY:
            text = f"Training never told directions apart, but {share:.0%} of this surface's waves run one way"
            yield share, f"{text}: it is felt alike in every direction."
        return
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    apart, nearest = compute_angle_to_sectors(sectors, angle)
    at = _find_path_quantile(apart, speed)
    excess = float(apart[at]) - DIRECTION_SLACK_RAD
    if excess > 1e-9:
        trained = (np.degrees(nearest[at] * SECTOR_RAD) + 180.0) % 360.0 - 180.0
        text = f"Direction {np.degrees(angle[at]):.0f}° (0° is left to right) was never trained; the nearest is"
        yield excess / EIGHTH_TURN_RAD, f"{text} {trained:.0f}°."


def _check_token(tokens: NDArray[np.float32], ranges: TrainingRanges) -> Iterator[Remark]:
    """The token feature furthest outside training among the touched materials, in widths of its range."""
    width = np.maximum(ranges.token_high - ranges.token_low, MIN_TOKEN_WIDTH)
    excess = np.maximum(ranges.token_low - tokens, tokens - ranges.token_high) / width
    excess = np.where(_informative_features(tokens), excess, 0.0)
    material, feature = np.unravel_index(np.argmax(excess), excess.shape)
    worst = float(excess[material, feature])
    if worst > SLACK - 1.0:
        what, unit, value = _describe_feature(int(feature))
        low, high = sorted((value(float(ranges.token_low[feature])), value(float(ranges.token_high[feature]))))
        found = _format_number(value(float(tokens[material, feature])))
        text = f"{what} is {found}{unit}, trained on {_format_number(low)}–{_format_number(high)}{unit}"
        if worst > FAR_WIDTHS:
            yield (
                worst,
                f"Its surface is unlike all that the field knows, so that the signal is a guess there ({text}).",
            )
        else:
            yield worst, f"Its surface is a little unlike those that the field knows: the feel is less sure ({text})."


def _check_mechanics(mechanics: list[Mechanics], ranges: TrainingRanges) -> Iterator[Remark]:
    for name, given in (ranges.mechanics or {}).items():
        what, unit = _UNITS[name]
        values = [getattr(each, name) for each in mechanics]
        known = [float(value) for value in values if value is not None]
        if len(known) < len(values) and not given.unknown:
            yield CATEGORY_EXCESS, f"{what} is unknown here; in training it was always given."
        if not known:
            continue
        if given.span is None:
            yield CATEGORY_EXCESS, f"{what} is {_format_number(known[0])}{unit}; training never gave it."
            continue
        (low, high), least, most = given.span, min(known), max(known)
        trained = f"trained on {_format_number(low)}–{_format_number(high)}{unit}"
        if most > high * SLACK:
            yield _octaves_between(most, high), f"{what} is {_format_number(most)}{unit}, {trained}."
        if least < low / SLACK:
            yield _octaves_between(low, least), f"{what} is {_format_number(least)}{unit}, {trained}."


def _check_probe(probe: str, ranges: TrainingRanges) -> Iterator[Remark]:
    if ranges.probes is not None and probe not in ranges.probes:
        yield CATEGORY_EXCESS, f"Touched with the {probe}; trained with the {' and the '.join(ranges.probes)}."


def _find_path_quantile(excess: Float, speed: Float) -> int:
    """The state beyond whose excess less than PATH_SHARE of the path lies."""
    order = np.argsort(-excess, kind="stable")
    path = np.cumsum(speed[order])
    return int(order[np.searchsorted(path, PATH_SHARE * path[-1])])


def _format_number(value: float) -> str:
    """Three significant digits, without an exponent where people write none (10000, not 1e+04)."""
    return f"{float(f'{value:.3g}'):.12g}"


def _octaves_between(above: float, below: float) -> float:
    """log2 of the ratio; where one is 0, as if it were a thousandth of the other."""
    return float(np.log2(above / max(below, 1e-3 * above)))


def _measure_anisotropy(tokens: NDArray[np.float32]) -> float:
    """Two-fold anisotropy of the strongest band, of the material where it is largest: 0 … 1."""
    band = np.argmax(tokens[:, LEVELS], axis=1)
    start = np.array([band_slice(int(each)).start for each in band])
    rows = np.arange(len(tokens))
    return float(min(1.0, np.hypot(tokens[rows, start + 1], tokens[rows, start + 2]).max()))


def _informative_features(tokens: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(M, TOKEN_DIM) which features matter: how waves run says little in a band 20 dB below the strongest, where it
    is mostly what leaks from the neighbours."""
    out = np.ones(tokens.shape, dtype=bool)
    levels = tokens[:, LEVELS]
    faint = levels < levels.max(axis=1, keepdims=True) - 1.0
    for band in range(levels.shape[1]):
        features = band_slice(band)
        out[faint[:, band], features.start + 1 : features.stop] = False
    return out


def _describe_feature(feature: int) -> tuple[str, str, Callable[[float], float]]:
    """What a token feature is called, its unit, and its value in that unit."""
    name, _, wave = TOKEN_NAMES[feature].partition("@")
    if name == "skewness":
        return "the skewness of its pits and grains", "", float
    if name == "log_kurtosis":
        return "the kurtosis of its pits and grains", "", lambda value: 3.0 * 10.0**value
    waves = f"of its waves about {wave.removesuffix('mm')} mm long"
    if name == "level":
        return f"the height {waves}", " µm RMS", lambda value: 1e6 * 10.0**value
    if name == "peak":
        return f"the regularity {waves}", "", float
    if name == "offset":
        centre = float(BAND_WAVELENGTHS_M[feature // len(BAND_FEATURES)])
        return f"the pitch {waves}", " mm", lambda value: 1e3 * centre / 2.0**value
    return f"the orientation ({name}) {waves}", "", float
