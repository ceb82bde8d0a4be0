"""Counter-based normal noise: any block of any stream is computable alone, and no stream repeats."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..kernel import noise as kernel_noise
from ..kernel.library import load_kernel

WORD_MASK = 0xFFFF_FFFF_FFFF_FFFF
_WORDS_PER_COUNT = 4


def _draw_words(seed: int, stream: int, block: int, first: int, last: int) -> NDArray[np.uint64]:
    """Words first … last − 1 of block `block` (any integer, also negative) of a stream; what lies before them is not
    drawn.

    Philox4x64-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") keyed by (seed, stream) at a
    counter set by the block. Raw words, for numpy promises those across versions, but not its own normal sampler, and
    the same seed must give the same bytes.
    """
    skipped = first // _WORDS_PER_COUNT
    bits = np.random.Philox(
        key=(seed & WORD_MASK) | ((stream & WORD_MASK) << 64), counter=((block & WORD_MASK) << 64) + skipped
    )
    return np.asarray(bits.random_raw(last - _WORDS_PER_COUNT * skipped)[first - _WORDS_PER_COUNT * skipped :])


def _to_uniform(words: NDArray[np.uint64]) -> NDArray[np.float64]:
    """In 0 … 1, both ends left out."""
    return np.asarray(((words >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)


def _draw_polar(
    seed: int, stream: int, block: int, pairs: int, rows: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius and angle of those in rows of a block's pairs: their cosine and sine parts are normal (Box & Muller
    1958)."""
    radius = _to_uniform(_draw_words(seed, stream, block, rows.start, rows.stop))
    angle = _to_uniform(_draw_words(seed, stream, block, pairs + rows.start, pairs + rows.stop))
    return np.sqrt(-2.0 * np.log(radius)), 2.0 * np.pi * angle


@dataclass(frozen=True, eq=False)
class Bins:
    """The bins of a period of size samples that bands hold. starts: (B + 1,) the first of each, and of what follows the
    last. level: (Σ W,) of each bin, so that every band is of unit expected power."""

    starts: NDArray[np.intp]
    level: NDArray[np.float64]
    size: int

    def select_bands(self, low: int, high: int) -> Bins:
        """Of bands low … high − 1 alone: drawn apart, their numbers are the same."""
        first, last = self.starts[[low, high]] - self.starts[0]
        return Bins(self.starts[low : high + 1], self.level[first:last], self.size)


def make_bins(edges: NDArray[np.float64], size: int) -> Bins:
    """edges: (B + 1,) ascending band edges in cycles per period; a bin belongs to the band that holds it, bins outside
    to none. Raises ValueError where a band is narrower than the period resolves."""
    starts = find_first_bins(edges, size)
    widths = np.diff(starts)
    # Each of n bins is complex normal of variance 2, mirrored: the period's mean power is 4 n / size².
    return Bins(starts, np.repeat(size / np.sqrt(4.0 * widths), widths), size)


def draw_band_spectra(
    seed: int, stream: int, block: int, edges: NDArray[np.float64], size: int
) -> NDArray[np.complex128]:
    """rfft spectra (B, size // 2 + 1) of B noise bands, each of unit expected power over a period of size samples.

    Disjoint bands take their numbers from one white spectrum, so they are independent. edges, errors: as in bins_of.
    """
    bins = make_bins(edges, size)
    drawn, starts = draw_band_bins(seed, stream, block, bins), bins.starts
    spectra = np.zeros((len(edges) - 1, size // 2 + 1), dtype=np.complex128)
    for band, (low, high) in enumerate(pairwise(starts.tolist())):
        spectra[band, low:high] = drawn[low - starts[0] : high - starts[0]]
    return spectra


def draw_band_bins(seed: int, stream: int, block: int, bins: Bins) -> NDArray[np.complex128]:
    """(Σ W,) the bins of band_spectra that are not zero, one band after another. Numbers that no band holds are not
    drawn."""
    first, last, pairs = int(bins.starts[0]), int(bins.starts[-1]), bins.size // 2 + 1
    compiled = load_kernel()
    if compiled is not None:
        return kernel_noise.draw_bins(
            compiled, (seed & WORD_MASK, stream & WORD_MASK, block & WORD_MASK), pairs, first, bins.level
        )
    radius, angle = _draw_polar(seed, stream, block, pairs, slice(first, last))
    out = np.empty(len(radius), dtype=np.complex128)
    out.real, out.imag = radius * bins.level * np.cos(angle), radius * bins.level * np.sin(angle)
    return out


def find_first_bins(edges: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """(B + 1,) first bin of each band and of what follows the last. Raises ValueError as bins_of does."""
    starts = np.clip(np.ceil(edges).astype(np.intp), 1, size // 2)
    empty = np.diff(starts) <= 0
    if empty.any():
        raise ValueError(f"band {int(np.argmax(empty))} holds no bin of a period of {size} samples")
    return starts


def crossfade_window(size: int) -> NDArray[np.float64]:
    """Power-complementary window (size,): w²(t) + w²(t + size/2) = 1, smooth at its ends (the Vorbis I window)."""
    t = (np.arange(size) + 0.5) / size
    return np.asarray(np.sin(0.5 * np.pi * np.square(np.sin(np.pi * t))))
