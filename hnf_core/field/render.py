"""Render the 10 kHz samples of a stroke whose field F_Θ is already evaluated, in blocks or in chunks.

`render_block` computes any block alone. `render_chunks` renders a stroke of any length in the memory of a minute, by
cutting it into overlapping chunks: a sample depends on the states around it through the contact's impulse response
(TAIL_SAMPLES, LEAD_SAMPLES), F_Θ's past states and the fades at the ends of contact. Each chunk is prepared with that
margin on either side and rendered without it. The noise carriers follow the clock and path of the whole stroke, so they
continue across chunks. Chunks and margins are whole passages, the unit of adaptive sampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import UsageError
from ..kernel.loader import load_kernel, single_blas_thread_without_kernel
from ..progress import add_work
from ..threads import available_cpus, run_in_thread
from .adaptive_sampling import PASSAGE_SAMPLES, PASSAGE_STATES
from .carrier_rendering import REACH_SAMPLES, Knots, render_carrier_hops, render_carriers_full_rate
from .contact.contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .field import Field
from .noise_cache import HOP_SIZE, prefetch_noise
from .prepare import (
    AFTER_CONTACT_S,
    BEFORE_CONTACT_S,
    BLOCK_SAMPLES,
    PreparedStroke,
    StrokeCourse,
    count_memory_states,
    find_audible_spans,
    is_audible,
    make_line_course,
    make_stick_slip,
    make_tap_renderer,
    prepare_stroke,
    reads_raw_action,
)
from .stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    extrapolate_position,
    resample_action,
    sample_count,
)

Float = NDArray[np.float64]

MIN_THREADED_SAMPLES = 4 * BLOCK_SAMPLES
"""Samples from which the contact term is rendered in a second thread."""


def render_samples(prepared: PreparedStroke, start: int = 0, stop: int | None = None) -> Float:
    """Render samples start … stop − 1 of a stroke, (stop − start,) [m/s²].

    Parameters
    ----------
    prepared
        Stroke with F_Θ evaluated.
    start, stop
        Range of samples of the model rate; by default all.

    Returns
    -------
    ndarray
        float64; exactly 0 where nothing is audible.
    """
    stop = prepared.count if stop is None else stop
    samples = np.zeros(stop - start)
    with single_blas_thread_without_kernel():
        for first, count in find_audible_spans(prepared.audible[start:stop]):
            samples[first : first + count] = render_block(prepared, start + first, count)
    return samples


def render_block(prepared: PreparedStroke, start: int, count: int) -> Float:
    """Render samples start … start + count − 1 of the model rate, (count,) [m/s²]; independent of other blocks."""
    audible = prepared.audible[start : start + count]
    if not is_audible(audible):
        return np.zeros(count)
    if count < MIN_THREADED_SAMPLES or load_kernel() is None or available_cpus() < 2:
        samples = render_carriers(prepared, start, count)
        samples += render_contact(prepared, start, count)
    else:
        contact: list[Float] = []
        # A thread pays only with the kernel, since numpy would hold the interpreter.
        wait = run_in_thread(lambda: contact.append(render_contact(prepared, start, count)))
        try:
            samples = render_carriers(prepared, start, count)
        finally:
            wait()
        samples += contact[0]
    for slip in prepared.course.slips:
        slip.apply(samples, start)
    samples *= audible
    return samples


def render_carriers(prepared: PreparedStroke, start: int, count: int) -> Float:
    """Render the noise carriers modulated by the field, and the tones of regular surfaces, (count,) [m/s²].

    They are 0 at rest and out of contact, except where the field still weights past states (40 ms).
    """
    add_work("samples", count, start)
    carriers, seed, action, origin = prepared.carriers, prepared.seed, prepared.action, prepared.origin
    if prepared.amplitude.shape[1] > 1 or carriers.constant:
        return render_carriers_full_rate(prepared.amplitude, carriers, seed, action, start, count, origin)
    knots, first = Knots(prepared.knots + origin, prepared.amplitude[:, 0]), (origin + start) // HOP_SIZE
    hops = range(first, (origin + start + count - 1) // HOP_SIZE + 1)
    position = extrapolate_position(
        action, first * HOP_SIZE - origin - REACH_SAMPLES, len(hops) * HOP_SIZE + 2 * REACH_SAMPLES
    )
    begin = origin + start - first * HOP_SIZE
    samples = render_carrier_hops(knots, carriers, seed, position, hops)[begin : begin + count]
    if prepared.course.lines is not None and prepared.tone_amplitude is not None:
        here = position[begin + REACH_SAMPLES : begin + REACH_SAMPLES + count]
        samples = samples + prepared.course.lines.render(action, prepared.knots, prepared.tone_amplitude, start, here)
    return samples


def render_contact(prepared: PreparedStroke, start: int, count: int) -> Float:
    """Render the contact's response, (count,) [m/s²], to the pressing force, also at rest, and to the measured relief.

    The response to the force is what is felt of touch, release and changing pressure; fast changes go through the whole
    contact.
    """
    if prepared.motion is not None:
        return prepared.motion[start : start + count].copy()
    samples = prepared.bank.render_force(prepared.force, start, count)
    for tap in prepared.course.taps:
        tap.apply(samples, start)
    return samples


CHUNK_STEP = math.lcm(BLOCK_SAMPLES, HOP_SIZE, PASSAGE_SAMPLES)
"""Samples at which chunks may be cut: there blocks, hops and passages all begin."""
CHUNK_SAMPLES = 6 * CHUNK_STEP
"""Samples of a chunk: 61 s, of which F_Θ's amplitudes take 25 MB."""
_MARGIN_STATES = 4
"""States on either side that splines and the band limit read."""


