"""The carriers in time under a live hand, made ahead in slices: no step waits for a whole block.

The same chain as in hops.py, at the model's rate: what is kept at a half of it is brought up by samples to come, whose
amplitudes are not known. A block's bands are spread over the steps until it is needed. No thread: a busy one holds the
interpreter for milliseconds at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernel.library import single_blas_thread_without_kernel
from ..band_waves import WavePlan, make_wave_plan, render_real_waves
from ..carriers import MODEL_RATE_HZ, TIME_BLOCK, Carriers
from ..hops import HOP_SIZE, block_window
from ..noise import Bins, draw_band_bins, make_bins
from ..timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]
Single = NDArray[np.float32]

CACHED_BLOCKS = 3
"""The two that meet here, and the next."""
CACHED_STARTS = 2
"""Chains whose first blocks are kept, 6 MB each: another material under the same hand begins there too."""
BANDS_PER_STEP = 3
"""Narrow bands that are made together: together as long as a broad one's transform."""


class LiveTimeCarriers:
    """The carriers in time of a seed; block j covers samples j · HOP … (j + 2) · HOP. Made ready for a start at 0.

    at_once: blocks that a step had to wait for.
    """

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self.bands, self.at_once = carriers.time_count, 0
        self._seed, self._carriers, self._owed = seed, carriers, 0.0
        self._ready: dict[int, Single] = dict(_draw_initial_blocks(seed, carriers))
        self._making: _BlockBuilder | None = None
        self._left: Single | None = None

    @property
    def cached_blocks(self) -> int:
        """Blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mix(self, weights: Single, first: int, count: int) -> Single:
        """weights (m, B) @ samples first … first + count − 1 of the bands; (m, count)."""
        out = np.empty((len(weights), count), dtype=np.float32)
        place, last = first, first + count
        while place < last:
            block = place // HOP_SIZE
            start, stop = place - block * HOP_SIZE, min(last - block * HOP_SIZE, HOP_SIZE)
            part = weights @ self._get_block(block)[:, start:stop]
            part += weights @ self._get_block(block - 1)[:, start + HOP_SIZE : stop + HOP_SIZE]
            out[:, place - first : place - first + stop - start] = part
            place += stop - start
        return out

    def prepare(self, sample: int, spare: bool = True) -> None:
        """A step's share of the work ahead, as even as can be, in whole parts. spare: whether the step has time left;
        else it is put off once."""
        block = sample // HOP_SIZE
        missing = next((index for index in (block, block - 1, block + 1) if index not in self._ready), None)
        if missing is None:
            self._owed = 0.0
            return
        making = self._start(missing)
        steps = (block + 1) * HOP_SIZE - sample if missing > block else 0
        self._owed += max(
            len(_group_bands(self._carriers)) / (HOP_SIZE / SAMPLES_PER_STATE),
            making.left / max(steps / SAMPLES_PER_STATE - 1.0, 1.0),
        )
        while self._owed >= (1.0 if spare else 2.0) and making.left:
            making.advance()
            self._owed -= 1.0
        if not making.left:
            self._store(making)

    def _start(self, index: int) -> _BlockBuilder:
        if self._making is None or self._making.index != index:
            self._making = _BlockBuilder(self._seed, self._carriers, index, self._allocate())
        return self._making

    def _allocate(self) -> Single:
        """Memory for a block: what the last one left, if it was not shared."""
        left, self._left = self._left, None
        return np.empty((self.bands, TIME_BLOCK), np.float32) if left is None or not left.flags.writeable else left

    def _store(self, making: _BlockBuilder) -> None:
        self._ready[making.index], self._making, self._owed = making.waves, None, 0.0
        while len(self._ready) > CACHED_BLOCKS:
            self._left = self._ready.pop(max(self._ready, key=lambda other: abs(other - making.index)))

    def _get_block(self, index: int) -> Single:
        if index not in self._ready:
            making = self._start(index)
            while making.left:
                making.advance()
            self._store(making)
            self.at_once += 1
        return self._ready[index]


class _BlockBuilder:
    """A block on its way. left: parts of about as much work."""

    def __init__(self, seed: int, carriers: Carriers, index: int, waves: Single) -> None:
        self._seed, self._parts, self.index, self.waves = seed, _group_bands(carriers), index, waves
        self.left = len(self._parts)

    def advance(self) -> None:
        part = self._parts[len(self._parts) - self.left]
        drawn = draw_band_bins(self._seed, 0, self.index, part.bins)
        # Without the kernel it is a product of matrices, for which OpenBLAS would wake threads and wait for them.
        with single_blas_thread_without_kernel():
            render_real_waves(drawn, part.plan, self.waves[part.bands])
        self.left -= 1


class _BandGroup(NamedTuple):
    """Bands that are made together."""

    bands: slice
    bins: Bins
    plan: WavePlan


@lru_cache(maxsize=4)
def _group_bands(carriers: Carriers) -> tuple[_BandGroup, ...]:
    """Broad bands, which take a transform each, one by one; narrow ones AT_ONCE."""
    bins = make_bins(carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    plan = make_wave_plan(bins.starts, block_window(TIME_BLOCK, 1))
    narrow, parts, low = set(plan.narrow.tolist()), [], 0
    while low < carriers.time_count:
        high = low + 1
        while high < carriers.time_count and high - low < BANDS_PER_STEP and {low, high} <= narrow:
            high += 1
        parts.append(_BandGroup(slice(low, high), bins.select_bands(low, high), plan.select_bands(low, high)))
        low = high
    return tuple(parts)


@lru_cache(maxsize=CACHED_STARTS)
def _draw_initial_blocks(seed: int, carriers: Carriers) -> Mapping[int, Single]:
    """The blocks that meet at sample 0, and the one before."""
    blocks = {}
    for index in (-2, -1, 0):
        making = _BlockBuilder(seed, carriers, index, np.empty((carriers.time_count, TIME_BLOCK), np.float32))
        while making.left:
            making.advance()
        making.waves.setflags(write=False)
        blocks[index] = making.waves
    return blocks
