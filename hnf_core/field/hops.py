"""The carriers in the form that costs least to use: as few samples as their bands need, kept for the next render.

Carriers in time are kept at the model's rate, its half or its quarter. Those of an octave of arc length are kept as
what is left of them when the middle of the octave is taken out, Re(c(s) e^{2πiκs}): complex, two values per shortest
wave in place of sixteen samples. Hop h is where noise block h fades in over the second half of block h − 1; any hop is
computable alone, and equal to the carriers' own waves (carriers.time_samples, carriers.arc_samples).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .band_waves import complex_waves, real_waves
from .carriers import ARC_BLOCK, ARC_PER_OCTAVE, ARC_STREAM, MODEL_RATE_HZ, TIME_BLOCK, Carriers
from .noise import band_bins, crossfade_window

Float32 = NDArray[np.float32]
Number = TypeVar("Number", np.float32, np.complex64)

HOP = TIME_BLOCK // 2
"""Samples of the model rate in a hop of time carriers."""
HIGHEST = 0.25
"""Of the rate at which it is kept, in a carrier's frequency."""
MARGINS = (0, 6, 10)
"""Samples kept before and after a hop at the model's rate, its half and its quarter: half of the next one's, and the
reach of the filter that doubles the rate. At an eighth, amplitudes that jump between states would lose 6 dB more."""
LEVELS = len(MARGINS)

CELL = 8
"""Spatial samples of an octave in a cell: two cells per shortest wavelength."""
ARC_CELLS = ARC_BLOCK // CELL
ARC_HOP = ARC_CELLS // 2
MIDDLE = 3 * ARC_BLOCK // 64
"""Cycles per block of what is taken out: an octave has 2/64 to 4/64 of ARC_BLOCK. Even, so that blocks agree."""
KEPT_TIME_HOPS, KEPT_ARC_HOPS = 48, 256
"""0.45 MB and 98 kB each: 20 s of time, and half a metre or more of path."""


def level_of(frequency_hz: float) -> int:
    """How often the model's rate may be halved for a carrier of this frequency."""
    level = LEVELS - 1
    while level and frequency_hz > HIGHEST * MODEL_RATE_HZ / 2**level:
        level -= 1
    return level


@lru_cache(maxsize=8)
def time_levels(carriers: Carriers) -> tuple[slice, ...]:
    """The time carriers that are kept at each level, which ascending bands make contiguous."""
    levels = [level_of(float(edge)) for edge in carriers.time_edges()[1:]]
    ends = [sum(each >= level for each in levels) for level in range(LEVELS + 1)]
    return tuple(slice(ends[level + 1], ends[level]) for level in range(LEVELS))


@lru_cache(maxsize=KEPT_TIME_HOPS)
def time_hop(carriers: Carriers, seed: int, hop: int) -> tuple[Float32, ...]:
    """At each level its carriers, (bands, MARGINS[level] + HOP / 2^level + MARGINS[level])."""
    blocks = [_time_block(carriers, seed, hop + shift) for shift in (-2, -1, 0, 1)]
    kept = []
    for level, margin in enumerate(MARGINS):
        one, two, three, four = (block[level] for block in blocks)
        here = _last(two) + _first(three)
        if margin:
            before = _last(one)[:, -margin:] + _first(two)[:, -margin:]
            after = _last(three)[:, :margin] + _first(four)[:, :margin]
            here = np.concatenate([before, here, after], axis=1)
        kept.append(_kept(here))
    return tuple(kept)


@lru_cache(maxsize=KEPT_ARC_HOPS)
def arc_hop(carriers: Carriers, seed: int, octave: int, hop: int) -> NDArray[np.complex64]:
    """(24, ARC_HOP) of one octave, at s = (hop · ARC_HOP + j) · CELL · arc_step_m(octave)."""
    return _kept(_last(_arc_block(carriers, seed, octave, hop - 1)) + _first(_arc_block(carriers, seed, octave, hop)))


@lru_cache(maxsize=4)
def _time_block(carriers: Carriers, seed: int, block: int) -> tuple[Float32, ...]:
    edges = carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ)
    bins, starts = band_bins(seed, 0, block, edges, TIME_BLOCK)
    waves = []
    for level, bands in enumerate(time_levels(carriers)):
        own = starts[bands.start : bands.stop + 1]
        inside = bins[own[0] - starts[0] : own[-1] - starts[0]] if len(own) > 1 else bins[:0]
        waves.append(real_waves(inside, own, TIME_BLOCK >> level, _window(TIME_BLOCK, 1 << level)))
    return tuple(waves)


@lru_cache(maxsize=32)  # of eight octaves the two or three that a hop meets
def _arc_block(carriers: Carriers, seed: int, octave: int, block: int) -> NDArray[np.complex64]:
    first = octave * ARC_PER_OCTAVE
    edges = carriers.arc_edges()[first : first + ARC_PER_OCTAVE + 1] * (carriers.arc_step_m(octave) * ARC_BLOCK)
    bins, starts = band_bins(seed, ARC_STREAM + octave, block, edges, ARC_BLOCK)
    return complex_waves(2.0 * bins, starts, MIDDLE, ARC_CELLS, _window(ARC_BLOCK, CELL))


@lru_cache(maxsize=8)
def _window(size: int, step: int) -> NDArray[np.float64]:
    """Every step-th sample of the fade of a block, over the block's length."""
    return crossfade_window(size)[::step] / size


def _first(waves: NDArray[Number]) -> NDArray[Number]:
    return waves[:, : waves.shape[1] // 2]


def _last(waves: NDArray[Number]) -> NDArray[Number]:
    return waves[:, waves.shape[1] // 2 :]


def _kept(waves: NDArray[Number]) -> NDArray[Number]:
    waves = np.ascontiguousarray(waves)
    waves.setflags(write=False)
    return waves
