"""Evaluate the field F_Θ for a stroke and prepare what its samples are then rendered from.

`prepare_stroke` turns a StrokeInput into a PreparedStroke: F_Θ is evaluated at the samples that adaptive_sampling
chooses within a tolerance, or at every state of the action (200 Hz) for a field whose carriers need the full rate. The
module also finds the audible spans of a stroke and splits them into blocks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..material.probe import get_probe
from .adaptive_sampling import (
    BATCH_SAMPLES,
    DEFAULT_TOLERANCE,
    PASSAGE_STATES,
    EvaluateAt,
    KnownPassages,
    SampledEmission,
    Samples,
    accumulate_samples,
    count_passages,
    find_breakpoints,
    sample_adaptively,
)
from .carriers import MODEL_RATE_HZ, Carriers
from .contact.contact_filter import FilterBank, build_filter_bank
from .contact.contact_motion import render_motion
from .contact.lattice_lines import HARMONICS, Lines
from .contact.stick_slip import SlipResponse, StickSlip, may_stick
from .contact.taps import TapRenderer, TapResponse
from .field import (
    Emission,
    Evaluator,
    Field,
    accumulate,
    concatenate_emissions,
    evaluate,
    evaluate_batched,
    find_kernel,
)
from .force_noise import compute_force_noise_power
from .height_profile import compute_profile_power, explain_power, find_finest
from .linear_contact import BAND_END_HZ
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
)
from .tones import LineCourse, follow_lines

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


@dataclass(frozen=True)
class StrokeCourse:
    """Parts of a stroke that follow from its whole past, so that no piece of it tells them.

    Attributes
    ----------
    taps
        Responses of the whole contact to fast changes of force.
    slips
        Acceleration along the stroke where the tip sticks and slips.
    along_share
        (n,) share of the motion along the stroke in amplitude that is left to F_Θ, see Condition; None for all of it.
    lines
        Wavenumbers and phases of the lines of regular surfaces; None if no material has any.
    """

    taps: tuple[TapResponse, ...] = ()
    slips: tuple[SlipResponse, ...] = ()
    along_share: Float | None = None
    lines: LineCourse | None = None

    @property
    def token_lines(self) -> Lines | None:
        """Lines of the stroke's materials, None if there are none."""
        return None if self.lines is None else self.lines.lines

    @property
    def tone_count(self) -> int:
        """Number of tones, which the columns of the carriers are followed by."""
        return 0 if self.lines is None else self.lines.tone_count


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
    motion
        (count,) motion of the probe over the height profile, in place of the linear contact [m/s²], or the whole signal
        of a raw action; None without either.
    loudest
        The field's largest amplitude [m/s²].
    knots
        (m,) 10 kHz samples at which amplitude is given.
    sampled
        The field's outputs, from which amplitude is accumulated; None for a field that is evaluated at every state.
    origin
        Sample of the carriers' clock at which this begins, if it is a chunk of a longer stroke.
    course
        What follows from the stroke's whole past: taps, stick–slip and the phase of lines.
    tone_amplitude
        (m, L · harmonics) RMS of the tones of regular surfaces, at the same knots as amplitude [m/s²]; None for none.
    """

    carriers: Carriers
    seed: int
    action: Action
    amplitude: NDArray[np.floating[Any]]
    bank: FilterBank
    force: Float
    audible: Float
    knots: Samples
    motion: Float | None = None
    loudest: float = 0.0
    sampled: SampledEmission | None = None
    origin: int = 0
    course: StrokeCourse = field(default_factory=lambda: StrokeCourse())
    tone_amplitude: Float | None = None

    @property
    def count(self) -> int:
        """Number of samples at 10 kHz."""
        return len(self.audible)

    @property
    def residual_power(self) -> float:
        """Error power of interpolating between knots, relative to the signal's power, see SampledEmission."""
        return 0.0 if self.sampled is None else self.sampled.residual_power


