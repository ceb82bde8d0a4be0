"""Compiled rendering of the noise carriers and of the filters around them.

Holds the C calls that draw noise bands and turn them into waves, render carriers modulated by amplitudes, hop by hop (a
fixed number of samples), read arc-length carriers for a live hand, interpolate the hand's position, filter the pressing
force, and find the bends of an action. The numpy implementations of the same are in field/carriers.py,
field/carrier_rendering.py, field/live/carriers.py, field/stroke.py, field/contact/contact_filter.py and
field/adaptive_sampling.py.
"""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..threads import parallel_for
from .loader import get_address, get_row_layout, pack_pointers

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

_CARRIER_COUNTS = ("hop", "reach", "levels", "time_first", "arc_first", "octaves", "bands", "piece_cells", "taps")
_CARRIER_NUMBERS = ("rate", "highest", "band_end", "lowest", "turns")
_CARRIER_ARRAYS = ("margin", "time_band", "time_bands", "cells_per_m", "half_band", "cubic")
_MAX_LEVELS = 8
_READING_SIZE = 8
"""Integers in one hnf_reading."""
_FIRST_CELL_COLUMN, _LAST_CELL_COLUMN, _ARC_HOP_COLUMN = 4, 5, 6
MIN_HOPS_PER_THREAD = 2
"""Fewest hops for which another thread pays."""
_MAX_CELL = 2.0**52
_EXPECTED_READINGS_PER_HOP = 16
"""Readings of a hop that memory is reserved for: enough unless the hand jumps, which adds readings."""


class ArcHop(NamedTuple):
    """Noise along the path: carriers of one octave over one hop, a stretch of fixed length.

    waves: (B, cells) of B bands at complex spatial samples (cells), contiguous. address: of waves, computed once.
    """

    waves: NDArray[np.complex64]
    address: int

    @staticmethod
    def from_waves(waves: NDArray[np.complex64]) -> ArcHop:
        """Store waves (B, cells) of B bands together with their memory address."""
        return ArcHop(waves, get_address(waves, np.complex64))


class TimeHop(NamedTuple):
    """Noise bands in time over one hop, a fixed number of samples.

    waves: per sample rate (the model's, its half, its quarter) the (bands, samples) stored at it, contiguous.
    addresses: packed pointers to them, computed once.
    """

    waves: tuple[Float32, ...]
    addresses: bytes

    @staticmethod
    def from_waves(waves: tuple[Float32, ...]) -> TimeHop:
        """Store a hop's noise carriers, one array (bands, samples) per sample rate, with their memory addresses."""
        return TimeHop(waves, pack_pointers([get_address(level, np.float32) for level in waves]))


class _CarrierStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in _CARRIER_COUNTS),
        *((name, ctypes.c_double) for name in _CARRIER_NUMBERS),
        *((name, ctypes.c_void_p) for name in _CARRIER_ARRAYS),
    )


class _KnotsStruct(ctypes.Structure):
    _fields_ = (
        ("at", ctypes.c_void_p), ("amplitude", ctypes.c_void_p), ("count", ctypes.c_int64), ("stride", ctypes.c_int64),
    )  # fmt: skip


