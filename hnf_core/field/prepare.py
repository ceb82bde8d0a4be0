"""Evaluate F_Θ for a stroke and prepare everything at the action rate that a block of samples is rendered from.

`prepare_stroke` turns a StrokeInput into a PreparedStroke. F_Θ is requested through generators, which yield conditions
and are sent emissions, so that several strokes can be evaluated in shared batches: a short stroke has too few states to
keep a processor busy, and every batch has a cost of its own. With the kernel the result of a state does not depend on
its batch, so a stroke is the same to the last bit alone and among others. The module also finds the audible spans of a
stroke and splits them into blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..material.contact_model import tip_response
from ..material.probe import PROBES
from .adaptive_sampling import (
    SampledEmission,
    Sampler,
    SampleRequests,
    accumulate_samples,
    find_breakpoints,
    sample_adaptively,
)
from .carriers import MODEL_RATE_HZ, Carriers
from .contact_filter import FilterBank, build_filter_bank
from .field import Emission, Field, accumulate, evaluate, find_kernel
from .height_profile import ProfileBands, share_power, split_profile
from .linear_contact import BAND_END_HZ, FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, upper_fade
from .noise_cache import HOP_SIZE
from .stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    build_condition,
    find_distinct_mechanics,
    find_peak_speed,
    interpolate_condition,
    resample_action,
    sample_count,
    select_states,
)

Float = NDArray[np.float64]

BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06
"""Times before and after contact beyond which the signal is exactly zero [s]."""
BLOCK_SAMPLES = HOP_SIZE
"""Samples of a block, the unit that a small change renders again; the last bit of the profile term depends on it."""
MAX_JOINED_BLOCKS = 32
"""Adjacent audible blocks that are rendered together: 13 s, whose carriers are in memory at once."""


def compute_audible_gain(contact: NDArray[np.bool_], count: int) -> Float:
    """Compute the gain (count,): 1 in contact (n,), with fades to exactly 0 before and after it.

    The fades last BEFORE_CONTACT_S and AFTER_CONTACT_S.
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
    """Return True if a gain (count,) is above 0 anywhere; the maximum is faster than any()."""
    return bool(audible.max(initial=0.0) > 0.0)


def split_blocks(count: int) -> list[tuple[int, int]]:
    """Return (start, length) of the blocks in which count samples are rendered."""
    return [(start, min(BLOCK_SAMPLES, count - start)) for start in range(0, count, BLOCK_SAMPLES)]


def find_audible_spans(audible: Float) -> Iterator[tuple[int, int]]:
    """Yield (start, length) of runs of audible blocks, MAX_JOINED_BLOCKS at most, for a gain (count,)."""
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


T = TypeVar("T")
Request = TypeVar("Request")
Response = TypeVar("Response")

EvaluationRequests = Generator[Condition, Emission, T]
"""Generator that yields states, is sent their emissions, and returns its result."""
Evaluate = Callable[[Field, Condition], Emission]
"""Function that evaluates a field, `field.evaluate` or a replacement."""

BATCH_STATES = 512
"""States in a batch: enough for every core, with 6 MB of intermediate results."""


def drive_requests(respond: Callable[[Request], Response], requests: Generator[Request, Response, T]) -> T:
    """Run the generator `requests`, sending it `respond(request)` for every request it yields; return its result."""
    try:
        question = next(requests)
        while True:
            question = requests.send(respond(question))
    except StopIteration as done:
        returned: T = done.value
        return returned


def evaluate_requests(field: Field, requests: EvaluationRequests[T], evaluator: Evaluate = evaluate) -> T:
    """Run the generator `requests` with emissions of F_Θ, or of a replacement; return its result."""
    return drive_requests(lambda condition: evaluate_batched(field, [condition], evaluator)[0], requests)


