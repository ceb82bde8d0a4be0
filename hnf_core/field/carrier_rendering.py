"""Amplitudes over time as straight lines between knots.

Slow amplitudes times fast carriers, cross-faded from one state of the action to the next.

The carriers, modulated, hop by hop: the fast twin of plain.time_term and modulation.arc_term.

Between two knots the amplitudes are linear in time, so the bands are summed once per knot, in a product of matrices,
and what is left for a sample is two readings. What is slow is read at a half or a quarter of the rate and brought
up at the end, octaves and low bands together. A hop is a function of the knots and places within REACH of it.

The carriers at the full rate in float64, band by band: slow, plain, and what texture.texture_hops is tested against.

Also the one way for heads of one state, whose carriers lag.
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
from ..kernel import compiled_carriers as kernel_hop
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
    """at: (m,) ascending samples of the model rate, two at least. amplitude: (m, K), linear in time between knots; it
    holds beyond them."""

    at: Samples
    amplitude: NDArray[np.floating[Any]]

    def find_rows(self, first: Samples, last: Samples) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Those that say what happens at samples first … last of many stretches (n,), two at least: where they begin,
        and where they end."""
        low = np.maximum(np.searchsorted(self.at, first, side="right") - 1, 0)
        high = np.minimum(np.searchsorted(self.at, last, side="left") + 1, len(self.at))
        return np.minimum(low, len(self.at) - 2), np.maximum(high, 2)

    def select_range(self, first: int, last: int) -> Knots:
        """Those of one stretch alone, in float32."""
        low, high = self.find_rows(np.array([first]), np.array([last]))
        rows = slice(int(low[0]), int(high[0]))
        return Knots(self.at[rows], np.ascontiguousarray(self.amplitude[rows], dtype=np.float32))

    def select_carriers(self, carriers: slice) -> Knots:
        return Knots(self.at, self.amplitude[:, carriers])

    def locate(self, sample: Samples) -> tuple[NDArray[np.intp], Float32]:
        """Index of the knot before each sample (n,), and how far it is on the way to the next, 0 … 1."""
        row = np.clip(np.searchsorted(self.at, sample, side="right") - 1, 0, len(self.at) - 2)
        span = self.at[row + 1] - self.at[row]
        return row, np.clip((sample - self.at[row]) / span, 0.0, 1.0).astype(np.float32)

    def nonzero_by_group(self, carriers: int) -> NDArray[np.bool_]:
        """(K / carriers, m) whether any of so many neighbouring amplitudes is not zero."""
        return np.asarray(self.amplitude.reshape(len(self.at), -1, carriers).any(axis=2).T)

    def find_active_ranges(self, loud: NDArray[np.bool_], first: int, last: int) -> list[tuple[int, int]]:
        """Ranges of samples within first … last − 1 beside a knot that is loud (m,)."""
        if loud.all():
            return [(first, last)]
        active = np.concatenate([[False], loud[:-1] | loud[1:], [False]])
        edges = np.flatnonzero(np.diff(active.astype(np.int8)))
        bounds = self.at.copy()
        bounds[0], bounds[-1] = min(bounds[0], first), max(bounds[-1], last)
        pairs = zip(bounds[edges[::2]].tolist(), bounds[edges[1::2]].tolist(), strict=True)
        ranges = [(max(low, first), min(high, last)) for low, high in pairs]
        return [each for each in ranges if each[0] < each[1]]


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


_HALF_BAND_TAPS = 6
"""On either side of the filter that reads halfway between two samples: −90 dB up to MAX_RELATIVE_FREQUENCY."""
REACH_SAMPLES = max(margin << level for level, margin in enumerate(LEVEL_MARGINS))
_READ_CELLS = 4
_KNOTS_PER_PRODUCT = 48
"""Knots whose bands are summed at once: a sample needs two of the sums."""


