"""Compiled: hops of the carriers, modulated (their twin in numpy is texture_hops in field/carrier_rendering.py), what a
live hand
reads of them between two states (field/live/carriers.py), and where the hand is between states (field/stroke.py).

Compiled: noise bands as waves (the twins in numpy are in field/carriers.py and field/carriers.py).

Compiled: what pressing harder or less hard makes felt (its twin in numpy is FilterBank.force_term in
field/contact_filter.py).

Compiled: where a course bends (its twin in numpy is in field/adaptive_sampling.py).
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
"""Numbers of an hnf_reading."""
_FIRST_CELL_COLUMN, _LAST_CELL_COLUMN, _ARC_HOP_COLUMN = 4, 5, 6
MIN_HOPS_PER_THREAD = 2
"""Hops that are worth a thread of their own."""
_MAX_CELL = 2.0**52
_EXPECTED_READINGS_PER_HOP = 16
"""Readings of a hop that are expected: one for each octave where a hand does not jump."""


class ArcHop(NamedTuple):
    """waves: (B, cells), contiguous. address: of its numbers, worked out once."""

    waves: NDArray[np.complex64]
    address: int

    @staticmethod
    def from_waves(waves: NDArray[np.complex64]) -> ArcHop:
        return ArcHop(waves, get_address(waves, np.complex64))


class TimeHop(NamedTuple):
    """Carriers in time of one hop. waves: per level (bands, samples), contiguous. addresses: a table of where each
    begins, worked out once."""

    waves: tuple[Float32, ...]
    addresses: bytes

    @staticmethod
    def from_waves(waves: tuple[Float32, ...]) -> TimeHop:
        return TimeHop(waves, pack_pointers([get_address(each, np.float32) for each in waves]))


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
    """What no stroke changes, as hnf_carriers in hnf_kernel.h; its arrays stay where they are.

    margin, time_band, time_bands: (levels,); cells_per_m: (octaves,); half_band: (2 taps,); cubic: (4, 4); scalars by
    their names. Raises ValueError where they do not fit together.
    """

    def __init__(
        self, *, margin: Integers, time_band: Integers, time_bands: Integers, cells_per_m: Float, half_band: Float32,
        cubic: Float32, **numbers: float,
    ) -> None:  # fmt: skip
        arrays = (margin, time_band, time_bands, cells_per_m, half_band, cubic)
        wanted: Sequence[Any] = (np.int64, np.int64, np.int64, np.float64, np.float32, np.float32)
        self._arrays = [np.ascontiguousarray(each, dtype=kind) for each, kind in zip(arrays, wanted, strict=True)]
        self.levels, self.octaves, self.cells_per_m = len(margin), len(cells_per_m), cells_per_m.tolist()
        given = {"levels": self.levels, "octaves": self.octaves, "taps": len(half_band) // 2, **numbers}
        self.hop, self.reach = int(numbers["hop"]), int(numbers["reach"])
        self.bands, self.piece_cells = int(numbers["bands"]), int(numbers["piece_cells"])
        self.time_bands = time_bands.tolist()
        self.samples_per_level = [(self.hop >> level) + 2 * int(each) for level, each in enumerate(margin)]
        fits = 0 < self.levels <= _MAX_LEVELS and len(time_band) == len(time_bands) == self.levels
        # The filter that doubles a rate looks this far beyond what the next one keeps; the hop halves evenly.
        fits &= self.hop % (1 << self.levels) == 0 and cubic.shape == (4, 4) and len(half_band) % 2 == 0
        fits &= all(
            low >= high // 2 + len(half_band) // 2 and high % 2 == 0
            for high, low in zip(margin[:-1].tolist(), margin[1:].tolist(), strict=True)
        )
        fits &= all(int(each) << level <= self.reach for level, each in enumerate(margin))
        if not fits:
            raise ValueError(f"a hop of {self.hop} samples at {self.levels} rates with margins {margin.tolist()}")
        self.time_shapes = list(zip(self.time_bands, self.samples_per_level, strict=True))
        self.columns = max(
            int(numbers["arc_first"]) + self.octaves * self.bands,
            int(numbers["time_first"]) + int((time_band + time_bands).max(initial=0)),
        )
        self.struct = _CarrierStruct(
            *(int(given[name]) for name in _CARRIER_COUNTS), *(given[name] for name in _CARRIER_NUMBERS),
            *(each.__array_interface__["data"][0] for each in self._arrays),
        )  # fmt: skip


def render_hops(
    kernel: ctypes.CDLL, tables: CarrierTables, at: Integers, amplitude: Float32, first: int, position: Float,
    waves: Sequence[TimeHop | None], get_arc_hop: Callable[[int, int], ArcHop],
) -> Float:  # fmt: skip
    """(n · hop,) Σ_k A_k c_k from sample `first` on, in n hops, each as it is alone.

    at: (m,) ascending; amplitude: (m, K) there. place: (reach + n · hop + reach,) s [m]. waves: the carriers in time of
    each hop; None where they are silent. piece: (octave, number) → its cells. Raises ValueError where these do not fit,
    or a place is not finite.
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
    table = _collect_arc_hops(tables, readings, get_arc_hop)
    in_time = b"".join(_pack_time_hop(tables, each) for each in waves)
    pieces = pack_pointers([each.address for each in table])
    cells = int((readings[:, _LAST_CELL_COLUMN] - readings[:, _FIRST_CELL_COLUMN]).max(initial=0)) + 1
    begun, out = np.concatenate([[0], np.cumsum(counts)]), np.empty((count, tables.hop))
    waves_each = len(in_time) // max(count, 1)

    def part(low: int, high: int) -> None:
        scratch = np.empty(3 * sum(tables.samples_per_level) + 2 * cells)
        kernel.hnf_hops(
            *shared, first + low * tables.hop, high - low, get_address(position[low * tables.hop :], np.float64),
            in_time[low * waves_each :], pieces, get_address(readings[begun[low] :], np.int64),
            get_address(counts[low:], np.int64), get_address(scratch, np.float64), get_address(out[low:], np.float64),
        )  # fmt: skip

    parallel_for(part, count, MIN_HOPS_PER_THREAD)
    return out.reshape(-1)


