"""Modulate the carriers (noise bands c_k): Σ_k A_k(t) c_k, with amplitudes that are linear in time between knots.

`render_carrier_hops` is the fast renderer, by the compiled kernel or in numpy, in hops (fixed stretches of HOP_SIZE
samples). Carriers run in time, or along the path for surface texture (arc length s). The amplitude is linear between
two knots, so the bands are summed once with the amplitudes of either knot, in a matrix product, and the two sums
cross-faded. Slow bands are computed at a half or a quarter of the rate and upsampled at the end. A hop depends only on
the knots and positions within REACH_SAMPLES of it. `render_carriers_full_rate` computes the same at the full rate in
float64, band by band: the exact version to compare with, and the renderer of fields with N heads, whose carriers lag.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel import compiled_carriers
from ..kernel.compiled_carriers import CarrierTables
from ..kernel.loader import load_kernel
from .carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ, Carriers
from .linear_contact import BAND_END_HZ
from .noise_cache import (
    ARC_BLOCK_CELLS,
    ARC_HOP_CELLS,
    CELL_SAMPLES,
    DEMODULATION_CYCLES,
    HOP_SIZE,
    LEVEL_COUNT,
    LEVEL_MARGINS,
    MAX_RELATIVE_FREQUENCY,
    find_level,
    get_arc_hop,
    get_time_hop,
    group_time_levels,
)
from .stroke import SAMPLES_PER_STATE, STATE_FRACTIONS, interpolate_position

Float32 = NDArray[np.float32]
Samples = NDArray[np.int64]


@dataclass(frozen=True)
class Knots:
    """Carrier amplitudes at knots (points in time), linear in time between them and constant beyond.

    at: (m,) ascending samples of the model rate, two at least. amplitude: (m, K).
    """

    at: Samples
    amplitude: NDArray[np.floating[Any]]

    def find_rows(self, first: Samples, last: Samples) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the knot rows (begin, end) that determine samples first … last of each of n ranges; at least two rows.

        first, last: (n,) [samples].
        """
        low = np.maximum(np.searchsorted(self.at, first, side="right") - 1, 0)
        high = np.minimum(np.searchsorted(self.at, last, side="left") + 1, len(self.at))
        return np.minimum(low, len(self.at) - 2), np.maximum(high, 2)

    def select_range(self, first: int, last: int) -> Knots:
        """Return only the knots that determine samples first … last, in float32."""
        low, high = self.find_rows(np.array([first]), np.array([last]))
        rows = slice(int(low[0]), int(high[0]))
        return Knots(self.at[rows], np.ascontiguousarray(self.amplitude[rows], dtype=np.float32))

    def select_carriers(self, carriers: slice) -> Knots:
        """Return all knots, with the amplitudes of some carriers only."""
        return Knots(self.at, self.amplitude[:, carriers])

    def locate(self, sample: Samples) -> tuple[NDArray[np.intp], Float32]:
        """Return the knot before each sample (n,), and the fraction of the way to the next, 0 … 1."""
        row = np.clip(np.searchsorted(self.at, sample, side="right") - 1, 0, len(self.at) - 2)
        span = self.at[row + 1] - self.at[row]
        return row, np.clip((sample - self.at[row]) / span, 0.0, 1.0).astype(np.float32)

    def nonzero_by_group(self, carriers: int) -> NDArray[np.bool_]:
        """Return (K / carriers, m): per group of adjacent carriers, whether any amplitude at a knot is not zero.

        carriers: number of carriers in a group.
        """
        return np.asarray(self.amplitude.reshape(len(self.at), -1, carriers).any(axis=2).T)

    def find_active_ranges(self, loud: NDArray[np.bool_], first: int, last: int) -> list[tuple[int, int]]:
        """Return the sample ranges within first … last − 1 in which an amplitude may be nonzero.

        loud: (m,) True at knots with a nonzero amplitude; a range extends to the knots beside them.
        """
        if loud.all():
            return [(first, last)]
        active = np.concatenate([[False], loud[:-1] | loud[1:], [False]])
        edges = np.flatnonzero(np.diff(active.astype(np.int8)))
        bounds = self.at.copy()
        bounds[0], bounds[-1] = min(bounds[0], first), max(bounds[-1], last)
        pairs = zip(bounds[edges[::2]].tolist(), bounds[edges[1::2]].tolist(), strict=True)
        ranges = [(max(low, first), min(high, last)) for low, high in pairs]
        return [sample_range for sample_range in ranges if sample_range[0] < sample_range[1]]