def render_carrier_hops(knots: Knots, carriers: Carriers, seed: int, position: Float, hops: range) -> Float:
    """Σ_k A_k(t) c_k over the carriers in time and in arc length, samples of neighbouring hops, (n · HOP,); hop h has
    samples h · HOP … + HOP − 1, and is the same whatever is asked for beside it.

    place: (REACH + n · HOP + REACH,) s [m] from REACH samples before the first hop on. At most −57 dB of what is
    rendered are wrong where amplitudes take 20 ms to change, −50 dB where they jump from state to state.
    """
    compiled = load_kernel()
    if compiled is None:
        found = [
            _render_hop(knots, carriers, seed, _select_hop_positions(position, hop - hops.start), hop) for hop in hops
        ]
        return np.concatenate(found)
    begin = hops.start * HOP_SIZE - REACH_SAMPLES
    near = knots.select_range(begin, begin + len(position))
    sounds = _find_active_hops(near, near.amplitude[:, carriers.time_slice].any(axis=1), hops)
    return kernel_hop.render_hops(
        compiled, build_hop_tables(carriers), near.at, near.amplitude, hops.start * HOP_SIZE,
        np.ascontiguousarray(position),
        [get_time_hop(carriers, seed, hop) if each else None for hop, each in zip(hops, sounds, strict=True)],
        lambda octave, number: get_arc_hop(carriers, seed, octave, number),
    )  # fmt: skip


def _select_hop_positions(position: Float, hop: int) -> Float:
    """Of the places of all hops, those of one."""
    return position[hop * HOP_SIZE : (hop + 1) * HOP_SIZE + 2 * REACH_SAMPLES]


def _find_active_hops(knots: Knots, loud: NDArray[np.bool_], hops: range) -> list[bool]:
    """Of each hop, whether any of the knots that say what happens in it is loud (m,)."""
    begin = HOP_SIZE * np.arange(hops.start, hops.stop) - REACH_SAMPLES
    first, last = knots.find_rows(begin, begin + HOP_SIZE + 2 * REACH_SAMPLES)
    so_far = np.concatenate([[0], np.cumsum(loud)])
    return list((so_far[last] > so_far[first]).tolist())


def _render_hop(knots: Knots, carriers: Carriers, seed: int, position: Float, hop: int) -> Float:
    """In numpy: what the kernel is tested against."""
    first = hop * HOP_SIZE
    begin = first - REACH_SAMPLES
    near = knots.select_range(begin, begin + len(position))
    when = _Interpolation(begin, *near.locate(begin + np.arange(len(position))))
    rates = _MultirateSum(first)
    if carriers.time_count and np.any(near.amplitude[:, carriers.time_slice]):
        found = get_time_hop(carriers, seed, hop).waves
        for level, (bands, waves) in enumerate(zip(group_time_levels(carriers), found, strict=True)):
            start = first - (LEVEL_MARGINS[level] << level)
            samples = when.decimate(start, 1 << level, waves.shape[1])
            rates.add(level, start, _sum_time_bands(near.amplitude[:, carriers.time_slice][:, bands], waves, samples))
    for (level, start, count), octaves in _plan_readings(near, carriers, position, rates).items():
        at = position[start - begin :: 1 << level][:count]
        rates.add(
            level, start, _sum_arc_bands(near, carriers, seed, octaves, at, when.decimate(start, 1 << level, count))
        )
    return rates.upsample_and_sum()


def _plan_readings(
    near: Knots, carriers: Carriers, position: Float, rates: _MultirateSum
) -> dict[tuple[int, int, int], list[int]]:
    """Octaves that are read at the same samples: (level, first sample, how many) → octaves."""
    begin, found = rates.first - REACH_SAMPLES, defaultdict[tuple[int, int, int], list[int]](list)
    speed = np.abs(np.diff(position)) * MODEL_RATE_HZ
    for octave, loud in enumerate(near.select_carriers(carriers.arc_slice).nonzero_by_group(ARC_PER_OCTAVE)):
        lowest = carriers.arc_start_per_m * 2.0**octave
        for stretch in near.find_active_ranges(loud, begin, begin + len(position)):
            for low, high in _find_unaliased_ranges(speed, begin, stretch, lowest):
                fastest = float(speed[low - begin : high - begin - 1].max(initial=0.0))
                level = find_level(2.0 * lowest * fastest)
                start, count = rates.stored_range(level, low, high)
                if count:
                    found[level, start, count].append(octave)
    return found


