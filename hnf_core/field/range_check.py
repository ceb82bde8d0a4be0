"""Compare a stroke with the field's training ranges: a confidence and warnings in words; nothing is clamped.

Each quantity has an excess: 0 inside its range, growing with the distance outside it (in octaves of speed, force and
stiffness, in eighths of a turn of direction, in widths of a token feature's range). It multiplies the confidence by 1 /
(1 + excess), so that the first octave outside halves it, the second makes it a third, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..material.contact_model import Mechanics
from ..material.probe import get_probe
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, TOKEN_NAMES, band_slice
from .contact.taps import describe_linear_taps, describe_softened_relief, find_tap_spans
from .field import LOG_AMPLITUDE_CEILING, Field, FieldConfig
from .stroke import StrokeInput
from .training_ranges import SECTOR_RAD, TrainingRanges, compute_angle_to_sectors, find_nearest_in_hull

Float = NDArray[np.float64]
Remark = tuple[float, str]
"""An excess above 0, and its warning."""

SLACK = 1.05
"""Ratio to a range's end up to which a value counts as inside."""
SLOW_SHARE = 0.25
"""Fraction of the stroke that may be slower or lighter than trained, because every stroke starts and ends so."""
PATH_SHARE = 0.1
"""Fraction of the path that may lie further outside in speed and force together, or in direction.

Starts and ends cover little of the path.
"""
HULL_SLACK_OCTAVES = 0.25
"""Distance from the hull up to which a pair of speed and force counts as inside [octaves]."""
DIRECTION_SLACK_RAD = SECTOR_RAD
"""Distance from a trained sector up to which a direction counts as inside [rad].

Directions between trained ones are interpolated: up to two sectors without training between two with it.
"""
EIGHTH_TURN_RAD = np.pi / 4.0
MIN_TOKEN_WIDTH = 0.5
"""Smallest width of a token feature's range, for fields trained on one material or nearly: 10 dB of a level."""
FAR_WIDTHS = 0.25
"""Excess of a token feature beyond which the surface counts as unlike any in training."""
MIN_ANISOTROPY = 0.3
"""Fraction of the waves' power running one way from which a direction is perceptible."""
CATEGORY_EXCESS = 1.0
"""Excess of differences without a distance: another probe, or a property known here but never in training, or vice
versa."""
MIN_MOVING_SPEED_M_S = 1e-4
"""Speed from which a hand that also moves faster counts as moving [m/s]."""
CEILING_SHARE = 0.5
"""Fraction of the output ceiling from which there is a warning."""
UNTRAINED_CONFIDENCE = 0.2
_UNITS = {
    "stiffness_n_m": ("Stiffness", " N/m"),
    "damping_ratio": ("The damping ratio", ""),
    "friction": ("Friction", ""),
}


def check_ranges(field: Field, stroke: StrokeInput, action: Action) -> tuple[float, tuple[str, ...]]:
    """Compare a stroke with the field's training ranges.

    Parameters
    ----------
    field
        The field.
    stroke
        The stroke.
    action
        The stroke's action at ACTION_RATE_HZ.

    Returns
    -------
    confidence : float
        0 … 1, exactly 1 inside every range.
    warnings : tuple of str
        One per quantity outside its range, with values and units.
    """
    ranges = field.ranges
    if ranges is None:
        return UNTRAINED_CONFIDENCE, ("The field is not trained.",)
    touching = action.contact & (action.force > 0.0)
    if not touching.any():
        return 1.0, ("The stroke never touches anything: the signal is silent.",)
    moving = touching & (action.speed > MIN_MOVING_SPEED_M_S)
    if not moving.any():  # All of it is as slow as a hand that comes to rest is for a moment: that is its speed.
        moving = touching & (action.speed > 0.0)
    tapping, tap_remarks = _check_taps(stroke, action)
    # Where the hand stands, the field is silent, and a tap is the whole contact's, which has no training range.
    touching &= moving | ~tapping
    if not touching.any():
        return _summarise(tap_remarks)
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
        *tap_remarks,
    ]
    return _summarise(remarks)


def _summarise(remarks: list[Remark]) -> tuple[float, tuple[str, ...]]:
    """Return the confidence that the excesses leave, and the warnings."""
    confidence = np.prod([1.0 / (1.0 + excess) for excess, _ in remarks])
    return float(confidence), tuple(text for _, text in remarks)


