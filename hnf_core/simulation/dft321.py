"""DFT321: three axes of acceleration into one signal that keeps their power."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def dft321(acceleration: ArrayLike) -> NDArray[np.float64]:
    """(…, n, 3) acceleration → (…, n), same units. Remove the mean first: fuse a whole recording, then cut windows.

    |A_s| = sqrt(|A_x|² + |A_y|² + |A_z|²), phase of A_x + A_y + A_z; so Σ a_s² = Σ_i Σ a_i², one live axis comes back
    exactly, and turning the axes leaves |A_s| as it is. Where the sum vanishes its phase is taken as 0.

    N. Landin et al. (2010), "Dimensional reduction of high-frequency accelerations for haptic rendering",
    EuroHaptics. Raises ValueError unless the last axis has length 3.
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
    # below rounding error the phase of the sum is noise
    phase = np.divide(total, size, out=np.ones_like(total), where=size > 1e-12 * magnitude)
    fused = magnitude * phase
    # bins 0 and n/2 of a real signal are real: only the sign of the sum can be kept there
    edges = [0, -1] if n % 2 == 0 else [0]
    for edge in edges:
        fused[..., edge] = magnitude[..., edge] * np.where(phase[..., edge].real < 0.0, -1.0, 1.0)
    return np.asarray(np.fft.irfft(fused, n, axis=-1))