@dataclass(frozen=True)
class RenderedChunk:
    """Samples of one chunk.

    samples: (m,) float64 [m/s²] at the model rate, following those of the chunk before. loudest: the field's largest
    amplitude in it [m/s²]. residual_power: error power of adaptive evaluation over the power of the chunk.
    """

    samples: Float
    loudest: float
    residual_power: float


def render_chunks(
    field: Field, stroke: StrokeInput, *, seed: int, length: int = CHUNK_SAMPLES, begin: int = 0,
    tolerance: float | None = None,
) -> Iterator[RenderedChunk]:  # fmt: skip
    """Synthesise a stroke at the model rate, chunk by chunk, in memory that does not grow with its length.

    Parameters
    ----------
    field
        The field.
    stroke
        Stroke without a height profile.
    seed
        Seed of the carriers.
    length
        Samples of a chunk, a multiple of CHUNK_STEP.
    begin
        First sample, a multiple of CHUNK_STEP; earlier ones are not computed.
    tolerance
        As in `synthesise`.

    Yields
    ------
    RenderedChunk
        Chunks in order; together they equal the result of `synthesise` within 1e-6 RMS, since positions are relative to
        another origin and rounded to float32.

    Raises
    ------
    StrokeError
        If the action has no duration.
    UsageError
        If length or begin are no multiples of CHUNK_STEP, or the stroke has a height profile, which cannot be cut.
    """
    if length <= 0 or length % CHUNK_STEP or begin < 0 or begin % CHUNK_STEP:
        raise UsageError(f"a portion of {length} samples from {begin} on: both must be whole numbers of {CHUNK_STEP}.")
    if stroke.profile is not None:
        raise UsageError(
            "a stroke with a height profile cannot be cut into portions.", remedy="Synthesise it whole, or without it."
        )
    if reads_raw_action(field, stroke):
        raise UsageError("a stroke under a raw action cannot be cut into portions.", remedy="Give 120 s at most.")
    action, token_index = resample_action(stroke)
    count = sample_count(action)
    # Taps, slips and the phase of lines may have begun long before a chunk, so that all of the stroke is needed.
    taps = make_tap_renderer(field, stroke, action, token_index)
    stick_slip = make_stick_slip(field, stroke, action, token_index, seed)
    lines = make_line_course(field, stroke, action, token_index, seed)
    for start in range(begin, count, length):
        stop = min(start + length, count)
        rows = _find_chunk_states(field, start, stop, len(action.speed))
        origin = rows.start * SAMPLES_PER_STATE
        chunk = StrokeInput(_select_action_states(action, rows), stroke.tokens, stroke.mechanics, token_index[rows])
        course = StrokeCourse(lines=None if lines is None else lines.rows(rows))
        if taps is not None:
            course = replace(course, taps=tuple(tap.shift(-origin) for tap in taps.render(start, stop)))
        if stick_slip is not None and stick_slip.motion.along_share is not None:
            slips = tuple(slip.shift(-origin) for slip in stick_slip.render(start, stop))
            course = replace(course, slips=slips, along_share=stick_slip.motion.along_share[rows])
        with prefetch_noise(field.config, seed, chunk.action, origin):
            prepared = prepare_stroke(field, chunk, seed=seed, tolerance=tolerance, course=course)
            prepared = replace(prepared, origin=origin)
        samples = render_samples(prepared, start - origin, stop - origin)
        yield RenderedChunk(samples, prepared.loudest, prepared.residual_power)


def _find_chunk_states(field: Field, start: int, stop: int, states: int) -> slice:
    """Return the rows of the 200 Hz states that 10 kHz samples start … stop − 1 depend on."""
    before = max(
        math.ceil(TAIL_SAMPLES / SAMPLES_PER_STATE),
        count_memory_states(field),
        math.ceil(AFTER_CONTACT_S * ACTION_RATE_HZ),
    )
    after = max(math.ceil(LEAD_SAMPLES / SAMPLES_PER_STATE), math.ceil(BEFORE_CONTACT_S * ACTION_RATE_HZ))
    first = start // SAMPLES_PER_STATE - before - count_memory_states(field) - _MARGIN_STATES
    last = -(-stop // SAMPLES_PER_STATE) + after + _MARGIN_STATES
    return slice(
        max(first // PASSAGE_STATES * PASSAGE_STATES, 0),
        min(-(-last // PASSAGE_STATES) * PASSAGE_STATES, states),
    )


def _select_action_states(action: Action, rows: slice) -> Action:
    """Return some of the states of an action."""
    names = ("direction", "speed", "force", "position", "contact")
    return replace(action, force_curve=None, **{name: getattr(action, name)[rows] for name in names})
