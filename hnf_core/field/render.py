"""From a stroke whose F_Θ is evaluated to samples of the model rate, in blocks; any block is computable alone.

A stroke of any length in the memory of a minute: cut into portions that overlap by all they remember.

A sample follows from the states around it: the contact's impulse response (TAIL, LEAD), F_Θ's memory, the fades at the
ends of contact. Each portion is prepared with that much on either side and rendered without it. The carriers go by the
stroke's own clock and place, so that no portion begins them anew. Portions and margins are whole numbers of the states
that are evaluated at once, whose number F_Θ's float32 products follow.
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
from ..threads import available_cpus, run_in_thread
from .carrier_rendering import REACH_SAMPLES, Knots, render_carrier_hops, render_carriers_full_rate, sum_arc_carriers
from .contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .field import Field
from .noise_cache import HOP_SIZE, prefetch_noise
from .prepare import (
    AFTER_CONTACT_S,
    BEFORE_CONTACT_S,
    BLOCK_SAMPLES,
    CHUNK_STATES,
    PreparedStroke,
    count_memory_states,
    find_audible_spans,
    is_audible,
    prepare_stroke,
    split_blocks,
)
from .stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    extrapolate_position,
    interpolate_position,
    resample_action,
    sample_count,
)

Float = NDArray[np.float64]

MIN_THREADED_SAMPLES = 4 * BLOCK_SAMPLES
"""From this many samples on, the contact term runs in a second thread."""


def render_samples(prepared: PreparedStroke, start: int = 0, stop: int | None = None) -> Float:
    """Samples start … stop − 1, all of them where nothing is said, (stop − start,)."""
    stop = prepared.count if stop is None else stop
    out = np.zeros(stop - start)
    with single_blas_thread_without_kernel():
        for first, count in find_audible_spans(prepared.audible[start:stop]):
            out[first : first + count] = render_block(prepared, start + first, count)
    return out


def render_block(prepared: PreparedStroke, start: int, count: int) -> Float:
    """Samples start … start + count − 1 of the model rate in m/s², (count,) float64; independent of other blocks."""
    audible = prepared.audible[start : start + count]
    if not is_audible(audible):
        return np.zeros(count)
    if count < MIN_THREADED_SAMPLES or load_kernel() is None or available_cpus() < 2:
        out = render_carriers(prepared, start, count)
        out += render_contact(prepared, start, count)
    else:
        felt: list[Float] = []
        # Numpy would only wait for the interpreter, which the other thread holds.
        wait = run_in_thread(lambda: felt.append(render_contact(prepared, start, count)))
        try:
            out = render_carriers(prepared, start, count)
        finally:
            wait()
        out += felt[0]
    out *= audible
    return out


def render_carriers(prepared: PreparedStroke, start: int, count: int) -> Float:
    """The carriers, modulated: 0 at rest and out of contact (but for the 40 ms memory)."""
    carriers, seed, action, origin = prepared.carriers, prepared.seed, prepared.action, prepared.origin
    if prepared.amplitude.shape[1] > 1 or carriers.constant:
        return render_carriers_full_rate(prepared.amplitude, carriers, seed, action, start, count, origin)
    at = prepared.knots
    if at is None:
        at = SAMPLES_PER_STATE * np.arange(len(prepared.amplitude))
    knots, first = Knots(at + origin, prepared.amplitude[:, 0]), (origin + start) // HOP_SIZE
    hops = range(first, (origin + start + count - 1) // HOP_SIZE + 1)
    place = extrapolate_position(
        action, first * HOP_SIZE - origin - REACH_SAMPLES, len(hops) * HOP_SIZE + 2 * REACH_SAMPLES
    )
    begin = origin + start - first * HOP_SIZE
    return render_carrier_hops(knots, carriers, seed, place, hops)[begin : begin + count]


def render_contact(prepared: PreparedStroke, start: int, count: int) -> Float:
    """Pressing: onset, release and dF/dt through the contact, also at v = 0; and the profile under the path."""
    out = prepared.bank.render_force(prepared.force, start, count)
    for at, many in split_blocks(count):
        out[at : at + many] += _render_profile(prepared, start + at, many)
    return out


def _render_profile(prepared: PreparedStroke, start: int, count: int) -> Float | float:
    if prepared.bands is None or prepared.profile_amplitude is None:
        return 0.0
    first, many = start - TAIL_SAMPLES, TAIL_SAMPLES + count + LEAD_SAMPLES
    height = sum_arc_carriers(
        prepared.profile_amplitude, prepared.carriers, prepared.bands.read_bands,
        interpolate_position(prepared.action, first, many), first,
    )  # fmt: skip
    return prepared.bank.render_height(height, start)


CHUNK_STEP = math.lcm(BLOCK_SAMPLES, HOP_SIZE, CHUNK_STATES * SAMPLES_PER_STATE)
"""Samples: portions are cut where blocks and groups of states both begin."""
CHUNK_SAMPLES = 6 * CHUNK_STEP
"""61 s: F_Θ's amplitudes take 25 MB of it."""
_MARGIN_STATES = 4
"""States to either side that splines and the reading of a band look at."""


