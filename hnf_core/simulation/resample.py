"""Between the sample rate and the finer steps of integration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

BLOCK_SAMPLES = 128
"""Samples handled together: large batches stay within the processor's cache."""


def oversample_blocks(drives: Float, factor: int) -> Iterator[Float]:
    """(D, n, B) → blocks (D, ≤ BLOCK·factor + 2, B), one fine step of overlap at either side of each.

    Cubic (Catmull–Rom) interpolation, both ends extrapolated linearly.
    """
    first, last = drives[:, :1], drives[:, -1:]
    rise, fall = drives[:, 1:2] - first, last - drives[:, -2:-1]
    padded = np.concatenate([first - 2 * rise, first - rise, drives, last + fall, last + 2 * fall, last + 3 * fall], 1)
    n = drives.shape[1]
    for start in range(0, n, BLOCK_SAMPLES):
        stop = min(start + BLOCK_SAMPLES, n)
        fine = _interpolate_cubic(padded[:, start : stop + 5], factor)
        yield fine[:, factor - 1 : fine.shape[1] - factor + 1]


def _interpolate_cubic(values: Float, factor: int) -> Float:
    """(D, m + 3, B) → (D, m·factor, B): from the second value on, towards the next."""
    a, b, c, d = values[:, :-3], values[:, 1:-2], values[:, 2:-1], values[:, 3:]
    out = np.empty((b.shape[0], b.shape[1], factor, b.shape[2]))
    out[:, :, 0] = b
    for k in range(1, factor):
        t = k / factor
        out[:, :, k] = 0.5 * (2 * t**2 - t - t**3) * a
        out[:, :, k] += (1.0 - 2.5 * t**2 + 1.5 * t**3) * b
        out[:, :, k] += 0.5 * (t + 4 * t**2 - 3 * t**3) * c
        out[:, :, k] += 0.5 * (t**3 - t**2) * d
    return out.reshape(b.shape[0], -1, b.shape[2])


def decimate(fine: Float, factor: int) -> Float:
    """(n·factor, C, B) → (B, n, C) through a zero-phase windowed-sinc low-pass, so that impacts do not alias."""
    steps, channels, rows = fine.shape
    n = steps // factor
    out = np.empty((rows, n, channels))
    if factor == 1:
        out[:] = fine.transpose(2, 0, 1)
        return out
    half = 16 * factor
    taps = np.sinc(np.arange(-half, half + 1) / factor) * np.kaiser(2 * half + 1, 6.0)
    taps /= taps.sum()
    band = np.zeros((BLOCK_SAMPLES, BLOCK_SAMPLES * factor + 2 * half))
    for row in range(BLOCK_SAMPLES):
        band[row, row * factor : row * factor + len(taps)] = taps
    fine = fine.reshape(steps, -1)
    for start in range(0, n, BLOCK_SAMPLES):
        stop = min(start + BLOCK_SAMPLES, n)
        around = np.clip(np.arange(start * factor - half, (stop - 1) * factor + half + 1), 0, steps - 1)
        part = band[: stop - start, : len(around)] @ fine[around]
        out[:, start:stop] = part.reshape(-1, channels, rows).transpose(2, 0, 1)
    return out