def check_ceiling(config: FieldConfig, loudest: float) -> tuple[str, ...]:
    """Return a warning if the field's log amplitude comes near LOG_AMPLITUDE_CEILING, the limit of its output.

    loudest: largest amplitude after weighting over past states [m/s²], which may lie below the ceiling although the
    output reached it.
    """
    ceiling = float(np.exp(LOG_AMPLITUDE_CEILING))
    if config.emission != "log" or loudest < CEILING_SHARE * ceiling:
        return ()
    limited = f"its output is held at {_format_number(ceiling)} m/s²; no touch is so loud"
    return (f"The field comes to {_format_number(loudest)} m/s² in one band, where {limited}.",)


def _check_taps(stroke: StrokeInput, action: Action) -> tuple[NDArray[np.bool_], list[Remark]]:
    """Return at which states (n,) the whole contact is integrated, and a remark if it should be but is too stiff."""
    tapping, probe = np.zeros(len(action.force), dtype=bool), get_probe(action.probe)
    spans = find_tap_spans(np.where(action.contact, action.force, 0.0), action.force_curve)
    problem = ""
    if stroke.profile is not None and len(stroke.profile.height) > 1:
        problem = describe_softened_relief(stroke.mechanics, probe)
    elif spans:
        when = f" from {_format_number((spans[0][0] + 1) / ACTION_RATE_HZ)} s on"
        problem = describe_linear_taps(stroke.mechanics, probe, when)
    if problem:
        return tapping, [(CATEGORY_EXCESS, problem)]
    for begin, end in spans:
        tapping[max(begin, 0) : end + 1] = True
    return tapping, []


def _check_span(name: str, unit: str, scale: float, values: Float, limits: tuple[float, float]) -> Iterator[Remark]:
    """Yield (excess, remark) if values (n,) leave the training range `limits` (low, high).

    name, unit, scale: of the quantity in the remark, where values are multiplied by scale.
    """
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
    """Yield (excess, remark) if speed and force are each in range, but never occurred together in training."""
    if ranges.hull is None or len(speed) == 0:
        return
    box = np.log2(np.array([ranges.speed, ranges.force]))
    # Values outside the box have a remark of their own, so only the distance inside it counts here.
    pairs = np.clip(np.log2(np.stack([speed, force], axis=1)), box[:, 0], box[:, 1])
    nearest_pairs = find_nearest_in_hull(np.log2(ranges.hull), pairs)
    excess = np.linalg.norm(pairs - nearest_pairs, axis=1)
    state = _find_path_quantile(excess, speed)
    if excess[state] > HULL_SLACK_OCTAVES:
        (v, f), (trained_v, trained_f) = np.exp2(pairs[state]), np.exp2(nearest_pairs[state])
        nearest = f"{_format_number(trained_v * 1e3)} mm/s with {_format_number(trained_f)} N"
        pair = f"{_format_number(v * 1e3)} mm/s together with {_format_number(f)} N"
        yield float(excess[state]), f"{pair} was never trained; the nearest is {nearest}."


def _check_direction(direction: Float, speed: Float, field: Field, tokens: NDArray[np.float32]) -> Iterator[Remark]:
    """Yield a remark on a direction that was not trained, or on an oriented surface if no direction was."""
    sectors = None if field.ranges is None else field.ranges.sectors
    if sectors is None or len(speed) == 0:
        return
    if not sectors or not field.config.directed:
        anisotropy = _measure_anisotropy(tokens)
        if anisotropy > MIN_ANISOTROPY:
            text = f"Training never told directions apart, but {anisotropy:.0%} of this surface's waves run one way"
            yield anisotropy, f"{text}: it is felt alike in every direction."
        return
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    distance, nearest = compute_angle_to_sectors(sectors, angle)
    state = _find_path_quantile(distance, speed)
    excess = float(distance[state]) - DIRECTION_SLACK_RAD
    if excess > 1e-9:
        trained = (np.degrees(nearest[state] * SECTOR_RAD) + 180.0) % 360.0 - 180.0
        text = f"Direction {np.degrees(angle[state]):.0f}° (0° is left to right) was never trained; the nearest is"
        yield excess / EIGHTH_TURN_RAD, f"{text} {trained:.0f}°."