Float = NDArray[np.float64]
ArcSource = Callable[[int, int, int], Float]
"""Function (octave, start, count) → (24, count) band signals of an octave on its spatial grid."""

_LAGRANGE_TAPS = 4
"""Taps of the cubic interpolation between spatial samples."""


def interpolate_amplitudes(amplitude: Float, start: int, count: int) -> Float:
    """Interpolate amplitudes (n, K) at 200 Hz states linearly at 10 kHz samples start, start + 1, …; (count, K).

    Amplitudes are constant beyond the ends.
    """
    first, states = start // SAMPLES_PER_STATE, len(amplitude)
    last = (start + max(count, 1) - 1) // SAMPLES_PER_STATE + 1
    neighbours = amplitude[np.clip(np.arange(first, last + 1), 0, states - 1)].T[:, :, None]
    interpolated = (neighbours[:, :-1] * (1.0 - STATE_FRACTIONS) + neighbours[:, 1:] * STATE_FRACTIONS).reshape(
        amplitude.shape[1], -1
    )
    return np.asarray(interpolated[:, start - first * SAMPLES_PER_STATE :][:, :count].T)


def sum_arc_carriers(amplitude: Float, carriers: Carriers, source: ArcSource, position: Float, start: int) -> Float:
    """Compute Σ_k A_k(t) c_k(s(t)), (count,), over the arc carriers (noise bands along the path).

    Per state the bands of an octave are first summed on the few spatial samples that the state's 5 ms cover, then read
    at s(t) once by cubic Lagrange interpolation: K bands cost as much as one.

    Parameters
    ----------
    amplitude
        (n, Ka) of each arc carrier at the 200 Hz states.
    carriers
        Carriers of the field.
    source
        Function that returns an octave's 24 band signals on its spatial grid.
    position
        (count,) s [m] at samples start … of the model rate.
    start
        First sample, at 10 kHz.
    """
    count = len(position)
    total = np.zeros(count)
    state, fraction = locate_between_states(len(amplitude), start, count)
    for octave in range(carriers.arc_octaves):
        bands = slice(octave * ARC_PER_OCTAVE, (octave + 1) * ARC_PER_OCTAVE)
        for first, last in find_nonzero_ranges(amplitude[:, bands], state):
            samples = slice(first, last)
            total[samples] += _sum_octave(
                amplitude[:, bands], carriers.arc_step_m(octave), octave, source, position[samples],
                state[samples], fraction[samples],
            )  # fmt: skip
    return total


def _sum_octave(
    amplitude: Float,
    step: float,
    octave: int,
    source: ArcSource,
    position: Float,
    state: NDArray[np.intp],
    share: Float,
) -> Float:
    """Sum one octave's bands at positions (count,) [m], weighted by their amplitudes (n, 24) at the states.

    step: spacing of the octave's spatial grid [m]. state, share: (count,) state before each position and way to the
    next.
    """
    cell = np.floor(position / step).astype(np.int64)
    t = position / step - cell
    # Each state covers a span of cells, extended by the interpolation's taps.
    starts = np.flatnonzero(np.concatenate([[True], np.diff(state) != 0]))
    low = np.minimum.reduceat(cell, starts) - 1
    lengths = np.maximum.reduceat(cell, starts) + 2 - low + 1
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    group = np.repeat(np.arange(len(starts)), np.diff(np.concatenate([starts, [len(position)]])))
    owner = np.repeat(np.arange(len(starts)), lengths)
    grid = np.arange(offsets[-1]) - offsets[owner] + low[owner]
    origin = int(grid.min())
    waves = source(octave, origin, int(grid.max()) - origin + 1).T[grid - origin]
    at_state = np.einsum("pk,pk->p", amplitude[state[starts]][owner], waves)
    at_next = np.einsum("pk,pk->p", amplitude[state[starts] + 1][owner], waves)
    first_tap = offsets[group] + (cell - 1 - low[group])
    weights = lagrange_weights(t)
    total = np.zeros(len(position))
    for tap in range(_LAGRANGE_TAPS):
        total += weights[tap] * (at_state[first_tap + tap] * (1.0 - share) + at_next[first_tap + tap] * share)
    return total


