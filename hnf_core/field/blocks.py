"""From a stroke whose F_Θ is evaluated to samples of the model rate, in blocks; any block is computable alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..cores import beside, cores
from ..kernel.library import kernel, one_blas_thread_in_numpy
from .audible import BLOCK, blocks_of, heard_spans, is_heard
from .contact_filter import LEAD, TAIL
from .hops import HOP
from .knots import Knots
from .modulation import arc_term
from .path import position, position_beyond
from .plain import plain_texture
from .prepared import Prepared
from .texture import REACH, texture_hops
from .timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]

THREAD_FROM_SAMPLES = 4 * BLOCK
"""From this many samples on, the contact term runs in a second thread."""


def rendered(prepared: Prepared, start: int = 0, stop: int | None = None) -> Float:
    """Samples start … stop − 1, all of them where nothing is said, (stop − start,)."""
    stop = prepared.count if stop is None else stop
    out = np.zeros(stop - start)
    with one_blas_thread_in_numpy():
        for first, count in heard_spans(prepared.audible[start:stop]):
            out[first : first + count] = render_block(prepared, start + first, count)
    return out


def render_block(prepared: Prepared, start: int, count: int) -> Float:
    """Samples start … start + count − 1 of the model rate in m/s², (count,) float64; independent of other blocks."""
    audible = prepared.audible[start : start + count]
    if not is_heard(audible):
        return np.zeros(count)
    if count < THREAD_FROM_SAMPLES or kernel() is None or cores() < 2:
        out = texture_term(prepared, start, count)
        out += contact_term(prepared, start, count)
    else:
        felt: list[Float] = []
        # Numpy would only wait for the interpreter, which the other thread holds.
        wait = beside(lambda: felt.append(contact_term(prepared, start, count)))
        try:
            out = texture_term(prepared, start, count)
        finally:
            wait()
        out += felt[0]
    out *= audible
    return out


def texture_term(prepared: Prepared, start: int, count: int) -> Float:
    """The carriers, modulated: 0 at rest and out of contact (but for the 40 ms memory)."""
    carriers, seed, action, origin = prepared.carriers, prepared.seed, prepared.action, prepared.origin
    if prepared.amplitude.shape[1] > 1 or carriers.constant:
        return plain_texture(prepared.amplitude, carriers, seed, action, start, count, origin)
    at = prepared.knots
    if at is None:
        at = SAMPLES_PER_STATE * np.arange(len(prepared.amplitude))
    knots, first = Knots(at + origin, prepared.amplitude[:, 0]), (origin + start) // HOP
    hops = range(first, (origin + start + count - 1) // HOP + 1)
    place = position_beyond(action, first * HOP - origin - REACH, len(hops) * HOP + 2 * REACH)
    begin = origin + start - first * HOP
    return texture_hops(knots, carriers, seed, place, hops)[begin : begin + count]


def contact_term(prepared: Prepared, start: int, count: int) -> Float:
    """Pressing: onset, release and dF/dt through the contact, also at v = 0; and the profile under the path."""
    out = prepared.bank.force_term(prepared.force, start, count)
    for at, many in blocks_of(count):
        out[at : at + many] += _profile_term(prepared, start + at, many)
    return out


def _profile_term(prepared: Prepared, start: int, count: int) -> Float | float:
    if prepared.bands is None or prepared.profile_amplitude is None:
        return 0.0
    first, many = start - TAIL, TAIL + count + LEAD
    height = arc_term(
        prepared.profile_amplitude, prepared.carriers, prepared.bands.source,
        position(prepared.action, first, many), first,
    )  # fmt: skip
    return prepared.bank.height_term(height, start)