def evaluate_requests_together(field: Field, requests: Sequence[EvaluationRequests[T]]) -> list[T]:
    """Run several generators in step, evaluating their requests in shared batches; return their results."""
    returned: dict[int, T] = {}
    given: dict[int, Emission | None] = dict.fromkeys(range(len(requests)))
    while given:
        asked: dict[int, Condition] = {}
        for index, each in given.items():
            try:
                asked[index] = next(requests[index]) if each is None else requests[index].send(each)
            except StopIteration as done:
                returned[index] = done.value
        given = dict(zip(asked, evaluate_batched(field, list(asked.values())), strict=True))
    return [returned[index] for index in range(len(requests))]


def evaluate_batched(field: Field, conditions: Sequence[Condition], evaluator: Evaluate = evaluate) -> list[Emission]:
    """Evaluate F_Θ at the states of each condition, in shared batches."""
    parts: list[list[Emission]] = [[] for _ in conditions]
    for probe in dict.fromkeys(each.probe for each in conditions):
        alike = [index for index, each in enumerate(conditions) if each.probe == probe]
        for batch in _split_batches([(index, len(conditions[index].speed)) for index in alike]):
            given, begin = (
                evaluator(field, _concatenate_conditions([(conditions[index], rows) for index, rows in batch])),
                0,
            )
            for index, rows in batch:
                end = begin + rows.stop - rows.start
                parts[index].append(given.rows(slice(begin, end)))
                begin = end
    return [each[0] if len(each) == 1 else concatenate_emissions(each) for each in parts]


def _split_batches(asked: Sequence[tuple[int, int]]) -> list[list[tuple[int, slice]]]:
    """Split (index, number of states) of each request into batches of BATCH_STATES at most, each with its rows."""
    batches: list[list[tuple[int, slice]]] = []
    room = 0
    for index, count in asked:
        for low in range(0, max(count, 1), BATCH_STATES):
            rows = slice(low, min(low + BATCH_STATES, count))
            if not batches or rows.stop - rows.start > room:
                batches.append([])
                room = BATCH_STATES
            batches[-1].append((index, rows))
            room -= rows.stop - rows.start
    return batches


def _concatenate_conditions(parts: Sequence[tuple[Condition, slice]]) -> Condition:
    """Concatenate some of the states of conditions with one probe."""
    if len(parts) == 1 and parts[0][1] == slice(0, len(parts[0][0].speed)):
        return parts[0][0]
    mechanics, of_row = find_distinct_mechanics([mechanics for each, _ in parts for mechanics in each.mechanics])
    first = np.cumsum([0, *(len(each.mechanics) for each, _ in parts)])
    material = [each.material[rows] + begin for (each, rows), begin in zip(parts, first, strict=False)]
    tokens, direction, speed, force, contact = (
        np.concatenate([getattr(each, name)[rows] for each, rows in parts])
        for name in ("tokens", "direction", "speed", "force", "contact")
    )
    of_state, probe = of_row[np.concatenate(material)], parts[0][0].probe
    return Condition(tokens, mechanics, of_state, direction, speed, force, contact, probe)


def concatenate_emissions(parts: Sequence[Emission]) -> Emission:
    """Concatenate emissions along the states."""
    return Emission(np.concatenate([each.alpha for each in parts]), np.concatenate([each.sigma_dt for each in parts]))


CHUNK_STATES = 128
"""Action states in a chunk, the unit in which F_Θ is evaluated.

In numpy results depend on how many states are evaluated at once, so this is part of the byte-exact contract.
"""


