"""Slow amplitudes times fast carriers, cross-faded from one state of the action to the next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .carriers import ARC_PER_OCTAVE, Carriers
from .timeline import SAMPLES_PER_STATE, STATE_FRACTIONS

Float = NDArray[np.float64]
ArcSource = Callable[[int, int, int], Float]
"""(octave, start, count) → (24, count): band signals of an octave on its spatial grid."""

_LAGRANGE_TAPS = 4
"""Of the cubic interpolation between spatial samples."""


def interpolate_amplitudes(amplitude: Float, start: int, count: int) -> Float:
    """Linear interpolation of (n, K) state amplitudes at samples start … of the model rate, (count, K); held beyond."""
    first, states = start // SAMPLES_PER_STATE, len(amplitude)
    after = (start + max(count, 1) - 1) // SAMPLES_PER_STATE + 1
    near = amplitude[np.clip(np.arange(first, after + 1), 0, states - 1)].T[:, :, None]
    between = (near[:, :-1] * (1.0 - STATE_FRACTIONS) + near[:, 1:] * STATE_FRACTIONS).reshape(amplitude.shape[1], -1)
    return np.asarray(between[:, start - first * SAMPLES_PER_STATE :][:, :count].T)


def sum_arc_carriers(amplitude: Float, carriers: Carriers, source: ArcSource, position: Float, start: int) -> Float:
    """Σ_k A_k(t) c_k(s(t)) over the arc carriers.

    amplitude: (n, Ka). place: (count,) s at samples start … of the model rate, in metres. Per state the bands of an
    octave are first summed on the few spatial samples that the state's 5 ms cover, then read at s(t) once by cubic
    Lagrange interpolation: K bands cost as one.
    """
    count = len(position)
    out = np.zeros(count)
    state, share = locate_between_states(len(amplitude), start, count)
    for octave in range(carriers.arc_octaves):
        bands = slice(octave * ARC_PER_OCTAVE, (octave + 1) * ARC_PER_OCTAVE)
        for first, last in find_nonzero_ranges(amplitude[:, bands], state):
            stretch = slice(first, last)
            out[stretch] += _sum_octave(
                amplitude[:, bands], carriers.arc_step_m(octave), octave, source, position[stretch],
                state[stretch], share[stretch],
            )  # fmt: skip
    return out


def _sum_octave(
    amplitude: Float,
    step: float,
    octave: int,
    source: ArcSource,
    position: Float,
    state: NDArray[np.intp],
    share: Float,
) -> Float:
    cell = np.floor(position / step).astype(np.int64)
    t = position / step - cell
    # Per state: the span of cells it covers, with the taps' margins.
    starts = np.flatnonzero(np.concatenate([[True], np.diff(state) != 0]))
    low = np.minimum.reduceat(cell, starts) - 1
    length = np.maximum.reduceat(cell, starts) + 2 - low + 1
    offset = np.concatenate([[0], np.cumsum(length)])
    group = np.repeat(np.arange(len(starts)), np.diff(np.concatenate([starts, [len(position)]])))
    owner = np.repeat(np.arange(len(starts)), length)
    grid = np.arange(offset[-1]) - offset[owner] + low[owner]
    origin = int(grid.min())
    waves = source(octave, origin, int(grid.max()) - origin + 1).T[grid - origin]
    here = np.einsum("pk,pk->p", amplitude[state[starts]][owner], waves)
    after = np.einsum("pk,pk->p", amplitude[state[starts] + 1][owner], waves)
    first_tap = offset[group] + (cell - 1 - low[group])
    weights = lagrange_weights(t)
    total = np.zeros(len(position))
    for tap in range(_LAGRANGE_TAPS):
        total += weights[tap] * (here[first_tap + tap] * (1.0 - share) + after[first_tap + tap] * share)
    return total


def lagrange_weights(t: Float) -> tuple[Float, Float, Float, Float]:
    """Weights of samples −1, 0, 1, 2 at t in 0 … 1."""
    return (
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )


def find_states_read(states: int, start: int, count: int) -> slice:
    """The states between which samples start … start + count − 1 of the model rate lie; at least two."""
    state, _ = locate_between_states(states, start, count)
    return slice(int(state[0]), int(state[-1]) + 2) if count > 0 else slice(0, 0)


def locate_between_states(states: int, start: int, count: int) -> tuple[NDArray[np.intp], Float]:
    """Of samples start … start + count − 1: the state before each, and its share of the way to the next."""
    sample = start + np.arange(count)
    state = np.clip(sample // SAMPLES_PER_STATE, 0, states - 2)
    return state, np.clip(sample / SAMPLES_PER_STATE - state, 0.0, 1.0)


def find_nonzero_ranges(amplitude: Float, state: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Sample ranges in which an amplitude is not zero: nothing is computed where there is no contact."""
    if len(state) == 0:
        return []
    first = int(state[0])
    loud = np.any(amplitude[first : int(state[-1]) + 2] != 0.0, axis=1)
    active = np.concatenate([[False], loud[state - first] | loud[state + 1 - first], [False]])
    edges = np.flatnonzero(np.diff(active.astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
