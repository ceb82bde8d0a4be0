"""Convert the model's 10 kHz signal to another rate, by libsoxr.

`resample` converts a signal at once, `resample_stream` block by block in bounded memory. Streams to a device use the
resampler of actuators/signal_chain.py instead where soxr's delay would be felt.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

if TYPE_CHECKING:
    from soxr import ResampleStream

Float = NDArray[np.float64]

QUALITY = "VHQ"
"""libsoxr's quality: within −160 dB below half of the lower Nyquist frequency, and 0.01 dB below 0.9 of it."""
MIN_RATE_HZ, MAX_RATE_HZ = 1.0, 1e7
"""Output rates [Hz]; below 1 Hz a filter would outlast any stroke."""
MAX_RATIO = 200_000.0
"""Largest ratio of the two rates."""
MAX_BLOCK_OUTPUTS = 2**22
"""Outputs, roughly, that a stream yields at once: a minute at 48 kHz, and half a second at 10 MHz."""


def check_rates(rate_in: float, rate_out: float) -> None:
    """Raise UsageError if rate_out is not between 1 Hz and 10 MHz, or is more than 200 000 times rate_in."""
    if not MIN_RATE_HZ <= rate_out <= MAX_RATE_HZ:
        raise UsageError(
            f"{rate_out} is no sample rate to write: {MIN_RATE_HZ:g} Hz to {MAX_RATE_HZ:.0f} Hz are.",
            remedy="Give one in Hz, for example 10000 or 48000.",
        )
    if not rate_out <= MAX_RATIO * rate_in:
        raise UsageError(f"nothing can be converted from {rate_in:g} Hz to {rate_out:g} Hz.")


def count_outputs(samples: int, rate_in: float, rate_out: float) -> int:
    """Return the number of output samples of `resample` for `samples` inputs at these rates [Hz]."""
    return samples if rate_in == rate_out else round(samples * rate_out / rate_in)


def rate_warnings(rate_out: float) -> tuple[str, ...]:
    """Return a warning if an output rate [Hz] is too low to represent the tactile band; () if not."""
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
        (count_outputs,), in time with the input; amplitudes are exact within 0.01 dB below 0.9 of the lower Nyquist
        frequency.
    warnings : tuple of str
        One if the rate is too low for the tactile band.

    Raises
    ------
    UsageError
        If rate_out is not between 1 Hz and 10 MHz, or is more than 200 000 times rate_in.
    """
    if rate_in == rate_out:
        check_rates(rate_in, rate_out)
        return samples, rate_warnings(rate_out)
    blocks = list(resample_stream([samples], len(samples), rate_in, rate_out))
    return np.concatenate(blocks) if blocks else np.zeros(0), rate_warnings(rate_out)


def resample_stream(blocks: Iterable[Float], total: int, rate_in: float, rate_out: float) -> Iterator[Float]:
    """Convert a signal that arrives in blocks; the result is that of `resample`, to the last bit.

    Memory holds one input block and at most MAX_BLOCK_OUTPUTS output samples.

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
        If rate_out is not between 1 Hz and 10 MHz, or is more than 200 000 times rate_in.
    """
    check_rates(rate_in, rate_out)
    if rate_out == rate_in:
        yield from blocks
        return
    from soxr import ResampleStream  # Only here: most signals stay at the model's rate.

    stream = ResampleStream(rate_in, rate_out, 1, dtype="float64", quality=QUALITY)
    missing = count_outputs(total, rate_in, rate_out)
    for converted in _convert_blocks(stream, blocks, max(int(MAX_BLOCK_OUTPUTS * rate_in / rate_out), 1)):
        yield converted[:missing]
        missing -= min(len(converted), missing)
    yield np.zeros(missing)  # soxr rounds the count of outputs its own way: it may be one sample off.


def _convert_blocks(stream: ResampleStream, blocks: Iterable[Float], max_inputs: int) -> Iterator[Float]:
    """Feed blocks to a soxr stream, at most max_inputs samples at a time, and yield its outputs."""
    for block in blocks:
        for start in range(0, len(block), max_inputs):
            part = np.ascontiguousarray(block[start : start + max_inputs], dtype=np.float64)
            yield np.asarray(stream.resample_chunk(part, last=False))
    yield np.asarray(stream.resample_chunk(np.zeros(0), last=True))