@dataclass(frozen=True)
class PreparedStroke:
    """Stroke with F_Θ evaluated: everything that a block of samples needs.

    Attributes
    ----------
    amplitude
        (m, heads, K) of the noise carriers, linear in time between knots.
    force
        (n,) pressing force [N].
    audible
        (count,) gain 0 … 1, zero far from contact.
    profile_amplitude
        (n, Ka) factor on the profile's bands.
    loudest
        The field's largest amplitude in each chunk of states [m/s²].
    unbridged
        profile_amplitude before bridge_rest_gaps().
    knots
        (m,) samples of the model rate; None for one at each of the n states.
    residual_power
        Power that the knots leave out, relative to all, see SampledEmission.
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
        """Number of samples."""
        return len(self.audible)


def prepare_stroke(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: PreparedStroke | None = None,
    tolerance: float | None = None,
    evaluator: Evaluate = evaluate,
) -> PreparedStroke:
    """Evaluate F_Θ for a stroke and prepare it for rendering.

    Parameters
    ----------
    field, stroke, seed, earlier, tolerance
        As of request_prepared_stroke.
    evaluator
        Function that evaluates the field; a replacement may be a table.

    Returns
    -------
    PreparedStroke
        Everything that a block of samples needs.
    """
    return evaluate_requests(
        field, request_prepared_stroke(field, stroke, seed=seed, earlier=earlier, tolerance=tolerance), evaluator
    )


def request_prepared_stroke(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: PreparedStroke | None = None,
    tolerance: float | None = None,
) -> EvaluationRequests[PreparedStroke]:
    """Prepare a stroke, as a generator that requests the emissions of F_Θ.

    Parameters
    ----------
    field
        The field.
    stroke
        The stroke.
    seed
        Seed of the carriers.
    earlier
        Prepared stroke that differs in force and contact alone; only chunks of states in which they differ are
        evaluated, and the result is the same.
    tolerance
        Largest error of the amplitudes, as root of the power over the whole stroke. F_Θ is then evaluated at adaptive
        samples instead of at every state. Ignored if the stroke has a height profile or the field accumulates over
        heads.
    """
    action, token_index = resample_action(stroke)
    if tolerance is not None and supports_tolerance(field, stroke):
        return (yield from prepare_adaptive(field, stroke, seed, action, token_index, tolerance))
    condition = build_condition(stroke, action, token_index)
    carriers, count = field.config.carriers, len(action.speed)
    bands = None
    if stroke.profile is not None and carriers.arc_count:
        bands = split_profile(stroke.profile, carriers) if earlier is None else earlier.bands
    reading = reading_frequency(action, carriers)
    if earlier is None:
        amplitude = np.empty((count, field.config.alpha_heads, carriers.count))
        unheld = None if bands is None else np.empty((count, carriers.arc_count))
        loudest = np.empty(-(-count // CHUNK_STATES))
    else:
        amplitude, loudest = earlier.amplitude.copy(), earlier.loudest.copy()
        unheld = None if earlier.unbridged is None else earlier.unbridged.copy()
    known = None
    if earlier is None and find_kernel(field) is not None:  # Results do not depend on the number of states in a batch.
        known = _StateCache(field, condition)
    for portion, (rows, felt) in enumerate(iterate_state_chunks(field, count)):
        if earlier is not None and not _inputs_differ(action, earlier.action, felt):
            continue
        if has_no_contact(condition, felt):
            amplitude[rows], loudest[portion] = 0.0, 0.0
            if unheld is not None:
                unheld[rows] = 0.0
            continue
        given = (yield select_states(condition, felt)) if known is None else (yield from known.rows(felt))
        amplitude[rows], height, loudest[portion] = _compute_amplitudes(
            field, condition, given, bands, reading[rows], rows
        )
        if unheld is not None and height is not None:
            unheld[rows] = height
    profile_amplitude = None
    if unheld is not None:
        sliding = condition.contact & (condition.force > FORCE_FLOOR_N) & (condition.speed > SPEED_FLOOR_M_S)
        profile_amplitude = bridge_rest_gaps(unheld, sliding) * upper_fade(reading)
    pressed = np.where(action.contact, action.force, 0.0)
    if earlier is not None and np.array_equal(action.contact, earlier.action.contact):
        audible = earlier.audible
    else:
        audible = compute_audible_gain(action.contact, sample_count(action))
    return PreparedStroke(
        carriers, seed, action, amplitude, build_filter_bank(stroke.mechanics, token_index, pressed, action.probe),
        pressed,
        audible, bands, profile_amplitude, loudest, unheld,
    )  # fmt: skip


def iterate_state_chunks(field: Field, count: int) -> Iterator[tuple[slice, slice]]:
    """Yield the rows of each chunk of `count` states, and the rows it depends on (the chunk and its memory)."""
    for start in range(0, count, CHUNK_STATES):
        stop = min(start + CHUNK_STATES, count)
        yield slice(start, stop), slice(max(start - count_memory_states(field), 0), stop)


class _StateCache:
    """Cache of field outputs for consecutive chunks.

    Evaluates states in batches that span several chunks, each state once, and skips states that no chunk in contact
    uses.
    """

    def __init__(self, field: Field, condition: Condition) -> None:
        self._field, self._condition = field, condition
        self._wanted = np.zeros(len(condition.speed), dtype=bool)
        for _, felt in iterate_state_chunks(field, len(self._wanted)):
            self._wanted[felt] |= not has_no_contact(condition, felt)
        self._begin = self._end = 0
        self._held = _zero_emission(field, 0)

    def rows(self, states: slice) -> EvaluationRequests[Emission]:
        """Return the emissions of some states, requesting those that are missing."""
        if states.stop > self._end:
            left = self._held.rows(slice(max(states.start - self._begin, 0), None))
            begin = max(states.start, self._end)
            end = min(max(begin + BATCH_STATES, states.stop), len(self._wanted))
            self._held = concatenate_emissions([left, (yield from self._evaluate(slice(begin, end)))])
            self._begin, self._end = states.start, end
        return self._held.rows(slice(states.start - self._begin, states.stop - self._begin))

    def _evaluate(self, rows: slice) -> EvaluationRequests[Emission]:
        wanted = self._wanted[rows]
        part = select_states(self._condition, rows)
        if wanted.all():
            return (yield part)
        emitted = _zero_emission(self._field, len(wanted))
        emitted.assign(wanted, (yield select_states(part, wanted)))
        return emitted


def _zero_emission(field: Field, count: int) -> Emission:
    config = field.config
    return Emission(np.zeros((count, config.alpha_heads, config.carriers.count)), np.zeros((count, config.states)))


def has_no_contact(condition: Condition, states: slice) -> bool:
    """Return True if none of the states touches; then nothing is emitted or remembered."""
    return not condition.contact[states].any()


def supports_tolerance(field: Field, stroke: StrokeInput) -> bool:
    """Return True if a tolerance applies: past states, and no profile that shares the power."""
    shared = stroke.profile is not None and field.config.carriers.arc_count > 0
    return field.config.accumulation == "past" and not shared


def prepare_adaptive(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    tolerance: float,
    sampler: Sampler = sample_adaptively,
) -> EvaluationRequests[PreparedStroke]:
    """Prepare a stroke with a tolerance. sampler: chooses the samples at which F_Θ is evaluated."""
    carriers, count = field.config.carriers, sample_count(action)
    wanted = sampler(count, tolerance, find_breakpoints(action, token_index))
    sampled = yield from _evaluate_samples(field, stroke, action, token_index, wanted)
    knots, amplitude = accumulate_samples(field.config, sampled, count)
    if carriers.arc_count:
        pace, state = find_peak_speed(action), knots // SAMPLES_PER_STATE
        around = np.maximum(pace[state], pace[np.minimum(state + 1, len(pace) - 1)])
        fast = np.flatnonzero(around * carriers.arc_centres()[-1] >= BAND_END_HZ)
        amplitude[fast, carriers.arc_slice] *= around[fast, None] * carriers.arc_centres() < BAND_END_HZ
    pressed = np.where(action.contact, action.force, 0.0)
    bank = build_filter_bank(stroke.mechanics, token_index, pressed, action.probe)
    loudest = np.array([np.max(sampled.alpha, initial=0.0)], dtype=np.float64)
    return PreparedStroke(
        carriers, seed, action, amplitude[:, None, :], bank, pressed, compute_audible_gain(action.contact, count),
        loudest=loudest, knots=knots, residual_power=sampled.residual_power,
    )  # fmt: skip


def _evaluate_samples(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], wanted: SampleRequests
) -> EvaluationRequests[SampledEmission]:
    """Request the emissions of samples in contact, or connected to one by memory or interpolation; others are 0."""
    felt = _reaches_contact(action.contact, count_memory_states(field))
    try:
        at = next(wanted)
        while True:
            rows = felt[np.minimum(at // SAMPLES_PER_STATE, len(felt) - 1)]
            if rows.all():
                emitted = yield interpolate_condition(stroke, action, token_index, at)
            else:
                emitted = _zero_emission(field, len(at))
                if rows.any():
                    emitted.assign(rows, (yield interpolate_condition(stroke, action, token_index, at[rows])))
            at = wanted.send(emitted)
    except StopIteration as done:
        sampled: SampledEmission = done.value
        return sampled


def _reaches_contact(contact: NDArray[np.bool_], states: int) -> NDArray[np.bool_]:
    """Return (n,) whether a state, the next one, or any of `states` + 1 before it touches."""
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
    field: Field, condition: Condition, given: Emission, bands: ProfileBands | None, reading: Float, rows: slice
) -> tuple[Float, Float | None, float]:
    """Return the noise amplitudes (m, heads, K) and profile amplitudes (m, Ka) of a chunk, and the field's largest.

    given: emission of the chunk and its memory. reading: (m, Ka) frequencies of the chunk [Hz].
    """
    carriers = field.config.carriers
    amplitude = accumulate(field.config, given, len(given.alpha) - (rows.stop - rows.start))
    loudest = float(np.max(np.abs(amplitude), initial=0.0))
    # The field's gate depends on the speed of each state, but past states are read at the present speed.
    amplitude[:, :, carriers.arc_slice] *= (reading < BAND_END_HZ)[:, None, :]
    if bands is None:
        return amplitude, None, loudest
    part = select_states(condition, rows)
    shares = share_power(amplitude[:, 0], bands, part, carriers)
    amplitude[:, :, carriers.arc_slice] *= shares.arc[:, None, :]
    amplitude[:, :, carriers.time_slice] *= shares.time[:, None, :]
    return amplitude, shares.profile * _tip_gain(part, carriers), loudest


def count_memory_states(field: Field) -> int:
    """Return the number of past states that a state's amplitudes depend on."""
    config = field.config
    return config.stride * (config.states - 1) if config.accumulation == "past" else 0


