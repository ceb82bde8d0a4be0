"""Evaluate the field F_Θ for a stroke and prepare what its samples are then rendered from.

`prepare_stroke` turns a StrokeInput into a PreparedStroke: F_Θ is evaluated at every state of the action (200 Hz), a
chunk of states at a time, or with a tolerance at the fewer samples that adaptive_sampling chooses. The module also
finds the audible spans of a stroke and splits them into blocks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..material.contact_model import tip_response
from ..material.probe import PROBES
from .adaptive_sampling import (
    EvaluateAt,
    SampledEmission,
    Samples,
    accumulate_samples,
    find_breakpoints,
    sample_adaptively,
)
from .carriers import MODEL_RATE_HZ, Carriers
from .contact_filter import FilterBank, build_filter_bank
from .field import (
    BATCH_STATES,
    Emission,
    Evaluator,
    Field,
    accumulate,
    concatenate_emissions,
    evaluate,
    evaluate_batched,
    find_kernel,
)
from .height_profile import ProfileBands, share_power, split_profile
from .linear_contact import BAND_END_HZ, FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, upper_fade
from .noise_cache import HOP_SIZE
from .stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    build_condition,
    find_peak_speed,
    interpolate_condition,
    resample_action,
    sample_count,
)

Float = NDArray[np.float64]

BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06
"""Times before and after contact beyond which the signal is exactly zero [s]."""
BLOCK_SAMPLES = HOP_SIZE
"""Samples of a block, the unit that a small change renders again; the last bit of the profile term depends on it."""
MAX_JOINED_BLOCKS = 32
"""Adjacent audible blocks that are rendered together: 13 s, whose carriers are in memory at once."""


def compute_audible_gain(contact: NDArray[np.bool_], count: int) -> Float:
    """Compute a gain (count,) on the samples: 1 in contact, with fades to exactly 0 before and after it.

    contact: (n,) at the 200 Hz states. The fades last BEFORE_CONTACT_S and AFTER_CONTACT_S.
    """
    indices = np.flatnonzero(contact)
    if len(indices) == 0:
        return np.zeros(count)
    touched, out = contact.astype(bool), np.ones(count)
    # The gain is 1 between two states if one of them touches; few samples of most strokes lie elsewhere.
    away = np.flatnonzero(~(touched[:-1] | touched[1:]))
    sample = (SAMPLES_PER_STATE * away[:, None] + np.arange(SAMPLES_PER_STATE)).ravel()
    state = sample / SAMPLES_PER_STATE
    following = np.searchsorted(indices, state)
    ahead = np.where(following < len(indices), indices[np.minimum(following, len(indices) - 1)] - state, np.inf)
    behind = np.where(following > 0, state - indices[np.maximum(following - 1, 0)], np.inf)
    per_state = SAMPLES_PER_STATE / MODEL_RATE_HZ
    ahead, behind = np.maximum(ahead - 1.0, 0.0) * per_state, np.maximum(behind - 1.0, 0.0) * per_state
    fade = np.maximum(1.0 - ahead / BEFORE_CONTACT_S, 1.0 - behind / AFTER_CONTACT_S)
    out[sample] = np.sin(0.5 * np.pi * np.clip(fade, 0.0, 1.0)) ** 2
    return out


def is_audible(audible: Float) -> bool:
    """Return True if a gain (count,) is above 0 anywhere; the max() is faster than any()."""
    return bool(audible.max(initial=0.0) > 0.0)


def split_blocks(count: int) -> list[tuple[int, int]]:
    """Return (start, length) of the blocks in which count samples are rendered."""
    return [(start, min(BLOCK_SAMPLES, count - start)) for start in range(0, count, BLOCK_SAMPLES)]


def find_audible_spans(audible: Float) -> Iterator[tuple[int, int]]:
    """Yield (start, length) [samples] of each run of blocks in which a gain (count,) is above 0.

    A run has at most MAX_JOINED_BLOCKS blocks.
    """
    begin, end = 0, 0
    for start, count in split_blocks(len(audible)):
        if not is_audible(audible[start : start + count]):
            continue
        if end > begin and (start > end or start - begin == MAX_JOINED_BLOCKS * BLOCK_SAMPLES):
            yield begin, end - begin
            begin = start
        begin, end = (start, start + count) if end == begin else (begin, start + count)
    if end > begin:
        yield begin, end - begin


CHUNK_STATES = 128
"""Action states in a chunk, the unit in which F_Θ is evaluated.