def prepare_stroke(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: PreparedStroke | None = None,
    tolerance: float | None = None,
    evaluator: Evaluator = evaluate,
    course: StrokeCourse | None = None,
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
        Prepared stroke that differs in force and contact alone, of the same tolerance; then only passages in which they
        differ are evaluated; the result is the same as without it.
    tolerance
        Largest RMS error due to interpolated amplitudes, relative to the RMS of each passage of the stroke; None for
        DEFAULT_TOLERANCE. No matter where `supports_tolerance` is False, since F_Θ is evaluated at every state there.
    evaluator
        Function that evaluates the field at n states, in place of field.evaluate.
    course
        What follows from the stroke's whole past, if it is known already.

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
    if reads_raw_action(field, stroke):
        return _prepare_raw(field, stroke, seed, action, token_index, evaluator)
    if course is None:
        course = follow_stroke(field, stroke, action, token_index, seed)
    if not supports_tolerance(field):
        return _prepare_at_states(field, stroke, seed, action, token_index, evaluator, course)
    sampled = sample_adaptively(
        make_evaluate_at(field, stroke, action, token_index, evaluator, course),
        sample_count(action),
        DEFAULT_TOLERANCE if tolerance is None else tolerance,
        find_breakpoints(action, number_materials(stroke)[token_index]),
        known=None if earlier is None else _find_known_passages(field, earlier, action, course),
        by_passage=find_kernel(field) is None,  # In numpy results depend on how many states are evaluated at once.
    )
    return prepare_sampled(field, stroke, seed, action, token_index, sampled, course, earlier)


def number_materials(stroke: StrokeInput) -> NDArray[np.int32]:
    """Return a number (M,) for each material of a stroke, the same for those that F_Θ cannot tell apart."""
    _, mechanics = find_distinct_mechanics(stroke.mechanics)
    _, tokens = np.unique(stroke.tokens, axis=0, return_inverse=True)
    return (len(stroke.tokens) * tokens.ravel() + mechanics).astype(np.int32)


def _find_known_passages(
    field: Field, earlier: PreparedStroke, action: Action, course: StrokeCourse
) -> KnownPassages | None:
    """Find the passages in which F_Θ has the same inputs as in an earlier stroke along the same path."""
    if earlier.sampled is None:
        return None
    before, share, old_share = earlier.action, course.along_share, earlier.course.along_share
    differs = (action.force != before.force) | (action.contact != before.contact)
    if share is None or old_share is None:
        differs |= share is not old_share
    else:
        differs |= share != old_share
    reach = count_memory_states(field) + 2  # of past states, and of interpolation
    starts = np.arange(count_passages(sample_count(action))) * PASSAGE_STATES
    total = np.concatenate([[0], np.cumsum(differs)])
    low, high = np.maximum(starts - reach, 0), np.minimum(starts + PASSAGE_STATES + 3, len(differs))
    return KnownPassages(earlier.sampled, total[high] == total[np.minimum(low, len(differs))])


def reads_raw_action(field: Field, stroke: StrokeInput) -> bool:
    """Return True if a field of the published form is given an action finer than the states, which it reads as it is.

    Each sample of its signal is a function of the action at that moment alone, so that nothing above 20 Hz is felt
    where the action has none.
    """
    carriers = field.config.carriers
    is_literal = carriers.constant and carriers.count == 1 and field.config.accumulation == "heads"
    return is_literal and stroke.action.rate > ACTION_RATE_HZ


RAW_PIECE = 10_000
"""Samples of a raw action at which F_Θ is evaluated in one go, which bounds the memory of its inputs."""
LOW_PASS_HZ = (1000.0, 1100.0)
"""Band in which the low-pass of the published form falls from 1 to 0: its loss hears nothing above 1 kHz."""


def _prepare_raw(
    field: Field, stroke: StrokeInput, seed: int, action: Action, token_index: NDArray[np.int32], evaluator: Evaluator
) -> PreparedStroke:
    """Prepare a stroke of the published form from its own raw action: F_Θ at every sample, and nothing added."""
    samples = np.empty(sample_count(action))
    for start in range(0, len(samples), RAW_PIECE):
        rows = slice(start, min(start + RAW_PIECE, len(samples)))
        condition = interpolate_condition(stroke, stroke.action, stroke.token_index, np.arange(rows.start, rows.stop))
        emission = evaluate_batched(field, condition, evaluator)
        samples[rows] = accumulate(field.config, emission)[:, :, 0].sum(axis=1)
    low, high = LOW_PASS_HZ
    frequency = np.fft.rfftfreq(len(samples), 1.0 / MODEL_RATE_HZ)
    gain = np.clip((high - frequency) / (high - low), 0.0, 1.0)
    motion = np.fft.irfft(gain * np.fft.rfft(samples), len(samples))
    pressed = np.where(action.contact, action.force, 0.0)
    return PreparedStroke(
        field.config.carriers, seed, action, np.zeros((len(action.speed), 1, 1)),
        build_filter_bank(stroke.mechanics, token_index, pressed, action.probe), pressed,
        compute_audible_gain(action.contact, len(samples)), _list_state_samples(action), motion,
        float(np.abs(samples).max(initial=0.0)),
    )  # fmt: skip


def _prepare_at_states(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    evaluator: Evaluator,
    course: StrokeCourse,
) -> PreparedStroke:
    """Prepare a stroke whose carriers are rendered at the full rate, with F_Θ evaluated at every state."""
    evaluate_at = make_evaluate_at(field, stroke, action, token_index, evaluator, course)
    knots = _list_state_samples(action)
    emission = concatenate_emissions(
        [evaluate_at(knots[low : low + BATCH_SAMPLES]) for low in range(0, len(knots), BATCH_SAMPLES)]
    )
    return _prepare_amplitudes(
        field, stroke, seed, action, token_index, course, knots, accumulate(field.config, emission)
    )


def _list_state_samples(action: Action) -> Samples:
    """Return the 10 kHz samples (n,) of an action's states."""
    return SAMPLES_PER_STATE * np.arange(len(action.speed), dtype=np.int64)


def follow_stroke(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], seed: int
) -> StrokeCourse:
    """Find what of a stroke follows from its whole past. action, token_index: from resample_action."""
    stick_slip = make_stick_slip(field, stroke, action, token_index, seed)
    taps = make_tap_renderer(field, stroke, action, token_index)
    lines = make_line_course(field, stroke, action, token_index, seed)
    return StrokeCourse(
        () if taps is None else taps.render(),
        () if stick_slip is None else stick_slip.render(),
        None if stick_slip is None else stick_slip.motion.along_share,
        lines,
    )


