"""The carriers in time under a live hand, made ahead in slices: no step waits for a whole block.

The same chain as in carriers.py. A block takes an inverse FFT for each band; they are spread over the steps until it is
needed. No thread: a busy one holds the interpreter for milliseconds at a time. Blocks are kept as float32.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .carriers import MODEL_RATE_HZ, TIME_BLOCK, Carriers
from .noise import WORD, crossfade_window
from .timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]
Single = NDArray[np.float32]

HOP = TIME_BLOCK // 2
KEPT_BLOCKS = 3
"""The two that meet here, and the next."""
KEPT_STARTS = 2
"""Chains whose first blocks are kept, 6 MB each: another material under the same hand begins there too."""
_AT_ONCE = 8
"""Bands whose numbers are worked out together."""


class LiveNoise:
    """The carriers in time of a seed; block j covers samples j · HOP … (j + 2) · HOP. Made ready for a start at 0.

    at_once: blocks that a step had to wait for.
    """

    def __init__(self, carriers: Carriers, seed: int) -> None:
        edges = tuple(edge * (TIME_BLOCK / MODEL_RATE_HZ) for edge in carriers.time_edges_hz)
        self.bands, self.at_once = len(edges) - 1, 0
        self._seed, self._edges, self._owed = seed, edges, 0.0
        self._ready: dict[int, Single] = dict(_about_zero(seed, edges))
        self._making: _Making | None = None

    @property
    def kept(self) -> int:
        """Blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mixed(self, weights: Single, first: int, count: int) -> Single:
        """weights (m, B) @ samples first … first + count − 1 of the bands; (m, count)."""
        out = np.empty((len(weights), count), dtype=np.float32)
        place, last = first, first + count
        while place < last:
            block = place // HOP
            start, stop = place - block * HOP, min(last - block * HOP, HOP)
            part = weights @ self._block(block)[:, start:stop]
            part += weights @ self._block(block - 1)[:, start + HOP : stop + HOP]
            out[:, place - first : place - first + stop - start] = part
            place += stop - start
        return out

    def prepare(self, sample: int) -> None:
        """A step's share of the work ahead, as even as can be, in whole pieces."""
        block = sample // HOP
        missing = next((index for index in (block, block - 1, block + 1) if index not in self._ready), None)
        if missing is None:
            self._owed = 0.0
            return
        making = self._begun(missing)
        steps = (block + 1) * HOP - sample if missing > block else 0
        self._owed += max(
            self.bands / (HOP / SAMPLES_PER_STATE), making.left / max(steps / SAMPLES_PER_STATE - 1.0, 1.0)
        )
        while self._owed >= 1.0 and making.left:
            making.go_on()
            self._owed -= 1.0
        if not making.left:
            self._keep(making)

    def _begun(self, index: int) -> _Making:
        if self._making is None or self._making.index != index:
            self._making = _Making(self._seed, self._edges, index)
        return self._making

    def _keep(self, making: _Making) -> None:
        self._ready[making.index], self._making, self._owed = making.waves, None, 0.0
        while len(self._ready) > KEPT_BLOCKS:
            del self._ready[max(self._ready, key=lambda other: abs(other - making.index))]

    def _block(self, index: int) -> Single:
        if index not in self._ready:
            making = self._begun(index)
            while making.left:
                making.go_on()
            self._keep(making)
            self.at_once += 1
        return self._ready[index]


class _Making:
    """A block on its way: its numbers first, then band after band. left: pieces of about as much work."""

    def __init__(self, seed: int, edges: tuple[float, ...], index: int) -> None:
        self.index, self.left = index, len(edges)
        self.waves = np.empty((len(edges) - 1, TIME_BLOCK), np.float32)
        self._starts = np.clip(np.ceil(edges).astype(int), 1, HOP).tolist()
        self._seed, self._raw = seed, np.zeros(0, dtype=np.uint64)
        self._white = np.zeros(0, dtype=np.complex128)
        self._window = crossfade_window(TIME_BLOCK).astype(np.float32)
        self._spectrum = np.zeros(HOP + 1, dtype=np.complex64)  # numpy 2 then needs half the time

    def go_on(self) -> None:
        bands, starts = len(self.waves), self._starts
        band = bands - self.left
        self.left -= 1
        if band < 0:
            self._raw = raw_words(self._seed, 0, self.index, HOP + 1)
            return
        first, low, high = (starts[at] for at in (band - band % _AT_ONCE, band, band + 1))
        if band == band - band % _AT_ONCE:
            self._white = white_bins(self._raw, first, starts[min(band + _AT_ONCE, bands)])
        factor, spectrum, wave = TIME_BLOCK / math.sqrt(4.0 * (high - low)), self._spectrum, self.waves[band]
        np.multiply(self._white[low - first : high - first], factor, out=spectrum[low:high])
        wave[:] = np.fft.irfft(spectrum, TIME_BLOCK)
        wave *= self._window
        spectrum[low:high] = 0.0


def raw_words(seed: int, stream: int, block: int, bins: int) -> NDArray[np.uint64]:
    """(2, bins) words that noise.normal_block makes its pairs of numbers from."""
    bits = np.random.Philox(key=(seed & WORD) | ((stream & WORD) << 64), counter=(block & WORD) << 64)
    return np.asarray(bits.random_raw(2 * bins).reshape(2, bins))


def white_bins(raw: NDArray[np.uint64], low: int, high: int) -> NDArray[np.complex128]:
    """Bins low … high − 1 of the white spectrum that noise.band_spectra divides: (high − low,)."""
    # normal_block's first half are a pair's cosines, here real parts, and its second half their sines.
    radius, angle = ((raw[:, low:high] >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return np.asarray(np.sqrt(-2.0 * np.log(radius)) * np.exp(2j * np.pi * angle))


@lru_cache(maxsize=KEPT_STARTS)
def _about_zero(seed: int, edges: tuple[float, ...]) -> Mapping[int, Single]:
    """The blocks that meet at sample 0, and the one before."""
    blocks = {}
    for index in (-2, -1, 0):
        making = _Making(seed, edges, index)
        while making.left:
            making.go_on()
        making.waves.setflags(write=False)
        blocks[index] = making.waves
    return blocks