class CarrierTables:
    """Constants of a set of noise carriers in the form the C functions read, the struct hnf_carriers of hnf_kernel.h.

    The object owns the arrays that the C structure points to.

    Parameters
    ----------
    margin, time_band, time_bands
        (levels,) samples kept on either side of a hop, first band and number of bands, for each stored sample rate
        (level: how often it is halved).
    cells_per_m
        (octaves,) complex spatial samples (cells) per metre.
    half_band
        (2 taps,) filter that reads halfway between two samples.
    cubic
        (4, 4) coefficients of the cubic spatial interpolation.
    **numbers
        The other numbers of the struct by their names.

    Raises
    ------
    ValueError
        If these do not fit together.
    """

    def __init__(
        self, *, margin: Integers, time_band: Integers, time_bands: Integers, cells_per_m: Float, half_band: Float32,
        cubic: Float32, **numbers: float,
    ) -> None:  # fmt: skip
        arrays = (margin, time_band, time_bands, cells_per_m, half_band, cubic)
        dtypes: Sequence[Any] = (np.int64, np.int64, np.int64, np.float64, np.float32, np.float32)
        self._arrays = [np.ascontiguousarray(array, dtype=dtype) for array, dtype in zip(arrays, dtypes, strict=True)]
        self.levels, self.octaves, self.cells_per_m = len(margin), len(cells_per_m), cells_per_m.tolist()
        counts = {"levels": self.levels, "octaves": self.octaves, "taps": len(half_band) // 2, **numbers}
        self.hop, self.reach = int(numbers["hop"]), int(numbers["reach"])
        self.bands, self.piece_cells = int(numbers["bands"]), int(numbers["piece_cells"])
        self.time_bands = time_bands.tolist()
        self.samples_per_level = [(self.hop >> level) + 2 * int(array) for level, array in enumerate(margin)]
        is_valid = 0 < self.levels <= _MAX_LEVELS and len(time_band) == len(time_bands) == self.levels
        # Doubling a rate reads half the filter beyond the next level's margin, and each level must halve the hop
        # evenly.
        is_valid &= self.hop % (1 << self.levels) == 0 and cubic.shape == (4, 4) and len(half_band) % 2 == 0
        is_valid &= all(
            low >= high // 2 + len(half_band) // 2 and high % 2 == 0
            for high, low in zip(margin[:-1].tolist(), margin[1:].tolist(), strict=True)
        )
        is_valid &= all(int(array) << level <= self.reach for level, array in enumerate(margin))
        if not is_valid:
            raise ValueError(f"a hop of {self.hop} samples at {self.levels} rates with margins {margin.tolist()}")
        self.time_shapes = list(zip(self.time_bands, self.samples_per_level, strict=True))
        self.columns = max(
            int(numbers["arc_first"]) + self.octaves * self.bands,
            int(numbers["time_first"]) + int((time_band + time_bands).max(initial=0)),
        )
        self.struct = _CarrierStruct(
            *(int(counts[name]) for name in _CARRIER_COUNTS), *(counts[name] for name in _CARRIER_NUMBERS),
            *(array.__array_interface__["data"][0] for array in self._arrays),
        )  # fmt: skip


def render_hops(
    kernel: ctypes.CDLL, tables: CarrierTables, at: Integers, amplitude: Float32, first: int, position: Float,
    waves: Sequence[TimeHop | None], get_arc_hop: Callable[[int, int], ArcHop],
) -> Float:  # fmt: skip
    """Render Σ_k A_k c_k over all carriers in n adjacent hops (hop samples each), from sample `first` on.

    Parameters
    ----------
    kernel
        Library of `load_kernel`.
    tables
        Constants of the carriers.
    at, amplitude
        (m,) ascending knots [samples] and (m, K) amplitudes there.
    first
        First sample of the first hop.
    position
        (reach + n · hop + reach,) path position s [m] at the samples.
    waves
        Noise bands in time for each hop; None where their amplitudes are zero.
    get_arc_hop
        Function (octave, hop number) → noise along the path.

    Returns
    -------
    ndarray
        (n · hop,) samples.

    Raises
    ------
    ValueError
        If shapes do not fit, or a position is not finite.
    """
    _find_extent(tables, position)
    count = len(waves)
    if len(position) != count * tables.hop + 2 * tables.reach or not 2 <= len(at) == len(amplitude):
        raise ValueError(f"{len(position)} places, {len(at)} knots and {len(amplitude)} rows of amplitudes")
    if amplitude.shape[1] < tables.columns:
        raise ValueError(f"amplitudes of {amplitude.shape[1]} carriers, of which {tables.columns} are read")
    knots = _KnotsStruct(get_address(at, np.int64), *_get_knot_layout(amplitude))
    shared = ctypes.byref(tables.struct), ctypes.byref(knots)
    readings, counts = _plan_readings(kernel, shared, first, count, position)
    arc_hops = _collect_arc_hops(tables, readings, get_arc_hop)
    time_pointers = b"".join(_pack_time_hop(tables, hop_waves) for hop_waves in waves)
    arc_pointers = pack_pointers([hop_waves.address for hop_waves in arc_hops])
    cells = int((readings[:, _LAST_CELL_COLUMN] - readings[:, _FIRST_CELL_COLUMN]).max(initial=0)) + 1
    first_reading, out = np.concatenate([[0], np.cumsum(counts)]), np.empty((count, tables.hop))
    bytes_per_hop = len(time_pointers) // max(count, 1)

    def render_part(low: int, high: int) -> None:
        scratch = np.empty(3 * sum(tables.samples_per_level) + 2 * cells)
        kernel.hnf_hops(
            *shared, first + low * tables.hop, high - low, get_address(position[low * tables.hop :], np.float64),
            time_pointers[low * bytes_per_hop :], arc_pointers, get_address(readings[first_reading[low] :], np.int64),
            get_address(counts[low:], np.int64), get_address(scratch, np.float64), get_address(out[low:], np.float64),
        )  # fmt: skip

    parallel_for(render_part, count, MIN_HOPS_PER_THREAD)
    return out.reshape(-1)


class ArcReader:
    """Evaluator of Σ_k A_k c_k(s), noise along the path, over one 5 ms step; its buffers are reused.

    Parameters
    ----------
    tables
        Constants of the carriers.
    share
        (count,) of each sample, fraction of the way from the amplitudes at the step's start to those at its end.
    """

    def __init__(self, tables: CarrierTables, share: Float32) -> None:
        self._tables, self._count = tables, len(share)
        self.amplitude = np.zeros((2, tables.octaves * tables.bands), dtype=np.float32)
        self._out = np.empty(self._count, dtype=np.float32)
        row = np.zeros(self._count, dtype=np.int64)
        self._before = ctypes.byref(tables.struct), *get_row_layout(self.amplitude)
        self._between = get_address(row, np.int64), get_address(share, np.float32), self._count
        self._scratch, self._buffers = np.empty(0), (share, row)

    def read(
        self, kernel: ctypes.CDLL, octaves: Sequence[int], position: Float, get_arc_hop: Callable[[int, int], ArcHop]
    ) -> Float32:
        """Sum the carriers of some octaves at path positions (count,) [m], times the amplitudes in self.amplitude.

        Set self.amplitude (2, octaves · bands) first. The next call overwrites the result. get_arc_hop: function
        (octave, hop number) → noise along the path. Raises ValueError if shapes do not fit or a position is not finite.
        """
        tables, cells = self._tables, self._tables.piece_cells
        lowest, highest = _find_extent(tables, position)
        if len(position) != self._count or not all(0 <= octave < tables.octaves for octave in octaves):
            raise ValueError(f"octaves {list(octaves)} at {len(position)} places")
        readings, arc_pointers, longest = list[int](), list[int](), 0
        for octave in octaves:
            cells_per_m = tables.cells_per_m[octave]
            first, last = math.floor(lowest * cells_per_m) - 1, math.floor(highest * cells_per_m) + 2
            first_hop = first // cells
            readings += (octave, 0, 0, self._count, first, last, len(arc_pointers), first_hop * cells)
            for number in range(first_hop, last // cells + 1):
                arc_pointers.append(_check_arc_hop(tables, get_arc_hop(octave, number)).address)
            longest = max(longest, last - first + 1)
        if len(self._scratch) < 2 * longest:
            self._scratch = np.empty(2 * longest)
        kernel.hnf_read_arcs(
            *self._before, pack_pointers(arc_pointers), struct.pack(f"{len(readings)}q", *readings), len(octaves),
            get_address(position, np.float64), *self._between, get_address(self._scratch, np.float64),
            get_address(self._out, np.float32),
        )  # fmt: skip
        return self._out


def _find_extent(tables: CarrierTables, position: Float) -> tuple[float, float]:
    """Return the smallest and largest position [m].

    Raises ValueError if one is not finite, or so large that the number of its spatial sample is no exact integer in
    float64.
    """
    lowest, highest = float(position.min()), float(position.max())
    if not max(-lowest, highest) * max(tables.cells_per_m, default=1.0) < _MAX_CELL:
        raise ValueError(f"places from {lowest} to {highest} m")
    return lowest, highest


def _plan_readings(
    kernel: ctypes.CDLL, shared: tuple[Any, Any], first: int, count: int, position: Float
) -> tuple[Integers, Integers]:
    """Return which parts of the arc carriers must be evaluated, as integer rows, and the number of rows of each hop.

    A row ("reading") is an octave over a range of samples within a hop.
    """
    capacity, counts = _EXPECTED_READINGS_PER_HOP * count, np.empty(count, dtype=np.int64)
    while True:
        readings = np.empty((capacity, _READING_SIZE), dtype=np.int64)
        needed = int(
            kernel.hnf_plan_hops(
                *shared, first, count, get_address(position, np.float64), capacity, get_address(readings, np.int64),
                get_address(counts, np.int64),
            )
        )  # fmt: skip
        if needed <= capacity:
            return readings[:needed], counts
        capacity = needed


def _collect_arc_hops(
    tables: CarrierTables, readings: Integers, get_arc_hop: Callable[[int, int], ArcHop]
) -> list[ArcHop]:
    """Return the noise along the path that all readings need, and store in each where its part begins.

    readings: integer rows of _plan_readings.
    """
    arc_hops: list[ArcHop] = []
    starts: list[int] = []
    by_number: dict[tuple[int, int], ArcHop] = {}
    cells = tables.piece_cells
    for octave, first, last in readings[:, [0, _FIRST_CELL_COLUMN, _LAST_CELL_COLUMN]].tolist():
        starts.append(len(arc_hops))
        for number in range(first // cells, last // cells + 1):
            arc_hop = by_number.get((octave, number))
            if arc_hop is None:
                arc_hop = by_number[octave, number] = _check_arc_hop(tables, get_arc_hop(octave, number))
            arc_hops.append(arc_hop)
    readings[:, _ARC_HOP_COLUMN], readings[:, _ARC_HOP_COLUMN + 1] = (
        starts,
        readings[:, _FIRST_CELL_COLUMN] // cells * cells,
    )
    return arc_hops


def _check_arc_hop(tables: CarrierTables, arc_hop: ArcHop) -> ArcHop:
    """Return `arc_hop` if the shape of its waves fits the tables; raise ValueError otherwise."""
    if arc_hop.waves.shape != (tables.bands, tables.piece_cells):
        expected = f"{tables.bands} bands of {tables.piece_cells} cells"
        raise ValueError(f"a piece of {arc_hop.waves.shape} where {expected} are read")
    return arc_hop


def _pack_time_hop(tables: CarrierTables, waves: TimeHop | None) -> bytes:
    """Return packed pointers to a hop's time carriers, one per stored sample rate; null pointers for None."""
    if waves is None:
        return bytes(tables.levels * struct.calcsize("P"))
    shapes = [level_waves.shape for level_waves in waves.waves]
    if shapes != tables.time_shapes:
        raise ValueError(f"carriers in time of {shapes}")
    return waves.addresses


def _get_knot_layout(amplitude: Float32) -> tuple[int, int, int]:
    """Return address, number of rows and row stride (in elements) of the amplitudes (m, K) at m knots."""
    begin, stride = get_row_layout(amplitude)
    return begin, len(amplitude), stride


def interpolate_position(kernel: ctypes.CDLL, position: Float, samples_per_state: int, start: int, count: int) -> Float:
    """Interpolate the path position s(t) [m] at `count` samples from `start` on, given (n,) at the states.

    Raises ValueError for fewer than two states.
    """
    if len(position) < 2:
        raise ValueError(f"a path of {len(position)} states")
    out = np.empty(count)
    kernel.hnf_place(
        get_address(position, np.float64), len(position), samples_per_state, start, count, get_address(out, np.float64)
    )
    return out


Complex = NDArray[np.complex128]
Starts = NDArray[np.int64]

TILE_SAMPLES = 32
"""Samples computed at once, half of them by mirroring; lengths must be multiples of it."""


def draw_bins(kernel: ctypes.CDLL, key: tuple[int, int, int], pairs: int, first: int, level: Float) -> Complex:
    """Draw (n,) complex normal FFT bins, level · sqrt(−2 log u) · e^{2πiv} (Box & Muller 1958), from bin `first` on.

    key: seed, stream and block number, as unsigned words. pairs: pairs (u, v) of random words in a block. level: (n,)
    scale of each bin. Raises ValueError if the bins exceed the block.
    """
    if not 0 <= first <= first + len(level) <= pairs:
        raise ValueError(f"words {first} to {first + len(level) - 1} of {pairs} pairs")
    out = np.empty(len(level), dtype=np.complex128)
    kernel.hnf_bins(*key, pairs, first, len(level), get_address(level, np.float64), get_address(out, np.complex128))
    return out


def render_real_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, which: Starts, slow: Float32, turns: tuple[Float32, Float32],
    window: Float32, out: Float32,
) -> None:  # fmt: skip
    """Compute waves of noise bands, 2 Re Σ_k X_k e^{2πikn/size} times window, into the rows `which` of out (B, size).

    Parameters
    ----------
    kernel
        Library of `load_kernel`.
    bins, starts
        (Σ W,) FFT bins X of the bands, one after another; (B + 1,) first bin of each band, and the end of the last.
    which
        (rows,) indices of the bands to compute.
    slow
        (2W, size / 2 + 1) cosines of 0 … W − 1 turns, then their sines; W at least the widest band.
    turns
        Cosine and sine (rows, size / 2 + 1) of each band's first bin.
    window
        (size,).
    out
        (B, size) result.

    Raises
    ------
    ValueError
        If these do not fit together.
    TypeError
        If out is read-only.
    """
    size = out.shape[1]
    _check_waves(out, slow, turns, window, which, bins, starts)
    kernel.hnf_real_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), get_address(which, np.int64), len(which),
        len(slow) // 2, size, get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns),
        get_address(window, np.float32), get_address(out, np.float32, writable=True),
    )  # fmt: skip


