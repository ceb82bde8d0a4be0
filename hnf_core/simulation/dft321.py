"""DFT321: fusion of three axes of acceleration into one signal of the same spectral power."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def dft321(acceleration: ArrayLike) -> NDArray[np.float64]:
    """Fuse three axes of acceleration into one signal of the same spectral power.

    Parameters
    ----------
    acceleration : array_like, shape (…, n, 3)
        Acceleration. Remove the mean first; fuse a complete recording, then cut windows.

    Returns
    -------
    ndarray, shape (…, n)
        Fused signal, same unit.

    Raises
    ------
    ValueError
        Unless the last axis has length 3.

    Notes
    -----
    |A_s| = sqrt(|A_x|² + |A_y|² + |A_z|²), with the phase of A_x + A_y + A_z (0 where the sum vanishes). So Σ a_s² =
    Σ_i Σ a_i², a single active axis is returned exactly, and a rotation of the axes leaves |A_s| unchanged. N. Landin
    et al. (2010), "Dimensional reduction of high-frequency accelerations for haptic rendering", EuroHaptics.
    """
    a = np.asarray(acceleration, dtype=np.float64)
    if a.ndim < 2 or a.shape[-1] != 3:
        raise ValueError(f"dft321 takes (..., n, 3), not {a.shape}.")
    n = a.shape[-2]
    if n == 0:
        return np.zeros(a.shape[:-1])
    spectra = np.fft.rfft(a, axis=-2)
    magnitude = np.sqrt(np.sum(np.square(np.abs(spectra)), axis=-1))
    total = np.sum(spectra, axis=-1)
    size = np.abs(total)
    # Below rounding error the phase of the sum is noise.
    phase = np.divide(total, size, out=np.ones_like(total), where=size > 1e-12 * magnitude)
    fused = magnitude * phase
    # Bins 0 and n/2 of a real signal are real, so only the sign of the sum remains there.
    edges = [0, -1] if n % 2 == 0 else [0]
    for edge in edges:
        fused[..., edge] = magnitude[..., edge] * np.where(phase[..., edge].real < 0.0, -1.0, 1.0)
    return np.asarray(np.fft.irfft(fused, n, axis=-1))