def reading_frequency(action: Action, carriers: Carriers) -> Float:
    """Compute the frequency (n, Ka) [Hz] of each arc band, κ · |ds/dt|, by the fastest motion within two states.

    Above BAND_END_HZ a band would alias, and a jump of the hand would need metres of cells.
    """
    return np.asarray(find_peak_speed(action)[:, None] * carriers.arc_centres())


def bridge_rest_gaps(amplitude: Float, sliding: NDArray[np.bool_]) -> Float:
    """Replace the amplitudes (n, K) of states that do not slide by linear interpolation between sliding neighbours.

    At rest and before the touch the height under the hand is constant and must give nothing. Fading it in or out there
    would lift the hand by the height itself within milliseconds, which would be a blow.
    """
    rows = np.flatnonzero(sliding)
    if len(rows) == 0:
        return np.zeros_like(amplitude)
    gaps = np.flatnonzero(~sliding)
    place = np.interp(gaps, rows, np.arange(len(rows)))
    low = np.floor(place).astype(np.intp)
    high, share = np.minimum(low + 1, len(rows) - 1), (place - low)[:, None]
    out = amplitude.copy()
    out[gaps] = (1.0 - share) * amplitude[rows[low]] + share * amplitude[rows[high]]
    return out


def _tip_gain(condition: Condition, carriers: Carriers) -> Float:
    """Compute the fraction (n, Ka) of each band's height that the finite contact transmits; 0 out of contact."""
    out = np.zeros((len(condition.force), carriers.arc_count))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        force = np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        out[rows] = tip_response(carriers.arc_centres(), mechanics, PROBES[condition.probe], force)
    return out