def _check_token(tokens: NDArray[np.float32], ranges: TrainingRanges) -> Iterator[Remark]:
    """Yield a remark on the feature of the material token furthest outside training, in widths of its range."""
    width = np.maximum(ranges.token_high - ranges.token_low, MIN_TOKEN_WIDTH)
    excess = np.maximum(ranges.token_low - tokens, tokens - ranges.token_high) / width
    excess = np.where(_informative_features(tokens), excess, 0.0)
    material, feature = np.unravel_index(np.argmax(excess), excess.shape)
    worst = float(excess[material, feature])
    if worst > SLACK - 1.0:
        name, unit, value = _describe_feature(int(feature))
        low, high = sorted((value(float(ranges.token_low[feature])), value(float(ranges.token_high[feature]))))
        shown = _format_number(value(float(tokens[material, feature])))
        text = f"{name} is {shown}{unit}, trained on {_format_number(low)}–{_format_number(high)}{unit}"
        if worst > FAR_WIDTHS:
            yield (
                worst,
                f"Its surface is unlike all that the field knows, so that the signal is a guess there ({text}).",
            )
        else:
            yield worst, f"Its surface is a little unlike those that the field knows: the feel is less sure ({text})."


def _check_mechanics(mechanics: list[Mechanics], ranges: TrainingRanges) -> Iterator[Remark]:
    """Yield remarks on stiffness, damping or friction outside its range, or known or unknown unlike in training."""
    for name, trained_range in (ranges.mechanics or {}).items():
        label, unit = _UNITS[name]
        values = [getattr(properties, name) for properties in mechanics]
        known = [float(value) for value in values if value is not None]
        if len(known) < len(values) and not trained_range.unknown:
            yield CATEGORY_EXCESS, f"{label} is unknown here; in training it was always given."
        if not known:
            continue
        if trained_range.span is None:
            yield CATEGORY_EXCESS, f"{label} is {_format_number(known[0])}{unit}; training never gave it."
            continue
        (low, high), smallest, largest = trained_range.span, min(known), max(known)
        trained = f"trained on {_format_number(low)}–{_format_number(high)}{unit}"
        if largest > high * SLACK:
            yield _octaves_between(largest, high), f"{label} is {_format_number(largest)}{unit}, {trained}."
        if smallest < low / SLACK:
            yield _octaves_between(low, smallest), f"{label} is {_format_number(smallest)}{unit}, {trained}."


def _check_probe(probe: str, ranges: TrainingRanges) -> Iterator[Remark]:
    """Yield a remark on a probe that was not trained with."""
    if ranges.probes is not None and probe not in ranges.probes:
        yield CATEGORY_EXCESS, f"Touched with the {probe}; trained with the {' and the '.join(ranges.probes)}."


def _find_path_quantile(excess: Float, speed: Float) -> int:
    """Return the index of the state that represents the excess: larger ones cover less than PATH_SHARE of the path."""
    order = np.argsort(-excess, kind="stable")
    path = np.cumsum(speed[order])
    return int(order[np.searchsorted(path, PATH_SHARE * path[-1])])


def _format_number(value: float) -> str:
    """Format three significant digits without an exponent (10000, not 1e+04)."""
    return f"{float(f'{value:.3g}'):.12g}"


def _octaves_between(above: float, below: float) -> float:
    """Return log2 of the ratio; a value of 0 counts as a thousandth of the other."""
    return float(np.log2(above / max(below, 1e-3 * above)))


def _measure_anisotropy(tokens: NDArray[np.float32]) -> float:
    """Return the largest two-fold anisotropy (0 … 1) of any material, each judged by its strongest wavelength band."""
    band = np.argmax(tokens[:, LEVELS], axis=1)
    start = np.array([band_slice(int(index)).start for index in band])
    rows = np.arange(len(tokens))
    return float(min(1.0, np.hypot(tokens[rows, start + 1], tokens[rows, start + 2]).max()))


def _informative_features(tokens: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (M, TOKEN_DIM) which features of M tokens count in the comparison.

    Direction features of a band 20 dB below the strongest are mostly leakage from neighbouring bands.
    """
    out = np.ones(tokens.shape, dtype=bool)
    levels = tokens[:, LEVELS]
    faint = levels < levels.max(axis=1, keepdims=True) - 1.0
    for band in range(levels.shape[1]):
        features = band_slice(band)
        out[faint[:, band], features.start + 1 : features.stop] = False
    return out


def _describe_feature(feature: int) -> tuple[str, str, Callable[[float], float]]:
    """Return the name of a token feature in words, its unit, and a function to its value in that unit."""
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