In numpy results depend on how many states are evaluated at once, so this is part of the byte-exact contract.
"""


@dataclass(frozen=True)
class PreparedStroke:
    """Stroke with F_Θ evaluated: everything needed to render any block of its samples.

    Attributes
    ----------
    amplitude
        (m, heads, K) of the noise carriers, linear in time between knots.
    force
        (n,) pressing force [N] at the 200 Hz states.
    audible
        (count,) gain 0 … 1, zero far from contact.
    profile_amplitude
        (n, Ka) factor on each band of the height profile.
    loudest
        The field's largest amplitude in each chunk of states [m/s²].
    unbridged
        profile_amplitude as it was before bridge_rest_gaps().
    knots
        (m,) 10 kHz samples at which amplitude is given; None if it is at each of the n states.
    residual_power
        Error power of interpolating between knots, relative to the signal's power, see SampledEmission.
    origin
        Sample of the carriers' clock at which this begins, if it is a chunk of a longer stroke.
    """

    carriers: Carriers
    seed: int
    action: Action
    amplitude: NDArray[np.floating[Any]]
    bank: FilterBank
    force: Float
    audible: Float
    bands: ProfileBands | None = None
    profile_amplitude: Float | None = None
    loudest: Float = field(default_factory=lambda: np.zeros(0))
    unbridged: Float | None = None
    knots: NDArray[np.int64] | None = None
    residual_power: float = 0.0
    origin: int = 0

    @property
    def count(self) -> int:
        """Number of samples at 10 kHz."""
        return len(self.audible)


def prepare_stroke(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: PreparedStroke | None = None,
    tolerance: float | None = None,
    evaluator: Evaluator = evaluate,
) -> PreparedStroke:
    """Evaluate F_Θ for a stroke and prepare it for rendering.

    Parameters
    ----------
    field
        The field.
    stroke
        The stroke.
    seed
        Seed of the carriers' noise.
    earlier
        Prepared stroke that differs in force and contact alone; then only chunks of states in which they differ are
        evaluated; the result is the same as without it.
    tolerance
        Largest RMS error due to interpolated amplitudes, relative to the RMS of the whole stroke. F_Θ is then evaluated
        at adaptive samples instead of at every state. Ignored if the stroke has a height profile or the field
        accumulates over heads.
    evaluator
        Function that evaluates the field at n states, in place of field.evaluate.

    Returns
    -------
    PreparedStroke
        Everything needed to render any block of samples.

    Raises
    ------
    StrokeError
        If the action has no duration.
    """
    action, token_index = resample_action(stroke)
    if tolerance is not None and supports_tolerance(field, stroke):
        evaluate_at = make_evaluate_at(field, stroke, action, token_index, evaluator)
        breakpoints = find_breakpoints(action, token_index)
        sampled = sample_adaptively(evaluate_at, sample_count(action), tolerance, breakpoints)
        return prepare_sampled(field, stroke, seed, action, token_index, sampled)
    condition = build_condition(stroke, action, token_index)
    carriers, count = field.config.carriers, len(action.speed)
    bands = None
    if stroke.profile is not None and carriers.arc_count:
        bands = split_profile(stroke.profile, carriers) if earlier is None else earlier.bands
    frequency = arc_band_frequency(action, carriers)
    if earlier is None:
        amplitude = np.empty((count, field.config.alpha_heads, carriers.count))
        unbridged = None if bands is None else np.empty((count, carriers.arc_count))
        loudest = np.empty(-(-count // CHUNK_STATES))
    else:
        amplitude, loudest = earlier.amplitude.copy(), earlier.loudest.copy()
        unbridged = None if earlier.unbridged is None else earlier.unbridged.copy()
    cache = None
    if earlier is None and find_kernel(field) is not None:  # Results do not depend on the number of states in a batch.
        cache = _EmissionCache(field, condition, evaluator)
    for chunk, (rows, with_memory) in enumerate(iterate_state_chunks(field, count)):
        if earlier is not None and not _inputs_differ(action, earlier.action, with_memory):
            continue
        if has_no_contact(condition, with_memory):
            amplitude[rows], loudest[chunk] = 0.0, 0.0
            if unbridged is not None:
                unbridged[rows] = 0.0
            continue
        if cache is not None:
            emission = cache.rows(with_memory)
        else:
            emission = evaluate_batched(field, condition.rows(with_memory), evaluator)
        amplitude[rows], height, loudest[chunk] = _compute_amplitudes(
            field, condition, emission, bands, frequency[rows], rows
        )
        if unbridged is not None and height is not None:
            unbridged[rows] = height
    profile_amplitude = None
    if unbridged is not None:
        sliding = condition.contact & (condition.force > FORCE_FLOOR_N) & (condition.speed > SPEED_FLOOR_M_S)
        profile_amplitude = bridge_rest_gaps(unbridged, sliding) * upper_fade(frequency)
    pressed = np.where(action.contact, action.force, 0.0)
    if earlier is not None and np.array_equal(action.contact, earlier.action.contact):
        audible = earlier.audible
    else:
        audible = compute_audible_gain(action.contact, sample_count(action))
    bank = build_filter_bank(stroke.mechanics, token_index, pressed, action.probe)
    return PreparedStroke(
        carriers, seed, action, amplitude, bank, pressed, audible, bands, profile_amplitude, loudest, unbridged
    )


def iterate_state_chunks(field: Field, count: int) -> Iterator[tuple[slice, slice]]:
    """Split `count` states into chunks; yield the rows of each, and those rows with the past states it depends on."""
    for start in range(0, count, CHUNK_STATES):
        stop = min(start + CHUNK_STATES, count)
        yield slice(start, stop), slice(max(start - count_memory_states(field), 0), stop)


class _EmissionCache:
    """Outputs of the field for consecutive chunks of a stroke's states.

    Evaluates states in batches that span several chunks, each state once, and skips states that no chunk in contact
    uses.
    """

    def __init__(self, field: Field, condition: Condition, evaluator: Evaluator) -> None:
        self._field, self._condition, self._evaluator = field, condition, evaluator
        self._used = np.zeros(len(condition.speed), dtype=bool)
        for _, with_memory in iterate_state_chunks(field, len(self._used)):
            self._used[with_memory] |= not has_no_contact(condition, with_memory)
        self._begin = self._end = 0
        self._emission = _zero_emission(field, 0)

    def rows(self, states: slice) -> Emission:
        """Return the field's output at some states; evaluate missing ones, and forget all before them."""
        if states.stop > self._end:
            known = self._emission.rows(slice(max(states.start - self._begin, 0), None))
            begin = max(states.start, self._end)
            end = min(max(begin + BATCH_STATES, states.stop), len(self._used))
            self._emission = concatenate_emissions([known, self._evaluate(slice(begin, end))])
            self._begin, self._end = states.start, end
        return self._emission.rows(slice(states.start - self._begin, states.stop - self._begin))

    def _evaluate(self, rows: slice) -> Emission:
        used = self._used[rows]
        condition = self._condition.rows(rows)
        if used.all():
            return evaluate_batched(self._field, condition, self._evaluator)
        emission = _zero_emission(self._field, len(used))
        emission.assign(used, evaluate_batched(self._field, condition.rows(used), self._evaluator))
        return emission


