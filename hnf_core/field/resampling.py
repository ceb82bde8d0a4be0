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

MOST_PHASES = 200_000
"""Every whole number of Hz up to it is met exactly; the clock of any other is right to 5 millionths."""
_ROWS = 2**16
"""At a time, so that an hour needs no more memory than a minute: each row is a kernel long."""


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
    ratio = Fraction(rate_in / rate_out).limit_denominator(MOST_PHASES)
    count = round(len(samples) * rate_out / rate_in)
    scale = min(1.0, rate_out / rate_in) * ROLL_OFF
    reach = int(np.ceil(HALF_WIDTH / scale))
    taps = np.arange(-reach, reach + 1)
    padded = np.concatenate([np.zeros(reach), samples, np.zeros(reach + 1)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(taps))
    out = np.zeros(count)
    for first in range(min(ratio.denominator, count)):
        # Output m stands at input m · ratio; every denominator-th shares a phase, and so a kernel.
        m = np.arange(first, count, ratio.denominator)
        base = np.minimum(m * ratio.numerator // ratio.denominator, len(windows) - 1)
        distance = taps - (first * ratio.numerator % ratio.denominator) / ratio.denominator
        kernel = np.sinc(scale * distance) * _kaiser(distance / reach)
        kernel /= kernel.sum()
        for start in range(0, len(m), _ROWS):
            part = slice(start, start + _ROWS)
            out[m[part]] = windows[base[part]] @ kernel
    return out, warnings


def _kaiser(x: Float) -> Float:
    return np.asarray(np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - x * x, 0.0, 1.0))) / np.i0(KAISER_BETA))
