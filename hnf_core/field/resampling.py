"""The model's 10 kHz signal at another rate, by windowed-sinc polyphase interpolation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
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
MIN_RATE_HZ, MAX_RATE_HZ = 1.0, 1e7
"""A kernel is as long as 64 samples of the slower rate: slower still, and one outlasts any stroke."""

MAX_PHASES = 200_000
"""Every whole number of Hz up to it is met exactly; the clock of any other is right to 5 millionths."""
_MAX_ROWS, _MAX_NUMBERS = 2**16, 2**23
"""At a time, so that an hour takes no more memory than a minute: a row is a kernel long, 13 475 numbers at 100 Hz."""
_KERNEL_NUMBERS = 2**15
"""Numbers of kernels that are made together: each costs a call otherwise, and more of them leave the cache."""
_FEW_OUTPUTS = 8
"""Outputs of a phase up to which all phases are computed together: with more, each by itself is the faster."""
MAX_BLOCK_OUTPUTS = 2**22
"""That a stream gives at once: a minute at 48 kHz, and half a second at 10 MHz."""


@dataclass(frozen=True)
class RateConversion:
    """From rate_in to rate_out [Hz]: output m stands at input m · ratio, and is made of `reach` samples around it."""

    rate_in: float
    rate_out: float
    ratio: Fraction
    scale: float
    reach: int

    def count_outputs(self, samples: int) -> int:
        """Outputs that this many samples make."""
        return round(samples * self.rate_out / self.rate_in)

    def find_input(self, output: int) -> int:
        """The sample that output stands at, or after."""
        return output * self.ratio.numerator // self.ratio.denominator

    def convert(self, samples: Float, origin: int, first: int, count: int) -> Float:
        """Outputs first … first + count − 1, (count,), of samples that begin at sample `origin`; 0 beyond them."""
        padded = np.concatenate([np.zeros(self.reach), samples, np.zeros(self.reach + 1)])
        length = 2 * self.reach + 1
        windows = np.lib.stride_tricks.sliding_window_view(padded, length)
        rows = min(_MAX_ROWS, max(_MAX_NUMBERS // length, 1))
        numerator, denominator = self.ratio.numerator, self.ratio.denominator
        out = np.zeros(count)

        def windows_of(m: NDArray[np.int64]) -> Float:
            return windows[np.clip(m * numerator // denominator - origin, 0, len(windows) - 1)]

        # Every denominator-th output shares a phase, and so a kernel.
        phases, together = min(denominator, count), max(_KERNEL_NUMBERS // length, 1)
        for start in range(0, phases, together):
            m = np.arange(first + start, first + min(start + together, phases), dtype=np.int64)
            kernels = self._compute_kernels(m)
            if count <= _FEW_OUTPUTS * denominator:
                for later in range(0, count, denominator):
                    here = (m + later)[m + later < first + count]
                    out[here - first] = np.einsum("ij,ij->i", windows_of(here), kernels[: len(here)])
                continue
            for output, kernel in zip(m.tolist(), kernels, strict=True):
                alike = np.arange(output, first + count, denominator)
                for low in range(0, len(alike), rows):
                    part = alike[low : low + rows]
                    out[part - first] = windows_of(part) @ kernel
        return out

    def _compute_kernels(self, outputs: NDArray[np.int64]) -> Float:
        """(n, 2 · reach + 1) what each output takes of the samples about its place."""
        shares = (outputs * self.ratio.numerator % self.ratio.denominator) / self.ratio.denominator
        distance = np.arange(-self.reach, self.reach + 1) - shares[:, None]
        kernels = np.sinc(self.scale * distance) * _kaiser(distance / self.reach)
        kernels /= kernels.sum(axis=1, keepdims=True)
        return np.asarray(kernels)


def plan_conversion(rate_in: float, rate_out: float) -> RateConversion:
    """Raises UsageError for a rate_out that is no number from 1 Hz to 10 MHz, or 200 000 times rate_in."""
    if not MIN_RATE_HZ <= rate_out <= MAX_RATE_HZ:
        raise UsageError(
            f"{rate_out} is no sample rate to write: {MIN_RATE_HZ:g} Hz to {MAX_RATE_HZ:.0f} Hz are.",
            remedy="Give one in Hz, for example 10000 or 48000.",
        )
    ratio = Fraction(rate_in / rate_out).limit_denominator(MAX_PHASES)
    if ratio <= 0:
        raise UsageError(f"nothing can be converted from {rate_in:g} Hz to {rate_out:g} Hz.")
    scale = min(1.0, rate_out / rate_in) * ROLL_OFF
    return RateConversion(rate_in, rate_out, ratio, scale, int(np.ceil(HALF_WIDTH / scale)))


def rate_warnings(rate_out: float) -> tuple[str, ...]:
    """In words, where the new rate cannot hold the touch band."""
    if rate_out >= 2200.0:
        return ()
    return (f"{rate_out:g} Hz cannot hold frequencies above {rate_out / 2:g} Hz; touch reaches to 1000 Hz.",)


def resample(samples: Float, rate_in: float, rate_out: float) -> tuple[Float, tuple[str, ...]]:
    """samples (n,) from rate_in to rate_out [Hz]; also rate_warnings.

    Below 0.9 of the lower Nyquist frequency amplitudes are kept within 0.01 dB. Raises what conversion() raises.
    """
    convert = plan_conversion(rate_in, rate_out)
    if rate_out != rate_in:
        samples = convert.convert(samples, 0, 0, convert.count_outputs(len(samples)))
    return samples, rate_warnings(rate_out)


def resample_stream(blocks: Iterable[Float], total: int, rate_in: float, rate_out: float) -> Iterator[Float]:
    """resample() of what portions, of total samples together, make: piece by piece, within rounding of the whole.

    Holds one portion, the kernel's reach, and MOST_OUTPUTS. Raises what conversion() raises.
    """
    convert = plan_conversion(rate_in, rate_out)
    if rate_out == rate_in:
        yield from blocks
        return
    count, done, origin, arrived = convert.count_outputs(total), 0, 0, 0
    held = np.zeros(0)
    for portion in blocks:
        held, arrived = np.concatenate([held, portion]), arrived + len(portion)
        ready = count
        if arrived < total:
            # Output m needs samples up to at(m) + reach, which lie before `arrived`.
            ready = min(
                max(-((convert.reach - arrived) * convert.ratio.denominator // convert.ratio.numerator), 0), count
            )
        if ready > done:
            for first in range(done, ready, MAX_BLOCK_OUTPUTS):
                yield convert.convert(held, origin, first, min(MAX_BLOCK_OUTPUTS, ready - first))
            done = ready
            behind = max(convert.find_input(done) - convert.reach - origin, 0)
            held, origin = held[behind:], origin + behind


def _kaiser(x: Float) -> Float:
    return np.asarray(np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - x * x, 0.0, 1.0))) / np.i0(KAISER_BETA))