def make_tap_renderer(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32]
) -> TapRenderer | None:
    """Make the renderer of a stroke's taps; None over a measured relief, whose motion has them already."""
    if has_relief(stroke) and field.config.carriers.arc_count:
        return None
    pressed = np.where(action.contact, action.force, 0.0)
    return TapRenderer(stroke.mechanics, token_index, pressed, action.probe, action.force_curve)


def has_relief(stroke: StrokeInput) -> bool:
    """Return True if a stroke has a height profile of two samples or more."""
    return stroke.profile is not None and len(stroke.profile.height) > 1


def make_line_course(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], seed: int
) -> LineCourse | None:
    """Find the lines of a stroke's materials along its path; None if there are none, or the field has none.

    Over a measured relief a fingertip has none either: the relief is drawn as it is, and what its ridges catch on is
    noise.
    """
    if not field.config.line_gains or (has_relief(stroke) and get_probe(action.probe).pad is not None):
        return None
    return follow_lines(stroke.tokens, stroke.mechanics, action, token_index, seed)


def make_stick_slip(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], seed: int
) -> StickSlip | None:
    """Make the integrator of a stroke's stick–slip; None if it has none, or the field has learned it from recordings.

    action, token_index: from resample_action.
    """
    config = field.config
    # Over a measured relief friction is part of the motion that is integrated.
    if has_relief(stroke) or not config.force_noise or not config.carriers.arc_count or not may_stick(action):
        return None
    stick_slip = StickSlip(build_condition(stroke, action, token_index), action.position, config.carriers, seed)
    return stick_slip if stick_slip.motion.spans else None


def _zero_emission(field: Field, count: int, columns: int) -> Emission:
    config = field.config
    return Emission(np.zeros((count, config.alpha_heads, columns)), np.zeros((count, config.states)))


def supports_tolerance(field: Field) -> bool:
    """Return True if the field is evaluated at samples that a tolerance chooses: with one head, and bands of noise."""
    return field.config.accumulation == "past" and not field.config.carriers.constant


def prepare_sampled(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    sampled: SampledEmission,
    course: StrokeCourse,
    earlier: PreparedStroke | None = None,
) -> PreparedStroke:
    """Prepare a stroke from the field's outputs at chosen samples, linearly interpolated between them.

    action and token_index are those of stroke.resample_action. course: of the stroke. earlier: as in prepare_stroke.
    """
    knots, amplitude = accumulate_samples(field.config, sampled, sample_count(action))
    prepared = _prepare_amplitudes(field, stroke, seed, action, token_index, course, knots, amplitude[:, None], earlier)
    return replace(prepared, sampled=sampled)