def render_complex_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, slow: Float32, turns: tuple[Float32, Float32], window: Float32,
    out: NDArray[np.complex64],
) -> None:  # fmt: skip
    """Compute complex waves of noise bands into out (B, size): Σ_k X_k e^{2πi(k − middle)n/size}, times window.

    turns: cosine and sine (B, size / 2 + 1) of each band's first bin minus the middle. Other parameters and errors as
    of render_real_waves.
    """
    bands, size = out.shape
    _check_waves(out, slow, turns, window, np.arange(bands), bins, starts)
    kernel.hnf_complex_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), bands, len(slow) // 2, size,
        get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns),
        get_address(window, np.float32), get_address(out, np.complex64, writable=True),
    )  # fmt: skip


def _check_waves(
    out: NDArray[Any], slow: Float32, turns: tuple[Float32, Float32], window: Float32, which: Starts, bins: Complex,
    starts: Starts,
) -> None:  # fmt: skip
    """Raise ValueError if bins, bands and tables do not fit together."""
    rows, size = out.shape
    half = size // 2 + 1
    tables_fit = (
        size % TILE_SAMPLES == 0 and slow.shape[1] == half and all(turn.shape == (len(which), half) for turn in turns)
    )
    widths = np.diff(starts)
    bands_fit = rows == len(widths) and len(bins) == starts[-1] - starts[0] and bool((widths >= 0).all())
    bands_fit = bands_fit and (not len(which) or bool(0 <= which.min() <= which.max() < rows))
    if not tables_fit or len(window) != size or not bands_fit or widths[which].max(initial=0) > len(slow) // 2:
        raise ValueError(f"{len(bins)} bins as waves of {rows} × {size} samples, from tables of {slow.shape[1]}")


