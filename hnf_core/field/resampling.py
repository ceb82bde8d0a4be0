"""Convert the model's 10 kHz signal to another rate, by windowed-sinc polyphase interpolation.

`resample` converts a signal at once, `resample_stream` block by block in bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

Float = NDArray[np.float64]

HALF_WIDTH = 64
"""Zero crossings of the sinc on either side."""
KAISER_BETA = 9.0
"""Shape of the Kaiser window: about −90 dB in the stop band (Kaiser 1974)."""
ROLL_OFF = 0.95
"""Cut-off relative to the lower of both Nyquist frequencies; with these three constants flat to 0.9 of it."""
MIN_RATE_HZ, MAX_RATE_HZ = 1.0, 1e7
"""Output rates [Hz]; a kernel is as long as 64 samples of the slower rate, and below 1 Hz would outlast any stroke."""

MAX_PHASES = 200_000
"""Largest denominator of the rate ratio: integer rates up to it are exact, any other is right to 5 millionths."""
_MAX_ROWS, _MAX_NUMBERS = 2**16, 2**23
"""Rows of one product, and numbers in it: a row is a kernel long, 13 475 numbers at 100 Hz.

They bound the memory, which is the same for an hour as for a minute.
"""
_KERNEL_NUMBERS = 2**15
"""Numbers of kernels that are computed together: each would cost a call otherwise, and more would leave the cache."""
_FEW_OUTPUTS = 8
"""Outputs per phase up to which all phases are computed together; with more, each alone is faster."""
MAX_BLOCK_OUTPUTS = 2**22
"""Outputs that a stream yields at once: a minute at 48 kHz, and half a second at 10 MHz."""


@dataclass(frozen=True)
class RateConversion:
    """Conversion from rate_in to rate_out [Hz].

    Output m lies at input m · ratio, and depends on `reach` samples on either side. scale: cut-off relative to the
    input's Nyquist frequency.
    """

    rate_in: float
    rate_out: float
    ratio: Fraction
    scale: float
    reach: int

    def count_outputs(self, samples: int) -> int:
        """Return the number of outputs of this many samples."""
        return round(samples * self.rate_out / self.rate_in)

    def find_input(self, output: int) -> int:
        """Return the last sample that is not later than an output."""
        return output * self.ratio.numerator // self.ratio.denominator

    def convert(self, samples: Float, origin: int, first: int, count: int) -> Float:
        """Compute outputs first … first + count − 1, (count,).

        samples begin at sample `origin`, and are 0 beyond their ends.
        """
        padded = np.concatenate([np.zeros(self.reach), samples, np.zeros(self.reach + 1)])
        length = 2 * self.reach + 1
        windows = np.lib.stride_tricks.sliding_window_view(padded, length)
        rows = min(_MAX_ROWS, max(_MAX_NUMBERS // length, 1))
        numerator, denominator = self.ratio.numerator, self.ratio.denominator
        out = np.zeros(count)

        def select_windows(output_numbers: NDArray[np.int64]) -> Float:
            return windows[np.clip(output_numbers * numerator // denominator - origin, 0, len(windows) - 1)]

        # Every denominator-th output has the same phase, and so the same kernel.
        phases, phases_per_batch = min(denominator, count), max(_KERNEL_NUMBERS // length, 1)
        for start in range(0, phases, phases_per_batch):
            output_numbers = np.arange(first + start, first + min(start + phases_per_batch, phases), dtype=np.int64)
            kernels = self._compute_kernels(output_numbers)
            if count <= _FEW_OUTPUTS * denominator:
                for offset in range(0, count, denominator):
                    outputs = (output_numbers + offset)[output_numbers + offset < first + count]
                    out[outputs - first] = np.einsum("ij,ij->i", select_windows(outputs), kernels[: len(outputs)])
                continue
            for output, kernel in zip(output_numbers.tolist(), kernels, strict=True):
                same_phase = np.arange(output, first + count, denominator)
                for low in range(0, len(same_phase), rows):
                    chunk = same_phase[low : low + rows]
                    out[chunk - first] = select_windows(chunk) @ kernel
        return out

    def _compute_kernels(self, outputs: NDArray[np.int64]) -> Float:
        """Compute the weights (n, 2 · reach + 1) of the samples around each output."""
        fractions = (outputs * self.ratio.numerator % self.ratio.denominator) / self.ratio.denominator
        distance = np.arange(-self.reach, self.reach + 1) - fractions[:, None]
        kernels = np.sinc(self.scale * distance) * _kaiser(distance / self.reach)
        kernels /= kernels.sum(axis=1, keepdims=True)
        return np.asarray(kernels)


def plan_conversion(rate_in: float, rate_out: float) -> RateConversion:
    """Build the conversion between two rates [Hz].

    Raises UsageError if rate_out is not between 1 Hz and 10 MHz, or is more than 200 000 times rate_in.
    """
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
    """Return a warning if the rate cannot represent the tactile band."""
    if rate_out >= 2200.0:
        return ()
    return (f"{rate_out:g} Hz cannot hold frequencies above {rate_out / 2:g} Hz; touch reaches to 1000 Hz.",)


def resample(samples: Float, rate_in: float, rate_out: float) -> tuple[Float, tuple[str, ...]]:
    """Convert samples (n,) from rate_in to rate_out [Hz].

    Parameters
    ----------
    samples
        (n,) signal.
    rate_in, rate_out
        Sample rates [Hz].

    Returns
    -------
    samples : ndarray
        Amplitudes are exact within 0.01 dB below 0.9 of the lower Nyquist frequency.
    warnings : tuple of str
        As of rate_warnings.

    Raises
    ------
    UsageError
        If rate_out is not between 1 Hz and 10 MHz, or is more than 200 000 times rate_in.
    """
    convert = plan_conversion(rate_in, rate_out)
    if rate_out != rate_in:
        samples = convert.convert(samples, 0, 0, convert.count_outputs(len(samples)))
    return samples, rate_warnings(rate_out)


def resample_stream(blocks: Iterable[Float], total: int, rate_in: float, rate_out: float) -> Iterator[Float]:
    """Convert a signal that arrives in blocks; the result equals that of `resample` within rounding.

    Memory holds one block, the kernel's reach and MAX_BLOCK_OUTPUTS.

    Parameters
    ----------
    blocks
        Consecutive blocks of the signal.
    total
        Samples of all blocks together.
    rate_in, rate_out
        Sample rates [Hz].

    Yields
    ------
    ndarray
        Consecutive blocks of the output.

    Raises
    ------
    UsageError
        As of `resample`.
    """
    convert = plan_conversion(rate_in, rate_out)
    if rate_out == rate_in:
        yield from blocks
        return
    count, done, origin, arrived = convert.count_outputs(total), 0, 0, 0
    buffer = np.zeros(0)
    for block in blocks:
        buffer, arrived = np.concatenate([buffer, block]), arrived + len(block)
        ready = count
        if arrived < total:
            # Output m needs samples up to find_input(m) + reach, which must have arrived.
            ready = min(
                max(-((convert.reach - arrived) * convert.ratio.denominator // convert.ratio.numerator), 0), count
            )
        if ready > done:
            for first in range(done, ready, MAX_BLOCK_OUTPUTS):
                yield convert.convert(buffer, origin, first, min(MAX_BLOCK_OUTPUTS, ready - first))
            done = ready
            unused = max(convert.find_input(done) - convert.reach - origin, 0)
            buffer, origin = buffer[unused:], origin + unused


def _kaiser(x: Float) -> Float:
    """Return the Kaiser window at x in −1 … 1."""
    return np.asarray(np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - x * x, 0.0, 1.0))) / np.i0(KAISER_BETA))