def lagrange_weights(t: Float) -> tuple[Float, Float, Float, Float]:
    """Return the cubic Lagrange weights of samples −1, 0, 1, 2 at t in 0 … 1."""
    return (
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )


def find_states_read(states: int, start: int, count: int) -> slice:
    """Return the 200 Hz states around 10 kHz samples start … start + count − 1, as a slice; at least two."""
    state, _ = locate_between_states(states, start, count)
    return slice(int(state[0]), int(state[-1]) + 2) if count > 0 else slice(0, 0)


def locate_between_states(states: int, start: int, count: int) -> tuple[NDArray[np.intp], Float]:
    """Return for each 10 kHz sample the 200 Hz state before it, and the fraction of the way to the next, (count,) each.

    start, count: the samples are start … start + count − 1. states: number of states.
    """
    sample = start + np.arange(count)
    state = np.clip(sample // SAMPLES_PER_STATE, 0, states - 2)
    return state, np.clip(sample / SAMPLES_PER_STATE - state, 0.0, 1.0)


def find_nonzero_ranges(amplitude: Float, state: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Return the sample ranges in which an amplitude is not zero; nothing is computed out of contact.

    amplitude: (n, K) at the states. state: (count,) state before each sample.
    """
    if len(state) == 0:
        return []
    first = int(state[0])
    is_nonzero = np.any(amplitude[first : int(state[-1]) + 2] != 0.0, axis=1)
    active = np.concatenate([[False], is_nonzero[state - first] | is_nonzero[state + 1 - first], [False]])
    edges = np.flatnonzero(np.diff(active.astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


_HALF_BAND_TAPS = 6
"""Taps on either side of the half-band filter: −90 dB up to MAX_RELATIVE_FREQUENCY."""
REACH_SAMPLES = max(margin << level for level, margin in enumerate(LEVEL_MARGINS))
_READ_CELLS = 4
_KNOTS_PER_PRODUCT = 48
"""Knots whose bands are summed in one product; a sample needs two of the sums."""


def render_carrier_hops(knots: Knots, carriers: Carriers, seed: int, position: Float, hops: range) -> Float:
    """Compute Σ_k A_k(t) c_k over time and arc carriers in n adjacent hops of HOP_SIZE samples, (n · HOP_SIZE,).

    Hop h has samples h · HOP_SIZE … + HOP_SIZE − 1, and does not depend on which other hops are rendered.

    Parameters
    ----------
    knots
        Amplitudes of all carriers.
    carriers, seed
        Carriers and their seed.
    position
        (REACH_SAMPLES + n · HOP_SIZE + REACH_SAMPLES,) position s along the path [m] at each sample, from REACH_SAMPLES
        before the first hop on.
    hops
        Numbers of the n hops.

    Notes
    -----
    The error against render_carriers_full_rate is at most −57 dB where amplitudes take 20 ms to change, −50 dB where
    they jump from state to state.
    """
    kernel = load_kernel()
    if kernel is None:
        samples = [
            _render_hop(knots, carriers, seed, _select_hop_positions(position, hop - hops.start), hop) for hop in hops
        ]
        return np.concatenate(samples)
    begin = hops.start * HOP_SIZE - REACH_SAMPLES
    near = knots.select_range(begin, begin + len(position))
    is_active = _find_active_hops(near, near.amplitude[:, carriers.time_slice].any(axis=1), hops)
    return compiled_carriers.render_hops(
        kernel, build_hop_tables(carriers), near.at, near.amplitude, hops.start * HOP_SIZE,
        np.ascontiguousarray(position),
        [get_time_hop(carriers, seed, hop) if active else None for hop, active in zip(hops, is_active, strict=True)],
        lambda octave, number: get_arc_hop(carriers, seed, octave, number),
    )  # fmt: skip


def _select_hop_positions(position: Float, hop: int) -> Float:
    """Return the positions [m] that a hop needs; `hop` counts from the first that `position` was given for."""
    return position[hop * HOP_SIZE : (hop + 1) * HOP_SIZE + 2 * REACH_SAMPLES]


def _find_active_hops(knots: Knots, loud: NDArray[np.bool_], hops: range) -> list[bool]:
    """Return for each hop whether any knot that determines it has a nonzero amplitude, as `loud` (m,) says per knot."""
    begin = HOP_SIZE * np.arange(hops.start, hops.stop) - REACH_SAMPLES
    first, last = knots.find_rows(begin, begin + HOP_SIZE + 2 * REACH_SAMPLES)
    loud_before = np.concatenate([[0], np.cumsum(loud)])
    return list((loud_before[last] > loud_before[first]).tolist())


def _render_hop(knots: Knots, carriers: Carriers, seed: int, position: Float, hop: int) -> Float:
    """Render one hop (HOP_SIZE,) in numpy, as the compiled kernel does."""
    first = hop * HOP_SIZE
    begin = first - REACH_SAMPLES
    near = knots.select_range(begin, begin + len(position))
    interpolation = _Interpolation(begin, *near.locate(begin + np.arange(len(position))))
    level_sums = _MultirateSum(first)
    if carriers.time_count and np.any(near.amplitude[:, carriers.time_slice]):
        time_waves = get_time_hop(carriers, seed, hop).waves
        for level, (bands, waves) in enumerate(zip(group_time_levels(carriers), time_waves, strict=True)):
            start = first - (LEVEL_MARGINS[level] << level)
            samples = interpolation.decimate(start, 1 << level, waves.shape[1])
            level_sums.add(
                level, start, _sum_time_bands(near.amplitude[:, carriers.time_slice][:, bands], waves, samples)
            )
    for (level, start, count), octaves in _plan_readings(near, carriers, position, level_sums).items():
        positions = position[start - begin :: 1 << level][:count]
        level_sums.add(
            level,
            start,
            _sum_arc_bands(near, carriers, seed, octaves, positions, interpolation.decimate(start, 1 << level, count)),
        )
    return level_sums.upsample_and_sum()


def _plan_readings(
    near: Knots, carriers: Carriers, position: Float, rates: _MultirateSum
) -> dict[tuple[int, int, int], list[int]]:
    """Group the octaves of arc carriers that are evaluated at the same samples: (level, first sample, count) → octaves.

    level: how often the sample rate is halved, 0 to 2, by the highest frequency that the hand's speed gives the octave.
    """
    begin, readings = rates.first - REACH_SAMPLES, defaultdict[tuple[int, int, int], list[int]](list)
    speed = np.abs(np.diff(position)) * MODEL_RATE_HZ
    for octave, loud in enumerate(near.select_carriers(carriers.arc_slice).nonzero_by_group(ARC_PER_OCTAVE)):
        lowest = carriers.arc_start_per_m * 2.0**octave
        for segment in near.find_active_ranges(loud, begin, begin + len(position)):
            for low, high in _find_unaliased_ranges(speed, begin, segment, lowest):
                fastest = float(speed[low - begin : high - begin - 1].max(initial=0.0))
                level = find_level(2.0 * lowest * fastest)
                start, count = rates.stored_range(level, low, high)
                if count:
                    readings[level, start, count].append(octave)
    return readings


def _octave_bands(carriers: Carriers, octave: int) -> slice:
    """Return the columns of one octave's 24 arc carriers among all carriers."""
    first = carriers.arc_slice.start + octave * ARC_PER_OCTAVE
    return slice(first, first + ARC_PER_OCTAVE)


@dataclass(frozen=True)
class _Interpolation:
    """Positions of n samples between the knots, for linear interpolation of amplitudes.

    begin: first sample. row: (n,) knot before each sample. share: (n,) fraction of the way to the next.
    """

    begin: int
    row: NDArray[np.intp]
    share: Float32

    def decimate(self, start: int, step: int, count: int) -> _Interpolation:
        """Return the same for every step-th sample from `start` on."""
        samples = slice(start - self.begin, start - self.begin + step * count, step)
        return _Interpolation(start, self.row[samples], self.share[samples])


class _MultirateSum:
    """Partial sums of one hop at 1, ½ and ¼ of the model rate, upsampled and added at the end."""

    def __init__(self, first: int) -> None:
        self.first = first
        self._sums: list[Float32 | None] = [None] * LEVEL_COUNT

    def stored_range(self, level: int, low: int, high: int) -> tuple[int, int]:
        """Return where samples low … high − 1 are stored at a level: the first stored one, and their number.

        level: how often the model rate is halved, so that every 2^level-th sample is stored.
        """
        margin, step = LEVEL_MARGINS[level] << level, 1 << level
        start = -(-max(low, self.first - margin) // step) * step
        return start, max(-(-(min(high, self.first + HOP_SIZE + margin) - start) // step), 0)

    def add(self, level: int, start: int, values: Float32) -> None:
        """Add values to the partial sum at every 2^level-th sample from `start` on."""
        sums, margin = self._sums[level], LEVEL_MARGINS[level]
        if sums is None:
            sums = self._sums[level] = np.zeros((HOP_SIZE >> level) + 2 * margin, dtype=np.float32)
        offset = ((start - self.first) >> level) + margin
        sums[offset : offset + len(values)] += values

    def upsample_and_sum(self) -> Float:
        """Return the sum (HOP_SIZE,) at the model rate."""
        upsampled: Float32 | None = None
        for level in range(LEVEL_COUNT - 1, 0, -1):
            level_sum = self._sums[level]
            if upsampled is not None:
                level_sum = upsampled if level_sum is None else level_sum + upsampled
            upsampled = None if level_sum is None else _upsample_by_two(level_sum, level)
        total = np.zeros(HOP_SIZE) if self._sums[0] is None else self._sums[0].astype(np.float64)
        return total if upsampled is None else total + upsampled


def _upsample_by_two(values: Float32, level: int) -> Float32:
    """Return the samples at the next higher rate (level − 1), with the margin that is kept around a hop there."""
    margin, next_margin = LEVEL_MARGINS[level], LEVEL_MARGINS[level - 1]
    out = np.empty((HOP_SIZE >> (level - 1)) + 2 * next_margin, dtype=np.float32)
    begin, count = margin - next_margin // 2, len(out) // 2
    out[::2] = values[begin : begin + count]
    out[1::2] = np.convolve(
        values[begin - _HALF_BAND_TAPS + 1 : begin + count + _HALF_BAND_TAPS], _half_band_filter(), mode="valid"
    )
    return out


def _sum_time_bands(amplitude: Float32, waves: Float32, when: _Interpolation) -> Float32:
    """Compute Σ_k A_k c_k (n,) of bands with waves c (K, n) and amplitudes A (m, K) at the knots."""
    out = np.empty(waves.shape[1], dtype=np.float32)
    for rows, samples in _split_by_knots(when.row):
        sums = amplitude[rows] @ waves[:, samples]
        index, column = when.row[samples] - rows.start, np.arange(sums.shape[1])
        at_knot = sums[index, column]
        out[samples] = at_knot + when.share[samples] * (sums[index + 1, column] - at_knot)
    return out


def _sum_arc_bands(
    near: Knots, carriers: Carriers, seed: int, octaves: list[int], position: Float, when: _Interpolation
) -> Float32:
    """Compute Σ_k A_k c_k(s), (n,), of the arc carriers in some octaves at position s (n,) [m]."""
    cell_position = position / (CELL_SAMPLES * np.array([[carriers.arc_step_m(octave)] for octave in octaves]))
    cell = np.floor(cell_position).astype(np.int64)
    weights = [
        weight.astype(np.complex64) for weight in compute_cell_weights((cell_position - cell).astype(np.float32))
    ]
    out = np.empty(cell_position.shape, dtype=np.complex64)
    for rows, samples in _split_by_knots(when.row):
        index, sums, offset = np.empty_like(cell[:, samples]), [], 0
        strides = np.empty((len(octaves), 1), dtype=np.int64)
        for number, octave in enumerate(octaves):
            octave_cells = cell[number, samples]
            origin = int(octave_cells.min()) - 1
            waves = _gather_cells(carriers, seed, octave, origin, int(octave_cells.max()) + 3)
            amplitude = near.amplitude[rows, _octave_bands(carriers, octave)]
            sums.append((amplitude @ waves.view(np.float32)).view(np.complex64).ravel())
            strides[number] = waves.shape[1]
            index[number] = (when.row[samples] - rows.start) * waves.shape[1] + octave_cells + (offset - origin - 1)
            offset += len(sums[-1])
        flat = np.concatenate(sums)
        at_knot = sum(weight[:, samples] * flat.take(index + tap) for tap, weight in enumerate(weights))
        index += strides
        at_next = sum(weight[:, samples] * flat.take(index + tap) for tap, weight in enumerate(weights))
        out[:, samples] = at_knot + when.share[samples] * (at_next - at_knot)
    turn = cell_position * (DEMODULATION_CYCLES / ARC_BLOCK_CELLS)
    angle = (2.0 * np.pi * (turn - np.floor(turn))).astype(np.float32)
    return np.asarray((out.real * np.cos(angle) - out.imag * np.sin(angle)).sum(axis=0))


@lru_cache(maxsize=8)
def build_hop_tables(carriers: Carriers) -> CarrierTables:
    """Build the constants that the compiled kernel needs to render hops of these carriers."""
    levels = group_time_levels(carriers)
    return CarrierTables(
        margin=np.array(LEVEL_MARGINS), time_band=np.array([bands.start for bands in levels]),
        time_bands=np.array([bands.stop - bands.start for bands in levels]),
        cells_per_m=np.array([1.0 / (CELL_SAMPLES * carriers.arc_step_m(k)) for k in range(carriers.arc_octaves)]),
        half_band=_half_band_filter(), cubic=np.array(_cubic_coefficients()), hop=HOP_SIZE, reach=REACH_SAMPLES,
        time_first=carriers.time_slice.start, arc_first=carriers.arc_slice.start, bands=ARC_PER_OCTAVE,
        piece_cells=ARC_HOP_CELLS, rate=MODEL_RATE_HZ, highest=MAX_RELATIVE_FREQUENCY, band_end=BAND_END_HZ,
        lowest=carriers.arc_start_per_m, turns=DEMODULATION_CYCLES / ARC_BLOCK_CELLS,
    )  # fmt: skip


def _gather_cells(carriers: Carriers, seed: int, octave: int, first: int, last: int) -> NDArray[np.complex64]:
    """Return an octave's noise waves (24, last − first) in cells first … last − 1, joined over hops.

    A cell is one complex sample of a wave along the path, demodulated to save samples (see noise_cache).
    """
    hops = range(first // ARC_HOP_CELLS, (last - 1) // ARC_HOP_CELLS + 1)
    waves = np.empty((ARC_PER_OCTAVE, last - first), dtype=np.complex64)
    for hop in hops:
        low, high = max(first, hop * ARC_HOP_CELLS), min(last, (hop + 1) * ARC_HOP_CELLS)
        source = get_arc_hop(carriers, seed, octave, hop).waves
        waves[:, low - first : high - first] = source[:, low - hop * ARC_HOP_CELLS : high - hop * ARC_HOP_CELLS]
    return waves


def _split_by_knots(row: NDArray[np.intp]) -> Iterator[tuple[slice, slice]]:
    """Yield groups of about _KNOTS_PER_PRODUCT knots, with the samples between them, for one matrix product each.

    row: (n,) ascending knot before each sample.
    """
    low = 0
    while low < len(row):
        high = int(np.searchsorted(row, row[low] + _KNOTS_PER_PRODUCT, side="left"))
        yield slice(int(row[low]), int(row[high - 1]) + 2), slice(low, high)
        low = high


def _find_unaliased_ranges(speed: Float, begin: int, segment: tuple[int, int], lowest: float) -> list[tuple[int, int]]:
    """Return the parts of a sample range in which the hand is slow enough that an octave does not alias.

    lowest: lowest wavenumber of the octave [cycles/m]. Amplitudes are zero during a jump of the hand, but rendering it
    would draw metres of noise. speed: [m/s] from each sample after `begin` to the next.
    """
    low, high = segment
    too_fast = speed[low - begin : high - begin - 1] * lowest >= BAND_END_HZ
    if not too_fast.any():
        return [segment]
    slow = np.concatenate([[False], ~too_fast, [False]])
    edges = np.flatnonzero(np.diff(slow.astype(np.int8)))
    return [(low + int(start), low + int(stop) + 1) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


@lru_cache(maxsize=1)
def _half_band_filter() -> Float32:
    """Return the FIR filter (2 · _HALF_BAND_TAPS,) that interpolates halfway between samples, to double the rate.

    Least-squares design over frequencies up to MAX_RELATIVE_FREQUENCY of the sample rate.
    """
    frequency = np.linspace(0.0, MAX_RELATIVE_FREQUENCY, 200)
    waves = 2.0 * np.cos(2.0 * np.pi * frequency[:, None] * (np.arange(_HALF_BAND_TAPS) + 0.5))
    half = np.linalg.lstsq(waves, np.ones(len(frequency)), rcond=None)[0]
    return np.asarray(np.concatenate([half[::-1], half]).astype(np.float32))


def compute_cell_weights(t: Float32) -> list[Float32]:
    """Compute the interpolation weights of the spatial samples −1, 0, 1, 2 at t, 0 … 1, between 0 and 1."""
    return [((d * t + c) * t + b) * t + a for a, b, c, d in _cubic_coefficients()]


@lru_cache(maxsize=1)
def _cubic_coefficients() -> tuple[tuple[np.float32, ...], ...]:
    """Return the cubic polynomials in t, (4, 4), that give the weights of spatial samples −1, 0, 1, 2 at t in 0 … 1.

    Fitted by least squares over the spectrum of a demodulated octave, an eighth of a turn per sample on either side of
    0.
    """
    t, frequency = np.linspace(0.0, 1.0, 41), np.linspace(-0.125, 0.125, 81)
    waves = np.exp(2j * np.pi * frequency[:, None] * (np.arange(_READ_CELLS) - 1))
    basis = np.einsum("tp,fn->tfnp", t[:, None] ** np.arange(4), waves).reshape(-1, 4 * _READ_CELLS)
    target = np.exp(2j * np.pi * np.multiply.outer(t, frequency)).ravel()
    system = np.concatenate([basis.real, basis.imag]), np.concatenate([target.real, target.imag])
    taps = np.linalg.lstsq(*system, rcond=None)[0].astype(np.float32)
    return tuple(tuple(row) for row in taps.reshape(_READ_CELLS, 4))


def render_carriers_full_rate(
    amplitude: Float, carriers: Carriers, seed: int, action: Action, start: int, count: int, origin: int = 0
) -> Float:
    """Compute Σ_h Σ_k A_hk(t) c_k(t + origin − h) at the full rate, (count,), over heads h and carriers k.

    Parameters
    ----------
    amplitude
        (n, heads, K) at the 200 Hz states.
    carriers, seed
        Carriers and their seed.
    action
        Action at ACTION_RATE_HZ.
    start, count
        Range of samples.
    origin
        Sample number on the carriers' clock at which the stroke begins, if it is part of a longer one.
    """
    out = np.zeros(count)
    for delay, head in enumerate(np.moveaxis(amplitude, 1, 0)):
        if carriers.constant:
            out += interpolate_amplitudes(head[:, :1], start, count)[:, 0]
        if carriers.time_count:
            out += sum_time_carriers(head[:, carriers.time_slice], carriers, seed, start, count, delay, origin)
        if carriers.arc_count:
            position = interpolate_position(action, start - delay, count)
            out += sum_arc_carriers(
                head[:, carriers.arc_slice], carriers,
                lambda octave, first, length: carriers.arc_samples(seed, octave, first, length), position, start,
            )  # fmt: skip
    return out


def sum_time_carriers(
    amplitude: Float, carriers: Carriers, seed: int, start: int, count: int, delay: int = 0, origin: int = 0
) -> Float:
    """Compute Σ_k A_k(t) c_k(t + origin − delay) over the time carriers, (count,), from sample `start` on.

    amplitude: (n, Kt) at the 200 Hz states. delay, origin: [samples].
    """
    out = np.zeros(count)
    state, fraction = locate_between_states(len(amplitude), start, count)
    for first, last in find_nonzero_ranges(amplitude, state):
        wave = carriers.time_samples(seed, origin + start + first - delay, last - first)
        samples = slice(first, last)
        # Within a state A is linear, so two small products replace one amplitude per sample and band.
        for low in range(int(state[first]), int(state[last - 1]) + 1):
            inside = slice(*np.searchsorted(state[samples], (low, low + 1)))
            pair = amplitude[low : low + 2] @ wave[:, inside]
            fade = fraction[samples][inside]
            out[samples][inside] = pair[0] * (1.0 - fade) + pair[1] * fade
    return out