MAX_SAMPLES_PER_STATE = 64
"""Size of the C function's buffer [samples]."""


class StateResponses:
    """Responses of acceleration to pressing force, as tables, for B contacts (a material under a load each).

    Parameters
    ----------
    tables
        Per contact (rows, samples): the samples of one 5 ms state as 1 N in each neighbouring state causes them, the
        earliest state first.
    ahead
        Number of last rows that belong to states after the samples.

    Raises
    ------
    ValueError
        If the tables do not fit together.
    """

    def __init__(self, tables: Sequence[Float], ahead: int) -> None:
        widths = {table.shape[1] for table in tables}
        if (
            len(widths) != 1
            or max(widths) > MAX_SAMPLES_PER_STATE
            or not all(len(table) > ahead >= 0 for table in tables)
        ):
            raise ValueError(f"what is given to states: {[table.shape for table in tables]}, {ahead} rows ahead")
        self.tables, self.ahead, self.samples = tuple(tables), ahead, widths.pop()
        self._row_counts = np.array([len(table) for table in tables], dtype=np.int64)
        self._table_pointers = pack_pointers([get_address(table, np.float64) for table in tables])

    def compute_force_response(self, kernel: ctypes.CDLL, force: Float, weight: Float, first: int, count: int) -> Float:
        """Return the acceleration (count · samples,) [m/s²] from state `first` on.

        force: (n,) [N] at the states. weight: (n, B) of each contact. Both are constant beyond their ends. Raises
        ValueError if shapes do not fit.
        """
        if weight.shape != (len(force), len(self.tables)) or not len(force):
            raise ValueError(f"{weight.shape} weights of {len(self.tables)} contacts at {len(force)} states")
        out = np.empty(count * self.samples)
        kernel.hnf_press(
            get_address(force, np.float64), len(force), get_address(weight, np.float64), len(self.tables),
            self._table_pointers, get_address(self._row_counts, np.int64), self.ahead, self.samples, first, count,
            get_address(out, np.float64),
        )  # fmt: skip
        return out