@dataclass(frozen=True)
class RenderedChunk:
    """samples: (m,) float64 m/s² at the model rate, following those of the portion before. loudest: the field's largest
    amplitude in it, m/s². missed: see Prepared."""

    samples: Float
    loudest: float
    residual_power: float


def render_chunks(
    field: Field, stroke: StrokeInput, *, seed: int, length: int = CHUNK_SAMPLES, begin: int = 0,
    tolerance: float | None = None,
) -> Iterator[RenderedChunk]:  # fmt: skip
    """synthesise() at the model rate, portion by portion: together within 1e-6 of its RMS (places are counted from
    another zero, and rounded to float32), in memory that does not grow with the stroke.

    length: samples of a portion. begin: the sample to begin at; what comes before it is not computed. Both whole
    numbers of STEP. tolerance: as of prepare(), of the power of each portion: where one begins, amplitudes may step by
    as much. Raises StrokeError for an action without duration, UsageError for another length, or for a stroke
    with a height profile, which is one piece.
    """
    if length <= 0 or length % CHUNK_STEP or begin < 0 or begin % CHUNK_STEP:
        raise UsageError(f"a portion of {length} samples from {begin} on: both must be whole numbers of {CHUNK_STEP}.")
    if stroke.profile is not None:
        raise UsageError(
            "a stroke with a height profile cannot be cut into portions.", remedy="Synthesise it whole, or without it."
        )
    action, token_index = resample_action(stroke)
    count = sample_count(action)
    for start in range(begin, count, length):
        stop = min(start + length, count)
        rows = _find_chunk_states(field, start, stop, len(action.speed))
        origin = rows.start * SAMPLES_PER_STATE
        piece = StrokeInput(_select_action_states(action, rows), stroke.tokens, stroke.mechanics, token_index[rows])
        with prefetch_noise(field.config, seed, piece.action, origin):
            prepared = replace(prepare_stroke(field, piece, seed=seed, tolerance=tolerance), origin=origin)
        samples = render_samples(prepared, start - origin, stop - origin)
        yield RenderedChunk(samples, float(prepared.loudest.max(initial=0.0)), prepared.residual_power)


def _find_chunk_states(field: Field, start: int, stop: int, states: int) -> slice:
    """The states that samples start … stop − 1 follow from."""
    before = max(
        math.ceil(TAIL_SAMPLES / SAMPLES_PER_STATE),
        count_memory_states(field),
        math.ceil(AFTER_CONTACT_S * ACTION_RATE_HZ),
    )
    after = max(math.ceil(LEAD_SAMPLES / SAMPLES_PER_STATE), math.ceil(BEFORE_CONTACT_S * ACTION_RATE_HZ))
    first = start // SAMPLES_PER_STATE - before - count_memory_states(field) - _MARGIN_STATES
    last = -(-stop // SAMPLES_PER_STATE) + after + _MARGIN_STATES
    return slice(
        max(first // CHUNK_STATES * CHUNK_STATES, 0),
        min(-(-last // CHUNK_STATES) * CHUNK_STATES, states),
    )


def _select_action_states(action: Action, rows: slice) -> Action:
    names = ("direction", "speed", "force", "position", "contact")
    return replace(action, **{name: getattr(action, name)[rows] for name in names})
