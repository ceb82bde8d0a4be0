"""What is fast in a signal: unit-power noise bands in time and in arc length.

An artist's action has nothing above 20 Hz, so the published emission, a pointwise function of u(t), cannot vibrate.
The field therefore modulates a fixed basis. Carriers in time do not follow the hand (contact noise); carriers in arc
length c(s(t)) glide with its speed, as the tone of a weave or a grating does: f = κ v.

Every carrier is a chain of half-overlapping noise blocks with power-complementary fades; block j is a pure function of
(seed, family, j), so any stretch is computable alone and nothing repeats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from .noise import crossfade_window, draw_band_spectra

Float = NDArray[np.float64]

MODEL_RATE_HZ = 10_000.0
"""Rate of the model's own time axis; other output rates are resampled from it."""

TIME_BLOCK = 8192
"""Samples in a block of time carriers (0.82 s: 16 bins in a band of 20 Hz)."""
ARC_BLOCK = 8192
"""Spatial samples in a block of one octave of arc carriers."""
ARC_SAMPLES_PER_WAVE = 16
"""Spatial samples per shortest wavelength of an octave; cubic interpolation then errs below −60 dB."""
ARC_PER_OCTAVE = 24
CACHED_TIME_BLOCKS, CACHED_ARC_BLOCKS = 8, 32
"""Noise blocks kept for the next render, 3.7 MB and 1.6 MB each: neighbouring renders meet the same ones again."""
ARC_STREAM = 1_000


def default_time_edges() -> Float:
    """58 edges [Hz]: 20 Hz bands to 1 kHz (the first starts at 2 Hz), then 7 widening bands to 5 kHz."""
    low = np.arange(51) * 20.0
    low[0] = 2.0
    return np.concatenate([low, 1000.0 * 5.0 ** (np.arange(1, 8) / 7.0)])


@dataclass(frozen=True)
class Carriers:
    """Which carriers a field modulates.

    time_edges_hz: (Kt + 1,) band edges, empty for none. arc_octaves: octaves of spatial frequency, each of 24 bands,
    upward from arc_start_per_m [cycles/m]. constant: also c ≡ 1, the published form. Order: constant, time, arc.
    """

    time_edges_hz: tuple[float, ...] = tuple(float(edge) for edge in default_time_edges())
    arc_start_per_m: float = 50.0
    arc_octaves: int = 8
    constant: bool = False

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Once: what is kept of carriers is looked up by them hundreds of times a stroke."""
        return hash((self.time_edges_hz, self.arc_start_per_m, self.arc_octaves, self.constant))

    @property
    def time_count(self) -> int:
        return max(len(self.time_edges_hz) - 1, 0)

    @property
    def arc_count(self) -> int:
        return self.arc_octaves * ARC_PER_OCTAVE

    @property
    def count(self) -> int:
        return int(self.constant) + self.time_count + self.arc_count

    @property
    def time_slice(self) -> slice:
        return slice(int(self.constant), int(self.constant) + self.time_count)

    @property
    def arc_slice(self) -> slice:
        return slice(int(self.constant) + self.time_count, self.count)

    def time_edges(self) -> Float:
        return np.asarray(self.time_edges_hz, dtype=np.float64)

    def arc_edges(self) -> Float:
        """(24 · octaves + 1,) band edges in cycles/m."""
        return np.asarray(self.arc_start_per_m * 2.0 ** (np.arange(self.arc_count + 1) / ARC_PER_OCTAVE))

    def arc_centres(self) -> Float:
        edges = self.arc_edges()
        return np.asarray(np.sqrt(edges[1:] * edges[:-1]))

    def arc_step_m(self, octave: int) -> float:
        """Sample spacing of an octave's blocks."""
        return float(1.0 / (ARC_SAMPLES_PER_WAVE * self.arc_start_per_m * 2.0 ** (octave + 1)))

    def arc_block_spectra(self, seed: int, octave: int, block: int) -> NDArray[np.complex128]:
        """rfft spectra (24, ARC_BLOCK // 2 + 1) of one block of one octave, before its fade."""
        first = octave * ARC_PER_OCTAVE
        edges = self.arc_edges()[first : first + ARC_PER_OCTAVE + 1] * (self.arc_step_m(octave) * ARC_BLOCK)
        return draw_band_spectra(seed, ARC_STREAM + octave, block, edges, ARC_BLOCK)

    def time_block_spectra(self, seed: int, block: int) -> NDArray[np.complex128]:
        """rfft spectra (Kt, TIME_BLOCK // 2 + 1) of one block, before its fade."""
        return draw_band_spectra(seed, 0, block, self.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)

    def time_samples(self, seed: int, start: int, count: int) -> Float:
        """Time carriers (Kt, count) at samples start … start + count − 1 of the model rate."""
        return _overlap_add(lambda block: _time_wave(self, seed, block), TIME_BLOCK, self.time_count, start, count)

    def arc_samples(self, seed: int, octave: int, start: int, count: int) -> Float:
        """One octave's carriers (24, count) at spatial samples start … (multiples of arc_step_m)."""
        return _overlap_add(lambda block: _arc_wave(self, seed, octave, block), ARC_BLOCK, ARC_PER_OCTAVE, start, count)


@lru_cache(maxsize=CACHED_TIME_BLOCKS)
def _time_wave(carriers: Carriers, seed: int, block: int) -> Float:
    return _apply_window(carriers.time_block_spectra(seed, block), TIME_BLOCK)


@lru_cache(maxsize=CACHED_ARC_BLOCKS)
def _arc_wave(carriers: Carriers, seed: int, octave: int, block: int) -> Float:
    return _apply_window(carriers.arc_block_spectra(seed, octave, block), ARC_BLOCK)


def _apply_window(spectra: NDArray[np.complex128], size: int) -> Float:
    """(bands, size) one block's waves under its window."""
    waves = np.fft.irfft(spectra, size, axis=-1) * crossfade_window(size)
    waves.setflags(write=False)
    return np.asarray(waves)


def _overlap_add(waves: Callable[[int], Float], size: int, bands: int, start: int, count: int) -> Float:
    """Sum of the faded blocks that meet [start, start + count)."""
    out = np.zeros((bands, count))
    if count <= 0 or bands == 0:
        return out
    hop = size // 2
    for block in range(start // hop - 1, (start + count - 1) // hop + 1):
        first = block * hop
        low, high = max(start, first), min(start + count, first + size)
        out[:, low - start : high - start] += waves(block)[:, low - first : high - first]
    return out