def integrate_motion(
    kernel: ctypes.CDLL, contact: Float, drives: Float, state: Float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Integrate a probe dragged over a relief; return its acceleration (steps,) along normal and path [m/s²].

    contact: (13,) constants of hnf_moving_contact. drives: (5, steps + 2). state: (5,), updated. Raises ValueError if
    shapes do not fit.
    """
    if contact.shape != (13,) or len(drives) != 5 or drives.shape[1] < 2 or state.shape != (5,):
        raise ValueError(f"a contact {contact.shape}, drives {drives.shape} and the state {state.shape}")
    steps = drives.shape[1] - 2
    normal, along = np.empty(steps), np.empty(steps)
    kernel.hnf_contact_motion(
        get_address(contact, np.float64), get_address(drives, np.float64), drives.shape[1], steps,
        get_address(state, np.float64, writable=True), get_address(normal, np.float64, writable=True),
        get_address(along, np.float64, writable=True),
    )  # fmt: skip
    return normal, along


class _DisplacementStruct(ctypes.Structure):
    _fields_ = (
        ("grid", ctypes.c_void_p),
        ("points", ctypes.c_int64),
        *((name, ctypes.c_double) for name in ("start", "per_m")),
    )


class _TonesStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("turns", "between", "scatter", "amplitude", "offsets", "knots")),
        *((name, ctypes.c_int64) for name in ("states", "lines", "harmonics", "knot_count", "per_state")),
    )


class ToneRenderer:
    """Tones of lines along a path, as the kernel renders them.

    Parameters
    ----------
    turns
        (states, L) phases of the lines [turns].
    between
        (states − 1, L) their wavenumbers between two states [cycles/m]; at least one row.
    scatter
        (states, 2, L) phase by which a displacement of 1 along either axis shifts them [turns].
    knots
        (m,) ascending samples of the amplitudes.
    amplitude
        (m, L · harmonics) RMS of the tones there [m/s²].
    harmonics
        Number of tones of each line, at 1, 2, … times its wavenumber.
    offsets
        (L · harmonics,) phase of the tones where the path begins [turns].
    samples_per_state
        Samples from one state to the next.
    """

    def __init__(
        self, turns: Float, between: Float, scatter: Float, knots: NDArray[np.int64], amplitude: Float, harmonics: int,
        offsets: Float, samples_per_state: int,
    ) -> None:  # fmt: skip
        states, lines, tones = *turns.shape, turns.shape[1] * harmonics
        shapes = between.shape, scatter.shape, amplitude.shape, offsets.shape
        if shapes != ((max(states - 1, 1), lines), (states, 2, lines), (len(knots), tones), (tones,)):
            raise ValueError(f"{turns.shape} phases with {shapes}")
        arrays = turns, between, scatter, amplitude, offsets
        self._arrays = *arrays, knots
        self._struct = _TonesStruct(
            *(get_address(array, np.float64) for array in arrays), get_address(knots, np.int64), states, lines,
            harmonics, len(knots), samples_per_state,
        )  # fmt: skip

    def render(
        self,
        kernel: ctypes.CDLL,
        way: Float,
        position: Float,
        start: int,
        displacement: tuple[Float, float, float] | None = None,
    ) -> NDArray[np.float64]:
        """Render samples start, start + 1, ….

        way: (count,) along the path from the state before each, position: along the whole path [m]. displacement: of
        the lines along the axes (2, points), where the first point is [m], and the points per metre; None if the lines
        are even.
        """
        out, struct = np.zeros(len(way)), _DisplacementStruct(None, 0, 0.0, 0.0)
        if displacement is not None:
            grid, first, per_m = displacement
            struct = _DisplacementStruct(get_address(grid, np.float64), grid.shape[1], first, per_m)
        kernel.hnf_tones(
            ctypes.byref(self._struct), ctypes.byref(struct), get_address(way, np.float64),
            get_address(position, np.float64), start, len(way), get_address(out, np.float64, writable=True),
        )  # fmt: skip
        return out


def integrate_tap(kernel: ctypes.CDLL, contact: Float, modes: Float, force: Float, every: int, state: Float) -> Float:
    """Integrate the motion of a mass on a nonlinear contact; return every so many steps' acceleration [m/s²].

    contact: (6,) constants of hnf_normal_contact. modes: (m, 5) biquads. force: (steps,) [N]. state: (2 + 2 m,) height,
    velocity and two numbers of each mode, updated. Raises ValueError if shapes do not fit.
    """
    if contact.shape != (6,) or modes.shape[1:] != (5,) or state.shape != (2 + 2 * len(modes),):
        raise ValueError(f"a contact {contact.shape} with modes {modes.shape} and the state {state.shape}")
    if every < 1 or len(force) % every:
        raise ValueError(f"{len(force)} steps, {every} a sample")
    out = np.empty(len(force) // every)
    kernel.hnf_tap(
        get_address(contact, np.float64), get_address(modes, np.float64), len(modes), get_address(force, np.float64),
        len(force), every, get_address(state, np.float64, writable=True), get_address(out, np.float64, writable=True),
    )  # fmt: skip
    return out


def find_bends(
    kernel: ctypes.CDLL, course: NDArray[np.float64], required: NDArray[np.int64], tolerance: float
) -> NDArray[np.int64]:
    """Return the rows of a sampled curve (n, channels) that approximate it by straight lines within `tolerance`.

    Rows ascend. required: rows that are always included, the first and the last among them. Raises ValueError if they
    are not.
    """
    if not len(required) or required[0] != 0 or required[-1] != len(course) - 1:
        raise ValueError(f"a course of {len(course)} states from {required[:1]} to {required[-1:]}")
    marked = np.zeros(len(course), dtype=np.uint8)
    marked[required] = 1
    kernel.hnf_bends(get_address(course, np.float64), *course.shape, tolerance, get_address(marked, np.uint8))
    return np.flatnonzero(marked)
