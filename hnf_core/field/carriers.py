"""Carriers: unit-power noise bands in time and in arc length, which the field F_Θ modulates.

An artist's action has nothing above 20 Hz, so the published emission, a pointwise function of u(t), cannot vibrate; the
field therefore modulates a fixed basis. Carriers in time do not follow the hand (contact noise); carriers in arc length
c(s(t)) shift with the hand's speed v, as the tone of a weave or a grating does: f = κ v. Every carrier is a chain of
half-overlapping noise blocks with power-complementary fades. Block j is a pure function of (seed, family, j) by
counter-based random numbers (Philox), so any range of samples is computable alone and nothing repeats. A band occupies
few bins of a long period, so its wave is computed as a matrix product instead of an FFT that is mostly zeros: an
envelope of W slow turns, the same for every band, times a turn at the band's first bin. Turns at n and at −n have the
same cosine and opposite sines, so half of the samples give the rest. Broad bands use the inverse FFT.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernel import compiled_carriers
from ..kernel.compiled_carriers import TILE_SAMPLES
from ..kernel.loader import load_kernel

WORD_MASK = 0xFFFF_FFFF_FFFF_FFFF
_WORDS_PER_COUNT = 4


def _draw_words(seed: int, stream: int, block: int, first: int, last: int) -> NDArray[np.uint64]:
    """Draw the random words first … last − 1 of block `block` (any integer, also negative) of a stream.

    Philox4x64-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"), keyed by (seed, stream) with a
    counter set by the block. Raw 64-bit words, because numpy promises those across versions but not its normal sampler,
    and the same seed must give the same bytes.
    """
    skipped = first // _WORDS_PER_COUNT
    bits = np.random.Philox(
        key=(seed & WORD_MASK) | ((stream & WORD_MASK) << 64), counter=((block & WORD_MASK) << 64) + skipped
    )
    return np.asarray(bits.random_raw(last - _WORDS_PER_COUNT * skipped)[first - _WORDS_PER_COUNT * skipped :])


def _to_uniform(words: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Convert words to numbers between 0 and 1, both exclusive."""
    return np.asarray(((words >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)


def _draw_polar(
    seed: int, stream: int, block: int, pairs: int, rows: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw the radius and angle of complex normal numbers (Box & Muller 1958).

    rows: which of the `pairs` (radius, angle) of noise block `block` are returned.
    """
    radius = _to_uniform(_draw_words(seed, stream, block, rows.start, rows.stop))
    angle = _to_uniform(_draw_words(seed, stream, block, pairs + rows.start, pairs + rows.stop))
    return np.sqrt(-2.0 * np.log(radius)), 2.0 * np.pi * angle


@dataclass(frozen=True, eq=False)
class Bins:
    """FFT bins of B adjacent noise bands of W bins each, in a period of `size` samples.

    starts: (B + 1,) first bin of each band, and the end of the last. level: (Σ W,) scale of each bin's random number,
    which gives every band unit expected power.
    """

    starts: NDArray[np.intp]
    level: NDArray[np.float64]
    size: int

    def select_bands(self, low: int, high: int) -> Bins:
        """Return the bins of bands low … high − 1; noise drawn for them alone is the same as when drawn with all."""
        first, last = self.starts[[low, high]] - self.starts[0]
        return Bins(self.starts[low : high + 1], self.level[first:last], self.size)


def make_bins(edges: NDArray[np.float64], size: int) -> Bins:
    """Assign bins to bands with edges (B + 1,) [cycles per period], ascending.

    size: samples of the period. Raises ValueError if a band is so narrow that it contains no bin.
    """
    starts = find_first_bins(edges, size)
    widths = np.diff(starts)
    # Each of n bins is complex normal of variance 2, and mirrored, so the period's mean power is 4 n / size².
    return Bins(starts, np.repeat(size / np.sqrt(4.0 * widths), widths), size)


def draw_band_spectra(
    seed: int, stream: int, block: int, edges: NDArray[np.float64], size: int
) -> NDArray[np.complex128]:
    """Draw rfft spectra (B, size // 2 + 1) of B noise bands, each of unit expected power over a period.

    Disjoint bands take their numbers from one white spectrum, so they are independent. edges: (B + 1,) ascending
    [cycles per period]. size: samples of the period. Raises ValueError if a band contains no bin.
    """
    bins = make_bins(edges, size)
    drawn, starts = draw_band_bins(seed, stream, block, bins), bins.starts
    spectra = np.zeros((len(edges) - 1, size // 2 + 1), dtype=np.complex128)
    for band, (low, high) in enumerate(pairwise(starts.tolist())):
        spectra[band, low:high] = drawn[low - starts[0] : high - starts[0]]
    return spectra


def draw_band_bins(seed: int, stream: int, block: int, bins: Bins) -> NDArray[np.complex128]:
    """Draw the complex FFT bins (Σ W,) of noise bands, band after band, without the zeros between them."""
    first, last, pairs = int(bins.starts[0]), int(bins.starts[-1]), bins.size // 2 + 1
    kernel = load_kernel()
    if kernel is not None:
        return compiled_carriers.draw_bins(
            kernel, (seed & WORD_MASK, stream & WORD_MASK, block & WORD_MASK), pairs, first, bins.level
        )
    radius, angle = _draw_polar(seed, stream, block, pairs, slice(first, last))
    out = np.empty(len(radius), dtype=np.complex128)
    out.real, out.imag = radius * bins.level * np.cos(angle), radius * bins.level * np.sin(angle)
    return out


def find_first_bins(edges: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """Return the first FFT bin of each band, and the end of the last, (B + 1,).

    edges: (B + 1,) [cycles per period of `size` samples]. Raises ValueError if a band contains no bin.
    """
    starts = np.clip(np.ceil(edges).astype(np.intp), 1, size // 2)
    empty = np.diff(starts) <= 0
    if empty.any():
        raise ValueError(f"band {int(np.argmax(empty))} holds no bin of a period of {size} samples")
    return starts


def crossfade_window(size: int) -> NDArray[np.float64]:
    """Return the Vorbis window (size,): overlapping by half, its squares sum to 1: w²(t) + w²(t + size/2) = 1."""
    t = (np.arange(size) + 0.5) / size
    return np.asarray(np.sin(0.5 * np.pi * np.square(np.sin(np.pi * t))))


Float = NDArray[np.float64]

MODEL_RATE_HZ = 10_000.0
"""Sample rate of the model [Hz]; other output rates are resampled from it."""

TIME_BLOCK = 8192
"""Samples in a block of time carriers (0.82 s: 16 bins in a band of 20 Hz)."""
ARC_BLOCK = 8192
"""Spatial samples in a block of one octave of arc carriers."""
ARC_SAMPLES_PER_WAVE = 16
"""Spatial samples per shortest wavelength of an octave; cubic interpolation then errs below −60 dB."""
ARC_PER_OCTAVE = 24
"""Arc carriers per octave of spatial frequency."""
CACHED_TIME_BLOCKS, CACHED_ARC_BLOCKS = 8, 32
"""Noise blocks in the caches, 3.7 MB and 1.6 MB each; adjacent renders need the same ones."""
ARC_STREAM = 1_000
"""Random stream of the first octave of arc carriers; stream 0 is that of the time carriers."""


def default_time_edges() -> Float:
    """Return the 58 band edges of the default time carriers [Hz].

    20 Hz bands to 1 kHz (the first starts at 2 Hz), then 7 widening bands to 5 kHz.
    """
    low = np.arange(51) * 20.0
    low[0] = 2.0
    return np.concatenate([low, 1000.0 * 5.0 ** (np.arange(1, 8) / 7.0)])


@dataclass(frozen=True)
class Carriers:
    """Noise bands that a field modulates: a constant, bands in time, then bands in arc length along the path.

    Attributes
    ----------
    time_edges_hz
        (Kt + 1,) band edges [Hz], empty for none.
    arc_start_per_m
        Lowest spatial frequency of the arc carriers [cycles/m].
    arc_octaves
        Octaves of spatial frequency, each of 24 bands.
    constant
        Include the carrier c ≡ 1, which alone is the published form.
    """

    time_edges_hz: tuple[float, ...] = tuple(float(edge) for edge in default_time_edges())
    arc_start_per_m: float = 50.0
    arc_octaves: int = 8
    constant: bool = False

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Hash, computed once: caches look carriers up hundreds of times a stroke."""
        return hash((self.time_edges_hz, self.arc_start_per_m, self.arc_octaves, self.constant))

    @property
    def time_count(self) -> int:
        """Number of time carriers Kt."""
        return max(len(self.time_edges_hz) - 1, 0)

    @property
    def arc_count(self) -> int:
        """Number of arc carriers Ka."""
        return self.arc_octaves * ARC_PER_OCTAVE

    @cached_property
    def count(self) -> int:
        """Number of all carriers K."""
        return int(self.constant) + self.time_count + self.arc_count

    @cached_property
    def time_slice(self) -> slice:
        """Columns of the time carriers in an amplitude array (…, K)."""
        return slice(int(self.constant), int(self.constant) + self.time_count)

    @cached_property
    def arc_slice(self) -> slice:
        """Columns of the arc carriers in an amplitude array (…, K)."""
        return slice(int(self.constant) + self.time_count, self.count)

    def time_edges(self) -> Float:
        """Return the band edges (Kt + 1,) of the time carriers [Hz]."""
        return np.asarray(self.time_edges_hz, dtype=np.float64)

    def arc_edges(self) -> Float:
        """Return the band edges (24 · octaves + 1,) of the arc carriers [cycles/m]."""
        return np.asarray(self.arc_start_per_m * 2.0 ** (np.arange(self.arc_count + 1) / ARC_PER_OCTAVE))

    def arc_centres(self) -> Float:
        """Return the geometric band centres (Ka,) of the arc carriers [cycles/m]."""
        edges = self.arc_edges()
        return np.asarray(np.sqrt(edges[1:] * edges[:-1]))

    def arc_step_m(self, octave: int) -> float:
        """Return the spacing along the path of an octave's noise samples [m]."""
        return float(1.0 / (ARC_SAMPLES_PER_WAVE * self.arc_start_per_m * 2.0 ** (octave + 1)))

    def arc_block_spectra(self, seed: int, octave: int, block: int) -> NDArray[np.complex128]:
        """Draw the rfft spectra (24, ARC_BLOCK // 2 + 1) of one noise block of one octave, before it is windowed."""
        first = octave * ARC_PER_OCTAVE
        edges = self.arc_edges()[first : first + ARC_PER_OCTAVE + 1] * (self.arc_step_m(octave) * ARC_BLOCK)
        return draw_band_spectra(seed, ARC_STREAM + octave, block, edges, ARC_BLOCK)

    def time_block_spectra(self, seed: int, block: int) -> NDArray[np.complex128]:
        """Draw the rfft spectra (Kt, TIME_BLOCK // 2 + 1) of one noise block in time, before it is windowed."""
        return draw_band_spectra(seed, 0, block, self.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)

    def time_samples(self, seed: int, start: int, count: int) -> Float:
        """Compute the time carriers (Kt, count) at samples start … start + count − 1 of the model rate."""
        return _overlap_add(lambda block: _time_wave(self, seed, block), TIME_BLOCK, self.time_count, start, count)

    def arc_samples(self, seed: int, octave: int, start: int, count: int) -> Float:
        """Compute one octave's carriers (24, count) at spatial samples start, start + 1, … of spacing arc_step_m."""
        return _overlap_add(lambda block: _arc_wave(self, seed, octave, block), ARC_BLOCK, ARC_PER_OCTAVE, start, count)


@lru_cache(maxsize=CACHED_TIME_BLOCKS)
def _time_wave(carriers: Carriers, seed: int, block: int) -> Float:
    """Return one windowed block (Kt, TIME_BLOCK) of the time carriers: noise bands fixed in time, not in arc length."""
    return _apply_window(carriers.time_block_spectra(seed, block), TIME_BLOCK)


@lru_cache(maxsize=CACHED_ARC_BLOCKS)
def _arc_wave(carriers: Carriers, seed: int, octave: int, block: int) -> Float:
    """Return the windowed waves (24, ARC_BLOCK) of one noise block of one octave of arc carriers."""
    return _apply_window(carriers.arc_block_spectra(seed, octave, block), ARC_BLOCK)


def _apply_window(spectra: NDArray[np.complex128], size: int) -> Float:
    """Return the waves (bands, size) of rfft spectra, times the cross-fade window."""
    waves = np.fft.irfft(spectra, size, axis=-1) * crossfade_window(size)
    waves.setflags(write=False)
    return np.asarray(waves)


def _overlap_add(waves: Callable[[int], Float], size: int, bands: int, start: int, count: int) -> Float:
    """Sum the half-overlapping windowed blocks in samples start … start + count − 1; (bands, count).

    waves: function (block number) → its windowed waves (bands, size).
    """
    out = np.zeros((bands, count))
    if count <= 0 or bands == 0:
        return out
    hop = size // 2
    for block in range(start // hop - 1, (start + count - 1) // hop + 1):
        first = block * hop
        low, high = max(start, first), min(start + count, first + size)
        out[:, low - start : high - start] += waves(block)[:, low - first : high - first]
    return out


Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Starts = NDArray[np.intp]

MAX_PRODUCT_BINS = 32
"""Widest band [bins] for which a matrix product is faster than an FFT."""


@dataclass(frozen=True, eq=False)
class WavePlan:
    """Precomputed tables that turn FFT bins of B noise bands into waves of `size` samples, the same for every block.

    Attributes
    ----------
    starts
        (B + 1,) first bin of each band, and the end of the last.
    window
        (size,) cross-fade window.
    narrow, broad
        Indices of the bands computed by a matrix product, and of those computed by an FFT.
    slow
        (2W, size / 2 + 1) cosines of 0 … W − 1 turns per period, then their sines; W is the width of the widest narrow
        band.
    turns
        Cosine and sine (narrow, size / 2 + 1) at the first bin of each narrow band.
    """

    starts: Starts
    window: Float32
    narrow: Starts
    broad: Starts
    slow: Float32
    turns: tuple[Float32, Float32]

    @property
    def size(self) -> int:
        """Samples of a block."""
        return len(self.window)

    def select_bands(self, low: int, high: int) -> WavePlan:
        """Return the tables of bands low … high − 1."""
        narrow = slice(*np.searchsorted(self.narrow, (low, high)))
        broad = self.broad[slice(*np.searchsorted(self.broad, (low, high)))] - low
        cosine, sine = self.turns
        return WavePlan(
            self.starts[low : high + 1], self.window, self.narrow[narrow] - low, broad, self.slow,
            (cosine[narrow], sine[narrow]),
        )  # fmt: skip


def make_wave_plan(starts: Starts, window: Float, middle: int = 0) -> WavePlan:
    """Build the tables that turn FFT bins into waves, of bands shifted down in frequency by `middle` turns per period.

    starts: (B + 1,) first bin of each band, and the end of the last. window: (size,).
    """
    width, size = np.diff(starts), len(window)
    narrow, broad = np.flatnonzero(width <= MAX_PRODUCT_BINS), np.flatnonzero(width > MAX_PRODUCT_BINS)
    slow = _sinusoids(np.arange(int(width[narrow].max(initial=0))), size)
    return WavePlan(
        np.ascontiguousarray(starts, dtype=np.int64), window.astype(np.float32), narrow, broad, np.concatenate(slow),
        _sinusoids(starts[narrow] - middle, size),
    )  # fmt: skip


def render_real_waves(bins: Complex, plan: WavePlan, out: Float32 | None = None) -> Float32:
    """Compute the waves (B, size) of B noise bands, 2 Re Σ_k X_k e^{2πikn/size} times the window.

    Parameters
    ----------
    bins
        (Σ W,) FFT bins X of the bands, one after another; every bin lies between 0 and size / 2.
    plan
        Tables of the bands.
    out
        Array for the result; None to allocate it.
    """
    out = np.empty((len(plan.starts) - 1, plan.size), dtype=np.float32) if out is None else out
    kernel = load_kernel()
    if len(plan.narrow) and kernel is not None and plan.size % TILE_SAMPLES == 0:
        tables = plan.starts, plan.narrow, plan.slow, plan.turns, plan.window
        compiled_carriers.render_real_waves(kernel, bins, *tables, out)
    elif len(plan.narrow):
        cosine, sine = plan.turns
        forward, backward = _envelopes(2.0 * _padded(bins, plan), plan.slow)
        out[plan.narrow] = plan.window * _mirror(
            forward.real * cosine - forward.imag * sine, backward.real * cosine + backward.imag * sine
        )
    if len(plan.broad):
        # The spectra have the output's length though irfft reads half, because numpy 1 would copy them to that length.
        spectra = np.zeros((len(plan.broad), plan.size), dtype=np.complex128)
        for spectrum, band in zip(spectra, plan.broad, strict=True):
            low, high = plan.starts[band], plan.starts[band + 1]
            spectrum[low:high] = bins[low - plan.starts[0] : high - plan.starts[0]]
        waves = np.fft.irfft(spectra, plan.size)
        waves *= plan.size * plan.window.astype(np.float64)
        out[plan.broad] = waves
    return out


def render_complex_waves(
    bins: Complex, plan: WavePlan, out: NDArray[np.complex64] | None = None
) -> NDArray[np.complex64]:
    """Compute the complex waves (B, size) of B narrow bands, Σ_k X_k e^{2πi(k − middle)n/size} times the window.

    bins: (Σ W,) FFT bins X of the bands, one after another; at most MAX_PRODUCT_BINS a band. middle: frequency shift
    that `plan` was made for. out: array for the result, None to allocate it.
    """
    out = np.empty((len(plan.starts) - 1, plan.size), dtype=np.complex64) if out is None else out
    kernel = load_kernel()
    if kernel is not None and plan.size % TILE_SAMPLES == 0:
        compiled_carriers.render_complex_waves(kernel, bins, plan.starts, plan.slow, plan.turns, plan.window, out)
        return out
    turn = plan.turns[0] + 1j * plan.turns[1]
    forward, backward = _envelopes(_padded(bins, plan), plan.slow)
    return np.multiply(plan.window, _mirror(forward * turn, backward * turn.conj()), out=out, casting="same_kind")


def _padded(bins: Complex, plan: WavePlan) -> Complex:
    """Return the FFT bins of the narrow bands as rows (narrow, W), padded with zeros to the widest band."""
    width = np.diff(plan.starts)[plan.narrow, None]
    at = (plan.starts[:-1] - plan.starts[0])[plan.narrow, None] + np.arange(len(plan.slow) // 2)
    inside = np.arange(len(plan.slow) // 2) < width
    return np.where(inside, bins[np.minimum(at, len(bins) - 1)], 0.0)


def _envelopes(bins: Complex, slow: Float32) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
    """Compute Σ_w bins (B, W) e^{±2πiwn/size} at n = 0 … size / 2, for either sign."""
    cosine, sine = slow[: len(slow) // 2], slow[len(slow) // 2 :]
    both = np.concatenate([bins.real, bins.imag]).astype(np.float32)
    even, odd = both @ cosine, both @ sine
    x, y = even[: len(bins)] + 1j * even[len(bins) :], 1j * odd[: len(bins)] - odd[len(bins) :]
    return x + y, x - y


def _mirror(ahead: NDArray[Any], back: NDArray[Any]) -> NDArray[Any]:
    """Join the samples n ≥ 0 (ahead) and −n (back), n = 0 … size / 2, to one period (B, size)."""
    return np.concatenate([ahead, back[:, -2:0:-1]], axis=1)


def _sinusoids(wavenumbers: Starts, size: int) -> tuple[Float32, Float32]:
    """Return cos and sin of 2πkn/size, (B, size / 2 + 1), looked up in one period."""
    angle = 2.0 * np.pi * np.arange(size) / size
    at = np.multiply.outer(wavenumbers, np.arange(size // 2 + 1)) % size
    return np.cos(angle).astype(np.float32)[at], np.sin(angle).astype(np.float32)[at]