class ArcReader:
    """Σ_k A_k c_k(s) of octaves at `count` places between two knots, read again and again: what it is worked out in is
    set up once. share: (count,) of the way from one knot to the other.
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
        """(count,) at place (count,) [m], of the amplitudes (2, octaves · bands) that were put into self.amplitude. The
        next call overwrites it. piece: as of hop(). Raises ValueError where these do not fit, or a place is not
        finite."""
        tables, cells = self._tables, self._tables.piece_cells
        least, most = _find_extent(tables, position)
        if len(position) != self._count or not all(0 <= octave < tables.octaves for octave in octaves):
            raise ValueError(f"octaves {list(octaves)} at {len(position)} places")
        readings, pieces, longest = list[int](), list[int](), 0
        for octave in octaves:
            per_m = tables.cells_per_m[octave]
            first, last = math.floor(least * per_m) - 1, math.floor(most * per_m) + 2
            begin = first // cells
            readings += (octave, 0, 0, self._count, first, last, len(pieces), begin * cells)
            for number in range(begin, last // cells + 1):
                pieces.append(_check_arc_hop(tables, get_arc_hop(octave, number)).address)
            longest = max(longest, last - first + 1)
        if len(self._scratch) < 2 * longest:
            self._scratch = np.empty(2 * longest)
        kernel.hnf_read_arcs(
            *self._before, pack_pointers(pieces), struct.pack(f"{len(readings)}q", *readings), len(octaves),
            get_address(position, np.float64), *self._between, get_address(self._scratch, np.float64),
            get_address(self._out, np.float32),
        )  # fmt: skip
        return self._out


def _find_extent(tables: CarrierTables, position: Float) -> tuple[float, float]:
    """Raises ValueError where a place is not finite, or so far that cells there are no whole numbers."""
    least, most = float(position.min()), float(position.max())
    if not max(-least, most) * max(tables.cells_per_m, default=1.0) < _MAX_CELL:
        raise ValueError(f"places from {least} to {most} m")
    return least, most


def _plan_readings(
    kernel: ctypes.CDLL, shared: tuple[Any, Any], first: int, count: int, position: Float
) -> tuple[Integers, Integers]:
    """Readings of all hops, and how many each has."""
    room, counts = _EXPECTED_READINGS_PER_HOP * count, np.empty(count, dtype=np.int64)
    while True:
        readings = np.empty((room, _READING_SIZE), dtype=np.int64)
        found = int(
            kernel.hnf_plan_hops(
                *shared, first, count, get_address(position, np.float64), room, get_address(readings, np.int64),
                get_address(counts, np.int64),
            )
        )  # fmt: skip
        if found <= room:
            return readings[:found], counts
        room = found


def _collect_arc_hops(
    tables: CarrierTables, readings: Integers, get_arc_hop: Callable[[int, int], ArcHop]
) -> list[ArcHop]:
    """The pieces of all readings, which are told where theirs begin."""
    table: list[ArcHop] = []
    begun: list[int] = []
    met: dict[tuple[int, int], ArcHop] = {}
    cells = tables.piece_cells
    for octave, first, last in readings[:, [0, _FIRST_CELL_COLUMN, _LAST_CELL_COLUMN]].tolist():
        begun.append(len(table))
        for number in range(first // cells, last // cells + 1):
            found = met.get((octave, number))
            if found is None:
                found = met[octave, number] = _check_arc_hop(tables, get_arc_hop(octave, number))
            table.append(found)
    readings[:, _ARC_HOP_COLUMN], readings[:, _ARC_HOP_COLUMN + 1] = (
        begun,
        readings[:, _FIRST_CELL_COLUMN] // cells * cells,
    )
    return table


def _check_arc_hop(tables: CarrierTables, arc_hop: ArcHop) -> ArcHop:
    if arc_hop.waves.shape != (tables.bands, tables.piece_cells):
        wanted = f"{tables.bands} bands of {tables.piece_cells} cells"
        raise ValueError(f"a piece of {arc_hop.waves.shape} where {wanted} are read")
    return arc_hop


def _pack_time_hop(tables: CarrierTables, waves: TimeHop | None) -> bytes:
    if waves is None:
        return bytes(tables.levels * struct.calcsize("P"))
    shapes = [each.shape for each in waves.waves]
    if shapes != tables.time_shapes:
        raise ValueError(f"carriers in time of {shapes}")
    return waves.addresses


def _get_knot_layout(amplitude: Float32) -> tuple[int, int, int]:
    begin, stride = get_row_layout(amplitude)
    return begin, len(amplitude), stride


def interpolate_position(kernel: ctypes.CDLL, position: Float, samples_per_state: int, start: int, count: int) -> Float:
    """s(t) [m] (count,) from sample start on, of position (n,) at states. Raises ValueError for fewer than two."""
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
"""Samples that are made at once, half of them mirrored: what is made is a multiple."""


def draw_bins(kernel: ctypes.CDLL, key: tuple[int, int, int], pairs: int, first: int, level: Float) -> Complex:
    """(n,) level · sqrt(−2 log u) · e^{2πiv} (Box & Muller 1958): bins from `first` on, of so many pairs of words.

    key: seed, stream and block, as words. Raises ValueError where there are no such words.
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
    """Rows `which` of out (B, size): 2 Re Σ_k X_k e^{2πikn/size}, times window (size,).

    bins, starts: as in band_waves.WavePlan. slow: (2W, size / 2 + 1) cosines of 0 … W − 1 turns, then sines; W at least
    the widest band. turns: cosine and sine (bands, size / 2 + 1) of each band's first bin. Raises ValueError where
    these do not fit together, TypeError where out is read-only.
    """
    size = out.shape[1]
    _check_waves(out, slow, turns, window, which, bins, starts)
    kernel.hnf_real_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), get_address(which, np.int64), len(which),
        len(slow) // 2,
        size, get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns), get_address(window,
        np.float32),
        get_address(out, np.float32, writable=True),
    )  # fmt: skip