def _octave_bands(carriers: Carriers, octave: int) -> slice:
    first = carriers.arc_slice.start + octave * ARC_PER_OCTAVE
    return slice(first, first + ARC_PER_OCTAVE)


@dataclass(frozen=True)
class _Interpolation:
    """Where samples lie between knots. begin: the first of them. row: (n,) the knot before. share: (n,) of the way to
    the next."""

    begin: int
    row: NDArray[np.intp]
    share: Float32

    def decimate(self, start: int, step: int, count: int) -> _Interpolation:
        """Every step-th sample from start on."""
        part = slice(start - self.begin, start - self.begin + step * count, step)
        return _Interpolation(start, self.row[part], self.share[part])


class _MultirateSum:
    """Partial sums at 1, ½ and ¼ of the model rate, upsampled and added at the end."""

    def __init__(self, first: int) -> None:
        self.first = first
        self._sums: list[Float32 | None] = [None] * LEVEL_COUNT

    def stored_range(self, level: int, low: int, high: int) -> tuple[int, int]:
        """The first of the samples low … high − 1 that this rate keeps, and how many they are."""
        margin, step = LEVEL_MARGINS[level] << level, 1 << level
        start = -(-max(low, self.first - margin) // step) * step
        return start, max(-(-(min(high, self.first + HOP_SIZE + margin) - start) // step), 0)

    def add(self, level: int, start: int, values: Float32) -> None:
        """values: every 2^level-th sample from `start` on."""
        sums, margin = self._sums[level], LEVEL_MARGINS[level]
        if sums is None:
            sums = self._sums[level] = np.zeros((HOP_SIZE >> level) + 2 * margin, dtype=np.float32)
        offset = ((start - self.first) >> level) + margin
        sums[offset : offset + len(values)] += values

    def upsample_and_sum(self) -> Float:
        """(HOP,) everything at the model rate."""
        slower: Float32 | None = None
        for level in range(LEVEL_COUNT - 1, 0, -1):
            here = self._sums[level]
            if slower is not None:
                here = slower if here is None else here + slower
            slower = None if here is None else _upsample_by_two(here, level)
        total = np.zeros(HOP_SIZE) if self._sums[0] is None else self._sums[0].astype(np.float64)
        return total if slower is None else total + slower


def _upsample_by_two(values: Float32, level: int) -> Float32:
    """The next rate up, with the margin that it keeps."""
    margin, wanted = LEVEL_MARGINS[level], LEVEL_MARGINS[level - 1]
    out = np.empty((HOP_SIZE >> (level - 1)) + 2 * wanted, dtype=np.float32)
    begin, count = margin - wanted // 2, len(out) // 2
    out[::2] = values[begin : begin + count]
    out[1::2] = np.convolve(
        values[begin - _HALF_BAND_TAPS + 1 : begin + count + _HALF_BAND_TAPS], _half_band_filter(), mode="valid"
    )
    return out


def _sum_time_bands(amplitude: Float32, waves: Float32, when: _Interpolation) -> Float32:
    """Σ_k A_k c_k of waves (K, n); (n,)."""
    out = np.empty(waves.shape[1], dtype=np.float32)
    for rows, part in _split_by_knots(when.row):
        sums = amplitude[rows] @ waves[:, part]
        index, column = when.row[part] - rows.start, np.arange(sums.shape[1])
        here = sums[index, column]
        out[part] = here + when.share[part] * (sums[index + 1, column] - here)
    return out


def _sum_arc_bands(
    near: Knots, carriers: Carriers, seed: int, octaves: list[int], position: Float, when: _Interpolation
) -> Float32:
    """Σ_k A_k c_k of the octaves at samples at place (n,) [m]; (n,)."""
    at = position / (CELL_SAMPLES * np.array([[carriers.arc_step_m(octave)] for octave in octaves]))
    cell = np.floor(at).astype(np.int64)
    weights = [weight.astype(np.complex64) for weight in compute_cell_weights((at - cell).astype(np.float32))]
    out = np.empty(at.shape, dtype=np.complex64)
    for rows, part in _split_by_knots(when.row):
        index, sums, behind = np.empty_like(cell[:, part]), [], 0
        nexts = np.empty((len(octaves), 1), dtype=np.int64)
        for which, octave in enumerate(octaves):
            own = cell[which, part]
            origin = int(own.min()) - 1
            waves = _gather_cells(carriers, seed, octave, origin, int(own.max()) + 3)
            amplitude = near.amplitude[rows, _octave_bands(carriers, octave)]
            sums.append((amplitude @ waves.view(np.float32)).view(np.complex64).ravel())
            nexts[which] = waves.shape[1]
            index[which] = (when.row[part] - rows.start) * waves.shape[1] + own + (behind - origin - 1)
            behind += len(sums[-1])
        flat = np.concatenate(sums)
        here = sum(weight[:, part] * flat.take(index + tap) for tap, weight in enumerate(weights))
        index += nexts
        after = sum(weight[:, part] * flat.take(index + tap) for tap, weight in enumerate(weights))
        out[:, part] = here + when.share[part] * (after - here)
    turn = at * (DEMODULATION_CYCLES / ARC_BLOCK_CELLS)
    angle = (2.0 * np.pi * (turn - np.floor(turn))).astype(np.float32)
    return np.asarray((out.real * np.cos(angle) - out.imag * np.sin(angle)).sum(axis=0))


@lru_cache(maxsize=8)
def build_hop_tables(carriers: Carriers) -> CarrierTables:
    levels = group_time_levels(carriers)
    return CarrierTables(
        margin=np.array(LEVEL_MARGINS), time_band=np.array([each.start for each in levels]),
        time_bands=np.array([each.stop - each.start for each in levels]),
        cells_per_m=np.array([1.0 / (CELL_SAMPLES * carriers.arc_step_m(k)) for k in range(carriers.arc_octaves)]),
        half_band=_half_band_filter(), cubic=np.array(_cubic_coefficients()), hop=HOP_SIZE, reach=REACH_SAMPLES,
        time_first=carriers.time_slice.start,
        arc_first=carriers.arc_slice.start, bands=ARC_PER_OCTAVE, piece_cells=ARC_HOP_CELLS, rate=MODEL_RATE_HZ,
        highest=MAX_RELATIVE_FREQUENCY, band_end=BAND_END_HZ, lowest=carriers.arc_start_per_m,
        turns=DEMODULATION_CYCLES / ARC_BLOCK_CELLS,
    )  # fmt: skip


def _gather_cells(carriers: Carriers, seed: int, octave: int, first: int, last: int) -> NDArray[np.complex64]:
    """(24, last − first) contiguous."""
    hops = range(first // ARC_HOP_CELLS, (last - 1) // ARC_HOP_CELLS + 1)
    waves = np.empty((ARC_PER_OCTAVE, last - first), dtype=np.complex64)
    for hop in hops:
        low, high = max(first, hop * ARC_HOP_CELLS), min(last, (hop + 1) * ARC_HOP_CELLS)
        source = get_arc_hop(carriers, seed, octave, hop).waves
        waves[:, low - first : high - first] = source[:, low - hop * ARC_HOP_CELLS : high - hop * ARC_HOP_CELLS]
    return waves


def _split_by_knots(row: NDArray[np.intp]) -> Iterator[tuple[slice, slice]]:
    """Knots, _ROWS or a few more, and the stretch of samples with ascending rows (n,) that lie between them."""
    low = 0
    while low < len(row):
        high = int(np.searchsorted(row, row[low] + _KNOTS_PER_PRODUCT, side="left"))
        yield slice(int(row[low]), int(row[high - 1]) + 2), slice(low, high)
        low = high


def _find_unaliased_ranges(speed: Float, begin: int, segment: tuple[int, int], lowest: float) -> list[tuple[int, int]]:
    """What of a stretch is not faster than an octave from wavenumber `lowest` on can sound: a jump of the hand, whose
    amplitudes are zero, would ask for metres of cells. speed: m/s from each sample after begin to the next."""
    low, high = segment
    too_fast = speed[low - begin : high - begin - 1] * lowest >= BAND_END_HZ
    if not too_fast.any():
        return [segment]
    slow = np.concatenate([[False], ~too_fast, [False]])
    edges = np.flatnonzero(np.diff(slow.astype(np.int8)))
    return [(low + int(a), low + int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@lru_cache(maxsize=1)
def _half_band_filter() -> Float32:
    """(2 · _TAPS,) of the filter that reads halfway between two samples, by least squares up to
    MAX_RELATIVE_FREQUENCY."""
    frequency = np.linspace(0.0, MAX_RELATIVE_FREQUENCY, 200)
    waves = 2.0 * np.cos(2.0 * np.pi * frequency[:, None] * (np.arange(_HALF_BAND_TAPS) + 0.5))
    half = np.linalg.lstsq(waves, np.ones(len(frequency)), rcond=None)[0]
    return np.asarray(np.concatenate([half[::-1], half]).astype(np.float32))


def compute_cell_weights(t: Float32) -> list[Float32]:
    """Weights of cells −1, 0, 1, 2 at t in 0 … 1."""
    return [((d * t + c) * t + b) * t + a for a, b, c, d in _cubic_coefficients()]


@lru_cache(maxsize=1)
def _cubic_coefficients() -> tuple[tuple[np.float32, ...], ...]:
    """Per cell, the powers of t: least squares over the eighth of a turn per cell that half an octave spans."""
    t, frequency = np.linspace(0.0, 1.0, 41), np.linspace(-0.125, 0.125, 81)
    waves = np.exp(2j * np.pi * frequency[:, None] * (np.arange(_READ_CELLS) - 1))
    basis = np.einsum("tp,fn->tfnp", t[:, None] ** np.arange(4), waves).reshape(-1, 4 * _READ_CELLS)
    wanted = np.exp(2j * np.pi * np.multiply.outer(t, frequency)).ravel()
    both = np.concatenate([basis.real, basis.imag]), np.concatenate([wanted.real, wanted.imag])
    taps = np.linalg.lstsq(*both, rcond=None)[0].astype(np.float32)
    return tuple(tuple(row) for row in taps.reshape(_READ_CELLS, 4))


def render_carriers_full_rate(
    amplitude: Float, carriers: Carriers, seed: int, action: Action, start: int, count: int, origin: int = 0
) -> Float:
    """Σ_h Σ_k A_hk(t) c_k(t + origin − h), (count,), of amplitudes (n, heads, K) at the states."""
    out = np.zeros(count)
    for delay, head in enumerate(np.moveaxis(amplitude, 1, 0)):
        if carriers.constant:
            out += interpolate_amplitudes(head[:, :1], start, count)[:, 0]
        if carriers.time_count:
            out += sum_time_carriers(head[:, carriers.time_slice], carriers, seed, start, count, delay, origin)
        if carriers.arc_count:
            place = interpolate_position(action, start - delay, count)
            out += sum_arc_carriers(
                head[:, carriers.arc_slice], carriers,
                lambda octave, first, length: carriers.arc_samples(seed, octave, first, length), place, start,
            )  # fmt: skip
    return out


def sum_time_carriers(
    amplitude: Float, carriers: Carriers, seed: int, start: int, count: int, delay: int = 0, origin: int = 0
) -> Float:
    """Σ_k A_k(t) c_k(t + origin − delay) over the time carriers; amplitude (n, Kt), returns (count,)."""
    out = np.zeros(count)
    state, share = locate_between_states(len(amplitude), start, count)
    for first, last in find_nonzero_ranges(amplitude, state):
        wave = carriers.time_samples(seed, origin + start + first - delay, last - first)
        stretch = slice(first, last)
        # Grouped by state, A is constant: two small products in place of one amplitude per sample and band.
        for low in range(int(state[first]), int(state[last - 1]) + 1):
            inside = slice(*np.searchsorted(state[stretch], (low, low + 1)))
            pair = amplitude[low : low + 2] @ wave[:, inside]
            fade = share[stretch][inside]
            out[stretch][inside] = pair[0] * (1.0 - fade) + pair[1] * fade
    return out
