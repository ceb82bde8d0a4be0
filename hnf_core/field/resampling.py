"""The model's 10 kHz signal at another rate, by windowed-sinc polyphase interpolation."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

Float = NDArray[np.float64]

HALF_WIDTH = 64
"""Zero crossings on either side."""
KAISER_BETA = 9.0
"""About −90 dB in the stop band (Kaiser 1974)."""
ROLL_OFF = 0.95
"""Cut-off as a share of the lower of both Nyquist frequencies. With these three, flat to 0.9 of it."""


def resample(samples: Float, rate_in: float, rate_out: float) -> tuple[Float, tuple[str, ...]]:
    """samples (n,) from rate_in to rate_out [Hz]; also warnings in words where the new rate cannot hold the touch band.

    Below 0.9 of the lower Nyquist frequency amplitudes are kept within 0.01 dB. Raises UsageError for a rate that is
    not positive and finite.
    """
    if not (np.isfinite(rate_out) and rate_out > 0.0):
        raise UsageError(f"{rate_out} is no sample rate.", remedy="Give one in Hz, for example 10000 or 48000.")
    warnings: tuple[str, ...] = ()
    if rate_out < 2200.0:
        warnings = (f"{rate_out:g} Hz cannot hold frequencies above {rate_out / 2:g} Hz; touch reaches to 1000 Hz.",)
    if rate_out == rate_in:
        return samples, warnings
    ratio = Fraction(rate_in / rate_out).limit_denominator(4096)
    count = round(len(samples) * rate_out / rate_in)
    scale = min(1.0, rate_out / rate_in) * ROLL_OFF
    reach = int(np.ceil(HALF_WIDTH / scale))
    taps = np.arange(-reach, reach + 1)
    phases = np.arange(ratio.denominator) / ratio.denominator
    distance = taps[None, :] - phases[:, None]
    kernel = scale * np.sinc(scale * distance) * _kaiser(distance / reach)
    kernel /= kernel.sum(axis=1, keepdims=True)
    padded = np.concatenate([np.zeros(reach), samples, np.zeros(reach + 1)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(taps))
    out = np.zeros(count)
    for phase in range(ratio.denominator):
        # Output m stands at input m · ratio; those of one phase share a kernel.
        m = np.arange(_solve(phase, ratio), count, ratio.denominator)
        base = m * ratio.numerator // ratio.denominator
        out[m] = windows[np.minimum(base, len(windows) - 1)] @ kernel[phase]
    return out, warnings


def _solve(phase: int, ratio: Fraction) -> int:
    """Smallest m ≥ 0 with m · numerator ≡ phase (mod denominator)."""
    if ratio.denominator == 1:
        return 0
    return phase * pow(ratio.numerator, -1, ratio.denominator) % ratio.denominator


def _kaiser(x: Float) -> Float:
    return np.asarray(np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - x * x, 0.0, 1.0))) / np.i0(KAISER_BETA))