def _zero_emission(field: Field, count: int) -> Emission:
    config = field.config
    return Emission(np.zeros((count, config.alpha_heads, config.carriers.count)), np.zeros((count, config.states)))


def has_no_contact(condition: Condition, states: slice) -> bool:
    """Return True if the hand touches at none of the states; then the field's output is 0 there."""
    return not condition.contact[states].any()


def supports_tolerance(field: Field, stroke: StrokeInput) -> bool:
    """Return True if the field can be evaluated adaptively, within a tolerance, for this stroke.

    That needs accumulation over past states, and no height profile that shares the power with arc carriers.
    """
    shared = stroke.profile is not None and field.config.carriers.arc_count > 0
    return field.config.accumulation == "past" and not shared


def prepare_sampled(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    sampled: SampledEmission,
) -> PreparedStroke:
    """Prepare a stroke from the field's outputs at chosen samples, linearly interpolated between them.

    action and token_index are those of stroke.resample_action.
    """
    carriers, count = field.config.carriers, sample_count(action)
    knots, amplitude = accumulate_samples(field.config, sampled, count)
    if carriers.arc_count:
        speed, state = find_peak_speed(action), knots // SAMPLES_PER_STATE
        fastest = np.maximum(speed[state], speed[np.minimum(state + 1, len(speed) - 1)])
        fast = np.flatnonzero(fastest * carriers.arc_centres()[-1] >= BAND_END_HZ)
        amplitude[fast, carriers.arc_slice] *= fastest[fast, None] * carriers.arc_centres() < BAND_END_HZ
    pressed = np.where(action.contact, action.force, 0.0)
    bank = build_filter_bank(stroke.mechanics, token_index, pressed, action.probe)
    loudest = np.array([np.max(sampled.alpha, initial=0.0)], dtype=np.float64)
    return PreparedStroke(
        carriers, seed, action, amplitude[:, None, :], bank, pressed, compute_audible_gain(action.contact, count),
        loudest=loudest, knots=knots, residual_power=sampled.residual_power,
    )  # fmt: skip