def _prepare_amplitudes(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    course: StrokeCourse,
    knots: Samples,
    amplitude: NDArray[np.floating[Any]],
    earlier: PreparedStroke | None = None,
) -> PreparedStroke:
    """Prepare a stroke from amplitudes (m, heads, K + tones) at the samples `knots` (m,)."""
    carriers, count = field.config.carriers, sample_count(action)
    loudest, tone_amplitude = float(np.max(np.abs(amplitude), initial=0.0)), None
    if course.lines is not None:
        amplitude, tones = np.split(amplitude, [carriers.count], axis=2)
        amplitude, tone_amplitude = amplitude.copy(), tones[:, 0].astype(np.float64)
        course.lines.silence_others(tone_amplitude, knots, find_peak_speed(action))
    if carriers.arc_count:
        _silence_fast_bands(carriers, action, knots, amplitude)
    profile = stroke.profile if carriers.arc_count and has_relief(stroke) else None
    if profile is not None:
        _leave_explained_power(field, stroke, action, token_index, course, knots, amplitude)
        if course.lines is not None and tone_amplitude is not None:
            # The harmonics of a line that the profile holds are in its motion, also those that it does not resolve.
            held = np.repeat(course.lines.wavenumber <= find_finest(profile), len(HARMONICS), axis=1)
            tone_amplitude *= ~held[knots // SAMPLES_PER_STATE]
    pressed = np.where(action.contact, action.force, 0.0)
    if earlier is not None and np.array_equal(action.contact, earlier.action.contact):
        audible = earlier.audible
    else:
        audible = compute_audible_gain(action.contact, count)
    bank = build_filter_bank(stroke.mechanics, token_index, pressed, action.probe)
    motion = None if profile is None else render_motion(stroke, action, token_index, carriers)
    return PreparedStroke(
        carriers, seed, action, amplitude, bank, pressed, audible, knots, motion, loudest, course=course,
        tone_amplitude=tone_amplitude,
    )  # fmt: skip


def _silence_fast_bands(
    carriers: Carriers, action: Action, knots: Samples, amplitude: NDArray[np.floating[Any]]
) -> None:
    """Silence arc bands above BAND_END_HZ in amplitudes (m, heads, K), in place.

    They would alias, and a jump of the hand would draw metres of noise. The field's gate depends on the speed of each
    state, but past states are read at the present speed.
    """
    speed = find_peak_speed(action)
    fastest = np.maximum(speed[knots // SAMPLES_PER_STATE], speed[-(-knots // SAMPLES_PER_STATE)])
    fast = np.flatnonzero(fastest * carriers.arc_centres()[-1] >= BAND_END_HZ)
    is_slow = fastest[fast, None] * carriers.arc_centres() < BAND_END_HZ
    amplitude[fast, :, carriers.arc_slice] *= is_slow[:, None]


def make_evaluate_at(
    field: Field,
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    evaluator: Evaluator = evaluate,
    course: StrokeCourse | None = None,
) -> EvaluateAt:
    """Return a function (10 kHz samples of a stroke) → F_Θ's output there.

    Samples that neither are in contact nor reach one by past states or interpolation get 0 and are not evaluated.
    """
    course = StrokeCourse() if course is None else course
    share, lines, columns = course.along_share, course.token_lines, field.config.carriers.count + course.tone_count
    near_contact = _reaches_contact(action.contact, count_memory_states(field))

    def evaluate_at(at: Samples) -> Emission:
        rows = near_contact[np.minimum(at // SAMPLES_PER_STATE, len(near_contact) - 1)]
        if rows.all():
            condition = interpolate_condition(stroke, action, token_index, at, share, lines)
            return evaluate_batched(field, condition, evaluator)
        emission = _zero_emission(field, len(at), columns)
        if rows.any():
            condition = interpolate_condition(stroke, action, token_index, at[rows], share, lines)
            emission.assign(rows, evaluate_batched(field, condition, evaluator))
        return emission

    return evaluate_at


def _reaches_contact(contact: NDArray[np.bool_], states: int) -> NDArray[np.bool_]:
    """Return (n,) whether a state, the next one, or any of the `states` + 1 states before it is in contact."""
    touched = np.concatenate([[0], np.cumsum(contact)])
    by_next = np.append(touched[2:], touched[-1])
    before = np.concatenate([np.zeros(states + 1, dtype=touched.dtype), touched])[: len(contact)]
    return np.asarray(by_next > before)


def _leave_explained_power(
    field: Field,
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    course: StrokeCourse,
    knots: Samples,
    amplitude: NDArray[np.floating[Any]],
) -> None:
    """Take from amplitudes (m, heads, K) at knots, in place, what the height profile explains; see explain_power."""
    carriers, profile = field.config.carriers, stroke.profile
    assert profile is not None
    profile_power, finest = compute_profile_power(profile, carriers), find_finest(profile)
    for low in range(0, len(knots), BATCH_SAMPLES):
        at, part = knots[low : low + BATCH_SAMPLES], amplitude[low : low + BATCH_SAMPLES]
        condition = interpolate_condition(stroke, action, token_index, at, course.along_share, course.token_lines)
        noise, body = np.zeros((len(at), carriers.count)), np.ones((len(at), carriers.count))
        if field.config.force_noise:
            noise, body = compute_force_noise_power(condition, carriers)
        left = explain_power(profile_power, finest, part[:, 0].astype(np.float64), noise, body, condition, carriers)
        part[:, :, carriers.arc_slice] *= left.arc[:, None, :]
        part[:, :, carriers.time_slice] *= left.time[:, None, :]


def count_memory_states(field: Field) -> int:
    """Return the number of past states that a state's amplitudes depend on."""
    config = field.config
    return config.stride * (config.states - 1) if config.accumulation == "past" else 0