def render_complex_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, slow: Float32, turns: tuple[Float32, Float32], window: Float32,
    out: NDArray[np.complex64],
) -> None:  # fmt: skip
    """out (B, size): Σ_k X_k e^{2πi(k − middle)n/size}, complex; the turns are those of each first bin less the
    middle. Raises as real_waves()."""
    bands, size = out.shape
    _check_waves(out, slow, turns, window, np.arange(bands), bins, starts)
    kernel.hnf_complex_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), bands, len(slow) // 2, size,
        get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns), get_address(window,
        np.float32),
        get_address(out, np.complex64, writable=True),
    )  # fmt: skip


def _check_waves(
    out: NDArray[Any], slow: Float32, turns: tuple[Float32, Float32], window: Float32, which: Starts, bins: Complex,
    starts: Starts,
) -> None:  # fmt: skip
    rows, size = out.shape
    half = size // 2 + 1
    tables = (
        size % TILE_SAMPLES == 0 and slow.shape[1] == half and all(turn.shape == (len(which), half) for turn in turns)
    )
    widths = np.diff(starts)
    fits = rows == len(widths) and len(bins) == starts[-1] - starts[0] and bool((widths >= 0).all())
    fits = fits and (not len(which) or bool(0 <= which.min() <= which.max() < rows))
    if not tables or len(window) != size or not fits or widths[which].max(initial=0) > len(slow) // 2:
        raise ValueError(f"{len(bins)} bins as waves of {rows} × {size} samples, from tables of {slow.shape[1]}")


