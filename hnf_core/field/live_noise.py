"""The carriers' noise, made ahead in slices: no step waits for a whole block.

The same chains as in carriers.py. A block of one octave takes 24 inverse FFTs; they are spread over the steps until the
hand gets there, at its speed of now. No thread: a busy one holds the interpreter for milliseconds at a time. A place
that nobody could foresee (a jump) is made at once. Blocks are kept as float32, six of a chain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .carriers import ARC_BLOCK, ARC_PER_OCTAVE, ARC_STREAM, MODEL_RATE_HZ, TIME_BLOCK, Carriers
from .linear_contact import BAND_END_HZ
from .noise import WORD, crossfade_window
from .timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]
Single = NDArray[np.float32]

KEPT_BLOCKS = 6
"""Of a chain: the two that meet here, the next on either side, and what a hand that turns about a border has left."""
FORESIGHT_STEPS = 100
"""A block is made at least this evenly, also for a hand that rests."""

KEPT_STARTS = 12
"""Chains whose first blocks are kept, 2 to 6 MB each: another material under the same hand begins there too."""

HASTE_STEPS = 8
"""Where the hand is already but nothing sounds yet: a chain that was too fast to be heard."""
_AT_ONCE = 8
"""Bands whose numbers are worked out together."""
AUDIBLE_SOON = 1.5
"""Chains up to this factor above the band are made too: the hand may slow down."""


class Chain:
    """One family of noise bands, block by block; block j covers samples j·hop … j·hop + 2 hop.

    edges: (B + 1,) cycles per block. seed, stream: of its numbers, see raw_words. owed: pieces of work that should be
    done by now. at_once: blocks that nobody had foreseen.
    """

    def __init__(self, seed: int, stream: int, edges: tuple[float, ...], size: int) -> None:
        self.edges = edges
        self.key, self.size, self.hop, self.bands = (seed, stream), size, size // 2, len(edges) - 1
        self.starts = np.clip(np.ceil(edges).astype(int), 1, size // 2).tolist()
        self.window = crossfade_window(size).astype(np.float32)
        self.spectrum = np.zeros(size // 2 + 1, dtype=np.complex64)  # numpy 2 then needs half the time
        self.owed, self.at_once = 0.0, 0
        self._ready: dict[int, Single] = {}
        self._making: _Making | None = None

    @property
    def kept(self) -> int:
        """Blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mixed(self, weights: Single, first: int, count: int) -> Single:
        """weights (m, B) @ samples first … first + count − 1 of the bands; (m, count)."""
        start = first % self.hop
        if start + count <= self.hop:  # nearly always: no border in it
            block, stop = first // self.hop, start + count
            part = weights @ self._block(block)[:, start:stop]
            part += weights @ self._block(block - 1)[:, start + self.hop : stop + self.hop]
            return part
        out = np.zeros((len(weights), count), dtype=np.float32)
        place, last = first, first + count
        while place < last:
            block = place // self.hop
            start, stop = place - block * self.hop, min(last - block * self.hop, self.hop)
            part = weights @ self._block(block)[:, start:stop]
            part += weights @ self._block(block - 1)[:, start + self.hop : stop + self.hop]
            out[:, place - first : place - first + stop - start] = part
            place += stop - start
        return out

    def take(self, blocks: Mapping[int, Single]) -> None:
        """Blocks that are known already, by their index."""
        self._ready.update(blocks)

    def foresee(self, place: float, pace: float, *, turns: bool = True) -> None:
        """Owe a slice of the work ahead. place: sample; pace: samples per step, signed: where the hand goes. turns: it
        may turn back."""
        block = int(place // self.hop)
        to_border = (block + 1) * self.hop - place if pace >= 0.0 else place - block * self.hop
        ahead, behind = (block + 1, block - 2) if pace >= 0.0 else (block - 2, block + 1)
        wanted = (block, block - 1, ahead, behind) if turns else (block, block - 1, ahead)
        missing = next((index for index in wanted if index not in self._ready), None)
        if missing is None:
            self.owed = 0.0
            return
        if self._making is None or self._making.index != missing:
            self._making = _Making(self, missing)
        left = self._making.left
        share = self.bands / (FORESIGHT_STEPS if missing in (ahead, behind) else HASTE_STEPS)
        if missing == ahead:
            share = max(share, left / max(to_border / max(abs(pace), 1e-9) - 1.0, 1.0))
        self.owed = min(self.owed + share, float(left))

    def work(self) -> None:
        """One piece of what is owed."""
        made = self._making
        assert made is not None
        made.go_on()
        self.owed -= 1.0
        if made.left == 0:
            self._ready[made.index], self._making, self.owed = made.waves, None, 0.0
            while len(self._ready) > KEPT_BLOCKS:
                del self._ready[max(self._ready, key=lambda other: abs(other - made.index))]

    def _block(self, index: int) -> Single:
        if index not in self._ready:
            if self._making is None or self._making.index != index:
                self._making = _Making(self, index)
            while index not in self._ready:
                self.work()
            self.at_once += 1
        return self._ready[index]


class _Making:
    """A block on its way: its numbers first, then band after band. left: pieces of about as much work."""

    def __init__(self, chain: Chain, index: int) -> None:
        self.index, self.left = index, chain.bands + 1
        self.waves = np.empty((chain.bands, chain.size), np.float32)
        self._chain, self._raw = chain, np.zeros(0, dtype=np.uint64)
        self._white = np.zeros(0, dtype=np.complex128)

    def go_on(self) -> None:
        chain = self._chain
        band = chain.bands - self.left
        self.left -= 1
        if band < 0:
            self._raw = raw_words(*chain.key, self.index, chain.size // 2 + 1)
            return
        first, low, high = (chain.starts[at] for at in (band - band % _AT_ONCE, band, band + 1))
        if band == band - band % _AT_ONCE:
            self._white = white_bins(self._raw, first, chain.starts[min(band + _AT_ONCE, chain.bands)])
        factor, spectrum, wave = chain.size / math.sqrt(4.0 * (high - low)), chain.spectrum, self.waves[band]
        np.multiply(self._white[low - first : high - first], factor, out=spectrum[low:high])
        wave[:] = np.fft.irfft(spectrum, chain.size)
        wave *= chain.window
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
def _about_zero(seed: int, stream: int, edges: tuple[float, ...], size: int) -> Mapping[int, Single]:
    """The blocks that meet at sample 0, and the one before."""
    chain, blocks = Chain(seed, stream, edges, size), {}
    for index in (-2, -1, 0):
        making = _Making(chain, index)
        while making.left:
            making.go_on()
        making.waves.setflags(write=False)
        blocks[index] = making.waves
    return blocks


class LiveNoise:
    """All carriers of a seed, about where the hand is. Made ready for a start at s = 0."""

    def __init__(self, carriers: Carriers, seed: int) -> None:
        period_s = TIME_BLOCK / MODEL_RATE_HZ
        self.time = Chain(seed, 0, tuple(edge * period_s for edge in carriers.time_edges_hz), TIME_BLOCK)
        self.steps_m = np.array([carriers.arc_step_m(octave) for octave in range(carriers.arc_octaves)])
        edges = carriers.arc_edges()
        self.octaves: list[Chain] = []
        for octave, step in enumerate(self.steps_m):
            first = octave * ARC_PER_OCTAVE
            inside = tuple((edges[first : first + ARC_PER_OCTAVE + 1] * (step * ARC_BLOCK)).tolist())
            self.octaves.append(Chain(seed, ARC_STREAM + octave, inside, ARC_BLOCK))
        self._lowest = edges[:-1:ARC_PER_OCTAVE].tolist()
        self._chains = (self.time, *self.octaves)
        for chain in self._chains:
            chain.take(_about_zero(*chain.key, chain.edges, chain.size))

    @property
    def kept(self) -> int:
        """Blocks in memory, of all chains."""
        return sum(chain.kept for chain in self._chains)

    @property
    def at_once(self) -> int:
        """Blocks that nobody had foreseen."""
        return sum(chain.at_once for chain in self._chains)

    def prepare(self, sample: int, place: float, speed: float) -> None:
        """A step's share of the work ahead, as even as can be: whole pieces, first for the chain that is furthest
        behind. place: s in metres; speed: ds/dt in m/s, signed."""
        self.time.foresee(sample, SAMPLES_PER_STATE, turns=False)
        travel = speed * SAMPLES_PER_STATE / MODEL_RATE_HZ
        for chain, step, lowest in zip(self.octaves, self.steps_m.tolist(), self._lowest, strict=True):
            if lowest * abs(speed) < AUDIBLE_SOON * BAND_END_HZ:
                chain.foresee(place / step, travel / step)
        for _ in range(int(sum(chain.owed for chain in self._chains))):
            max(self._chains, key=lambda chain: chain.owed).work()
