"""From a stroke whose F_Θ is evaluated to samples of the model rate, in blocks; any block is computable alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..cores import available_cpus, run_in_thread
from ..kernel.library import load_kernel, single_blas_thread_without_kernel
from .audible import BLOCK_SAMPLES, find_audible_spans, is_audible, split_blocks
from .contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .hops import HOP_SIZE
from .knots import Knots
from .modulation import sum_arc_carriers
from .path import extrapolate_position, interpolate_position
from .plain import render_carriers_full_rate
from .prepared import PreparedStroke
from .texture import REACH_SAMPLES, render_carrier_hops
from .timeline import SAMPLES_PER_STATE

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