def make_evaluate_at(
    field: Field,
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    evaluator: Evaluator = evaluate,
) -> EvaluateAt:
    """Return a function (10 kHz samples of a stroke) → F_Θ's output there.

    Samples that neither are in contact nor reach one by past states or interpolation get 0 and are not evaluated.
    """
    near_contact = _reaches_contact(action.contact, count_memory_states(field))

    def evaluate_at(at: Samples) -> Emission:
        rows = near_contact[np.minimum(at // SAMPLES_PER_STATE, len(near_contact) - 1)]
        if rows.all():
            return evaluate_batched(field, interpolate_condition(stroke, action, token_index, at), evaluator)
        emission = _zero_emission(field, len(at))
        if rows.any():
            condition = interpolate_condition(stroke, action, token_index, at[rows])
            emission.assign(rows, evaluate_batched(field, condition, evaluator))
        return emission

    return evaluate_at


def _reaches_contact(contact: NDArray[np.bool_], states: int) -> NDArray[np.bool_]:
    """Return (n,) whether a state, the next one, or any of the `states` + 1 states before it is in contact."""
    touched = np.concatenate([[0], np.cumsum(contact)])
    by_next = np.append(touched[2:], touched[-1])
    before = np.concatenate([np.zeros(states + 1, dtype=touched.dtype), touched])[: len(contact)]
    return np.asarray(by_next > before)


def _inputs_differ(action: Action, other: Action, rows: slice) -> bool:
    return not (
        np.array_equal(action.force[rows], other.force[rows])
        and np.array_equal(action.contact[rows], other.contact[rows])
    )


def _compute_amplitudes(
    field: Field, condition: Condition, emission: Emission, bands: ProfileBands | None, frequency: Float, rows: slice
) -> tuple[Float, Float | None, float]:
    """Return a chunk's noise amplitudes (m, heads, K), profile factors (m, Ka), and the largest amplitude.

    emission: the field's output at the chunk and the past states it depends on. bands: height profile, None for none.
    frequency: (m, Ka) of the arc bands, κ · speed [Hz]. rows: the chunk's m states.
    """
    carriers = field.config.carriers
    amplitude = accumulate(field.config, emission, len(emission.alpha) - (rows.stop - rows.start))
    loudest = float(np.max(np.abs(amplitude), initial=0.0))
    # The field's gate depends on the speed of each state, but past states are read at the present speed.
    amplitude[:, :, carriers.arc_slice] *= (frequency < BAND_END_HZ)[:, None, :]
    if bands is None:
        return amplitude, None, loudest
    part = condition.rows(rows)
    shares = share_power(amplitude[:, 0], bands, part, carriers)
    amplitude[:, :, carriers.arc_slice] *= shares.arc[:, None, :]
    amplitude[:, :, carriers.time_slice] *= shares.time[:, None, :]
    return amplitude, shares.profile * _tip_gain(part, carriers), loudest


def count_memory_states(field: Field) -> int:
    """Return the number of past states that a state's amplitudes depend on."""
    config = field.config
    return config.stride * (config.states - 1) if config.accumulation == "past" else 0


def arc_band_frequency(action: Action, carriers: Carriers) -> Float:
    """Compute the frequency (n, Ka) [Hz] of each arc band, κ · |ds/dt|, by the fastest motion within two states.

    Bands above BAND_END_HZ are silenced: they would alias, and a jump of the hand would draw metres of noise.
    """
    return np.asarray(find_peak_speed(action)[:, None] * carriers.arc_centres())


def bridge_rest_gaps(amplitude: Float, sliding: NDArray[np.bool_]) -> Float:
    """Replace the profile amplitudes (n, Ka) of resting states by interpolation between sliding neighbours.

    sliding: (n,). At rest and before the touch the height under the hand is constant and must give nothing. Fading it
    in or out there would lift the hand by the height itself within milliseconds, which would be a blow.
    """
    rows = np.flatnonzero(sliding)
    if len(rows) == 0:
        return np.zeros_like(amplitude)
    gaps = np.flatnonzero(~sliding)
    index = np.interp(gaps, rows, np.arange(len(rows)))
    low = np.floor(index).astype(np.intp)
    high, fraction = np.minimum(low + 1, len(rows) - 1), (index - low)[:, None]
    out = amplitude.copy()
    out[gaps] = (1.0 - fraction) * amplitude[rows[low]] + fraction * amplitude[rows[high]]
    return out


def _tip_gain(condition: Condition, carriers: Carriers) -> Float:
    """Compute the fraction (n, Ka) of each band's height that the finite contact transmits; 0 out of contact."""
    out = np.zeros((len(condition.force), carriers.arc_count))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        force = np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        out[rows] = tip_response(carriers.arc_centres(), mechanics, PROBES[condition.probe], force)
    return out
