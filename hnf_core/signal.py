"""The output of synthesis: a vibrotactile acceleration in m/s² with its sample rate, seed and provenance; DFT321."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import UsageError


@dataclass(frozen=True)
class Signal:
    """A vibrotactile acceleration a(t) in m/s², never normalised.

    Attributes
    ----------
    samples : ndarray of float32, shape (n,)
        Acceleration [m/s²].
    sample_rate : float
        Sample rate [Hz].
    seed : int
        Seed of the noise carriers that it was synthesised from.
    provenance : mapping of str to str
        Facts as text (stroke, material, probe, model hash, origin of the token's bands), which exports write into
        files.
    """

    samples: NDArray[np.float32]
    sample_rate: float
    seed: int
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Duration of the signal [s]."""
        return len(self.samples) / self.sample_rate

    @property
    def rms(self) -> float:
        """Root mean square of the acceleration [m/s²]; 0 for an empty signal."""
        if len(self.samples) == 0:
            return 0.0
        return float(np.sqrt(np.mean(np.square(self.samples, dtype=np.float64))))


def to_signal(signal: Signal | ArrayLike, rate_hz: float | None = None) -> Signal:
    """Convert an array (n,) in m/s² with its rate [Hz] to a `Signal`; a `Signal` is returned as it is.

    Raises UsageError for anything else, or if `rate_hz` differs from the signal's rate.
    """
    if isinstance(signal, Signal):
        if rate_hz is not None and rate_hz != signal.sample_rate:
            raise UsageError(
                f"the signal has {signal.sample_rate:g} Hz, not {rate_hz:g} Hz.", remedy="Leave rate_hz out."
            )
        return signal
    if rate_hz is None:
        raise UsageError("samples without a rate are no signal.", remedy="Give rate_hz, for example 10000.")
    check_rate(rate_hz)
    return Signal(to_vector(signal, "signal").astype(np.float32), float(rate_hz), 0)


def to_vector(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Convert values to a non-empty float64 array (n,); raise UsageError, naming them `name`, if that fails."""
    try:
        vector = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} is not made of numbers ({error}).") from error
    if vector.ndim != 1 or len(vector) == 0:
        raise UsageError(f"{name} has shape {vector.shape}, not (n,).", remedy="Give one row of numbers.")
    return vector


def check_rate(rate_hz: float) -> None:
    """Raise UsageError if a sample rate [Hz] is no number, not finite or below 100 Hz."""
    if not (isinstance(rate_hz, (int, float, np.number)) and np.isfinite(rate_hz) and rate_hz > 0.0):
        raise UsageError(f"{rate_hz} Hz is no sample rate.", remedy="Give it in Hz, for example 10000.")
    if rate_hz < 100.0:
        raise UsageError(
            f"{rate_hz:g} Hz cannot hold touch, which reaches to 1000 Hz.", remedy="Was it meant in kHz? Give it in Hz."
        )


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