MAX_SAMPLES_PER_STATE = 64


class StateResponses:
    """Response of a state's samples to 1 N at each neighbouring state, of each of B contacts.

    tables: (rows, samples) each, the earliest state first; the last `ahead` rows are of states after the own one.
    Raises ValueError where these do not fit together.
    """

    def __init__(self, tables: Sequence[Float], ahead: int) -> None:
        widths = {each.shape[1] for each in tables}
        if (
            len(widths) != 1
            or max(widths) > MAX_SAMPLES_PER_STATE
            or not all(len(each) > ahead >= 0 for each in tables)
        ):
            raise ValueError(f"what is given to states: {[each.shape for each in tables]}, {ahead} rows ahead")
        self.tables, self.ahead, self.samples = tuple(tables), ahead, widths.pop()
        self._row_counts = np.array([len(each) for each in tables], dtype=np.int64)
        self._table_pointers = pack_pointers([get_address(each, np.float64) for each in tables])

    def compute_force_response(self, kernel: ctypes.CDLL, force: Float, weight: Float, first: int, count: int) -> Float:
        """(count · samples,) from state `first` on; force (n,) is held beyond its ends, as weight (n, B) is. Raises
        ValueError where these do not fit."""
        if weight.shape != (len(force), len(self.tables)) or not len(force):
            raise ValueError(f"{weight.shape} weights of {len(self.tables)} contacts at {len(force)} states")
        out = np.empty(count * self.samples)
        kernel.hnf_press(
            get_address(force, np.float64), len(force), get_address(weight, np.float64), len(self.tables),
            self._table_pointers,
            get_address(self._row_counts, np.int64), self.ahead, self.samples, first, count, get_address(out,
            np.float64),
        )  # fmt: skip
        return out


def find_bends(
    kernel: ctypes.CDLL, course: NDArray[np.float64], required: NDArray[np.int64], tolerance: float
) -> NDArray[np.int64]:
    """The rows of a course (n, channels), ascending, between which no channel is off a straight line by more than bent;
    kept are among them. Raises ValueError where the first and the last are not."""
    if not len(required) or required[0] != 0 or required[-1] != len(course) - 1:
        raise ValueError(f"a course of {len(course)} states from {required[:1]} to {required[-1:]}")
    marked = np.zeros(len(course), dtype=np.uint8)
    marked[required] = 1
    kernel.hnf_bends(get_address(course, np.float64), *course.shape, tolerance, get_address(marked, np.uint8))
    return np.flatnonzero(marked)
