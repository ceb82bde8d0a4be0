"""The carriers' noise, made ahead in slices: no step waits for a whole block.

The same chains as in carriers.py. A block of one octave takes 24 inverse FFTs; they are spread over the steps until the
hand gets there, at its speed of now. No thread: a busy one holds the interpreter for milliseconds at a time. A place
that nobody could foresee (a jump) is made at once. Blocks are kept as float32, six of a chain.
"""

from __future__ import annotations

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

HASTE_STEPS = 8
"""Where the hand is already but nothing sounds yet: a chain that was too fast to be heard."""
AUDIBLE_SOON = 1.5
"""Chains up to this factor above the band are made too: the hand may slow down."""


class Chain:
    """One family of noise bands, block by block; block j covers samples j·hop … j·hop + 2 hop.

    edges: (B + 1,) cycles per block. seed, stream: of its numbers, see white_bins.
    """

    def __init__(self, seed: int, stream: int, edges: Float, size: int) -> None:
        self._key, self._size, self.hop, self.bands = (seed, stream), size, size // 2, len(edges) - 1
        self._starts = np.clip(np.ceil(edges).astype(int), 1, size // 2).tolist()
        self._window = crossfade_window(size)
        self._ready: dict[int, Single] = {}
        self._making: tuple[int, Single, NDArray[np.complex128]] | None = None
        self._made, self._owed, self.at_once = 0, 0.0, 0

    @property
    def kept(self) -> int:
        """Blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mixed(self, weights: Single, first: int, count: int) -> Float:
        """weights (m, B) @ samples first … first + count − 1 of the bands; (m, count)."""
        out = np.zeros((len(weights), count))
        place, last = first, first + count
        while place < last:
            block = place // self.hop
            start, stop = place - block * self.hop, min(last - block * self.hop, self.hop)
            part = weights @ self._block(block)[:, start:stop]
            part += weights @ self._block(block - 1)[:, start + self.hop : stop + self.hop]
            out[:, place - first : place - first + stop - start] = part
            place += stop - start
        return out

    def prepare(self, place: float, pace: float, *, turns: bool = True) -> None:
        """A slice of the work ahead. place: sample; pace: samples per step, signed: where the hand goes. turns: it may
        turn back."""
        block = int(place // self.hop)
        to_border = (block + 1) * self.hop - place if pace >= 0.0 else place - block * self.hop
        ahead, behind = (block + 1, block - 2) if pace >= 0.0 else (block - 2, block + 1)
        wanted = (block, block - 1, ahead, behind) if turns else (block, block - 1, ahead)
        missing = next((index for index in wanted if index not in self._ready), None)
        if missing is None:
            return
        if self._making is None or self._making[0] != missing:
            self._begin(missing)
        share = self.bands / (FORESIGHT_STEPS if missing in (ahead, behind) else HASTE_STEPS)
        if missing == ahead:
            share = max(share, (self.bands - self._made) / max(to_border / max(abs(pace), 1e-9) - 1.0, 1.0))
        self._owed += share
        bands, self._owed = int(self._owed), self._owed % 1.0
        self._advance(bands)

    def _block(self, index: int) -> Single:
        if index not in self._ready:
            if self._making is None or self._making[0] != index:
                self._begin(index)
            self._advance(self.bands)
            self.at_once += 1
        return self._ready[index]

    def _begin(self, index: int) -> None:
        white = white_bins(*self._key, index, self._size // 2 + 1, self._starts[0], self._starts[-1])
        self._making = index, np.empty((self.bands, self._size), np.float32), white
        self._made = 0

    def _advance(self, bands: int) -> None:
        assert self._making is not None
        index, waves, white = self._making
        first = self._starts[0]
        for band in range(self._made, min(self._made + bands, self.bands)):
            low, high = self._starts[band : band + 2]
            spectrum = np.zeros(high, dtype=np.complex128)
            spectrum[low:] = white[low - first : high - first] * (self._size / np.sqrt(4.0 * (high - low)))
            np.multiply(np.fft.irfft(spectrum, self._size), self._window, out=waves[band], casting="same_kind")
        self._made += bands
        if self._made >= self.bands:
            self._ready[index], self._making, self._owed = waves, None, 0.0
            while len(self._ready) > KEPT_BLOCKS:
                del self._ready[max(self._ready, key=lambda other: abs(other - index))]


def white_bins(seed: int, stream: int, block: int, bins: int, low: int, high: int) -> NDArray[np.complex128]:
    """Bins low … high − 1 of the white spectrum that noise.band_spectra divides, without the others: (high − low,)."""
    # As noise.normal_block, of which the first half holds real parts and the second imaginary ones, pair by pair.
    bits = np.random.Philox(key=(seed & WORD) | ((stream & WORD) << 64), counter=(block & WORD) << 64)
    raw = bits.random_raw(2 * bins)
    radius, angle = (
        ((raw[first + low : first + high] >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53 for first in (0, bins)
    )
    return np.asarray(np.sqrt(-2.0 * np.log(radius)) * np.exp(2j * np.pi * angle))


class LiveNoise:
    """All carriers of a seed, about where the hand is. Made ready for a start at s = 0."""

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self.time = Chain(seed, 0, carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
        self.steps_m = np.array([carriers.arc_step_m(octave) for octave in range(carriers.arc_octaves)])
        edges = carriers.arc_edges()
        self.octaves: list[Chain] = []
        for octave, step in enumerate(self.steps_m):
            first = octave * ARC_PER_OCTAVE
            inside = edges[first : first + ARC_PER_OCTAVE + 1] * (step * ARC_BLOCK)
            self.octaves.append(Chain(seed, ARC_STREAM + octave, inside, ARC_BLOCK))
        self._lowest = edges[:-1:ARC_PER_OCTAVE].tolist()
        for chain in (self.time, *self.octaves):
            chain.mixed(np.zeros((1, chain.bands), np.float32), -1, 2)
            chain.at_once = 0

    @property
    def kept(self) -> int:
        """Blocks in memory, of all chains."""
        return sum(chain.kept for chain in (self.time, *self.octaves))

    @property
    def at_once(self) -> int:
        """Blocks that nobody had foreseen."""
        return sum(chain.at_once for chain in (self.time, *self.octaves))

    def prepare(self, sample: int, place: float, speed: float) -> None:
        """A step's share of the work ahead. place: s in metres; speed: ds/dt in m/s, signed."""
        self.time.prepare(sample, SAMPLES_PER_STATE, turns=False)
        travel = speed * SAMPLES_PER_STATE / MODEL_RATE_HZ
        for chain, step, lowest in zip(self.octaves, self.steps_m.tolist(), self._lowest, strict=True):
            if lowest * abs(speed) < AUDIBLE_SOON * BAND_END_HZ:
                chain.prepare(place / step, travel / step)
