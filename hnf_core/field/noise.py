"""Counter-based normal noise: any block of any stream is computable alone, and no stream repeats."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

WORD = 0xFFFF_FFFF_FFFF_FFFF


def normal_block(seed: int, stream: int, block: int, count: int) -> NDArray[np.float64]:
    """count standard normal numbers of block `block` (any integer, also negative) of stream `stream`.

    Philox4x64-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") keyed by (seed, stream) at a
    counter set by the block, then Box–Muller on the raw words: numpy promises the raw words across versions, but not
    its own normal sampler, and the same seed must give the same bytes.
    """
    bits = np.random.Philox(key=(seed & WORD) | ((stream & WORD) << 64), counter=(block & WORD) << 64)
    pairs = (count + 1) // 2
    raw = bits.random_raw(2 * pairs)
    uniform = ((raw >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    radius = np.sqrt(-2.0 * np.log(uniform[:pairs]))
    angle = 2.0 * np.pi * uniform[pairs:]
    return np.asarray(np.concatenate([radius * np.cos(angle), radius * np.sin(angle)])[:count])


def band_spectra(seed: int, stream: int, block: int, edges: NDArray[np.float64], size: int) -> NDArray[np.complex128]:
    """rfft spectra (B, size // 2 + 1) of B noise bands, each of unit expected power over a period of size samples.

    edges: (B + 1,) ascending band edges in cycles per period; a bin belongs to the band that holds it, bins outside
    to none. Disjoint bands take their numbers from one white spectrum, so they are independent. Raises ValueError
    where a band is narrower than the period resolves.
    """
    bins = np.arange(size // 2 + 1)
    numbers = normal_block(seed, stream, block, 2 * len(bins))
    white = numbers[: len(bins)] + 1j * numbers[len(bins) :]
    starts = np.clip(np.ceil(edges).astype(int), 1, size // 2)
    spectra = np.zeros((len(edges) - 1, len(bins)), dtype=np.complex128)
    for band, (low, high) in enumerate(pairwise(starts.tolist())):
        if low >= high:
            raise ValueError(f"band {band} holds no bin of a period of {size} samples")
        # Each of n bins is complex normal of variance 2, mirrored: the period's mean power is 4 n / size².
        spectra[band, low:high] = white[low:high] * (size / np.sqrt(4.0 * (high - low)))
    return spectra


def crossfade_window(size: int) -> NDArray[np.float64]:
    """Power-complementary window (size,): w²(t) + w²(t + size/2) = 1, smooth at its ends (the Vorbis I window)."""
    t = (np.arange(size) + 0.5) / size
    return np.asarray(np.sin(0.5 * np.pi * np.square(np.sin(np.pi * t))))
