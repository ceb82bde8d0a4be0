"""The signal chain of a stream: source → processors (filters) → resampler → limiter → counts.

A block of acceleration [m/s²], (n, channels) float32, goes in; (m, channels) int16 counts at the device's rate come
out. There is no thread, device or clock in here.

Streams use a polyphase resampler (windowed sinc, Kaiser window): its stop band is below −90 dB from the lower rate's
Nyquist frequency on, its pass band is flat up to 0.41 of the lower rate, and its delay is 32 frames of the lower rate.
soxr's filters are steeper, but its output comes in bursts: 115 ms late at 8 → 10 kHz and 330 ms at 2.8 → 10 kHz
(measured with soxr 1.1.0, 'HQ'). So soxr serves only signals that do not change during playback.

Kaiser window: J. F. Kaiser, "Nonrecursive digital filter design using the I0-sinh window function", ISCAS 1974; its
parameter and width for an attenuation as in A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", § 7.5.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .limiter import Limiter
from .limits import Limits
from .sink import Counts, SinkFormat

Samples = NDArray[np.float32]


class Source(Protocol):
    """A stream of acceleration [m/s²], read block by block.

    One thread calls `read`; an implementation's commands (seek, gain, pause, …) may come from another.
    """

    @property
    def rate_hz(self) -> float: ...

    @property
    def channels(self) -> int: ...

    def read(self, frames: int) -> Samples:
        """Return the next (n, channels) float32 [m/s²], n ≤ `frames`; n < `frames` means that the source has ended."""
        ...


@runtime_checkable
class PreparableSource(Source, Protocol):
    """A source that can compute ahead before the next block is requested."""

    def prepare(self) -> None:
        """Compute ahead, on the reading thread, after a block was sent. It never changes the samples."""
        ...


class Processor(Protocol):
    """A causal filter with its own state, run at the source's rate, which is usually the lower one."""

    def process(self, block: Samples) -> Samples:
        """Filter a block, (n, channels) → (n, channels) [m/s²]."""
        ...


STOP_BAND_DB = 90.0
"""Attenuation of the resampling filter's stop band [dB]."""
ZERO_CROSSINGS = 32
"""Zero crossings of the sinc on either side, that is, look-ahead of the filter [frames of the lower rate]."""
_MAX_EXACT_PHASES = 4096
_INTERPOLATED_PHASES = 1024
_CHUNK_FRAMES = 1024


class Resampler(Protocol):
    """A streaming converter of the sample rate, independent of how the input is cut into blocks.

    `name` is for reports.
    """

    name: str

    def process(self, block: Samples) -> Samples:
        """Convert a block, (n, channels) → (m, channels) float32, as far as the input received so far determines it."""
        ...

    def finish(self) -> Samples:
        """Return the output frames that remain after the last block.

        n input frames give ⌈n · to / from⌉ output frames in total.
        """
        ...


def make_resampler(from_hz: float, to_hz: float, channels: int, *, low_latency: bool = True) -> Resampler:
    """Make a converter from one sample rate to another.

    Parameters
    ----------
    from_hz, to_hz : float
        Sample rates [Hz]. Equal rates pass the samples on unchanged.
    channels : int
        Number of channels.
    low_latency : bool
        Whether the delay must stay within `ZERO_CROSSINGS` frames of the lower rate. Otherwise soxr is used.

    Raises
    ------
    UsageError
        If a rate is not a possible one.
    """
    if not (0.0 < from_hz < 1e9 and 0.0 < to_hz < 1e9):
        raise UsageError(f"nothing can be converted from {from_hz:g} Hz to {to_hz:g} Hz.")
    if from_hz == to_hz:
        return PassThroughResampler(channels)
    if not low_latency:
        return SoxrResampler(from_hz, to_hz, channels)
    return PolyphaseResampler(from_hz, to_hz, channels)


class PassThroughResampler:
    """Resampler for equal rates."""

    name = "none"

    def __init__(self, channels: int) -> None:
        self._channels = channels

    def process(self, block: Samples) -> Samples:
        return block

    def finish(self) -> Samples:
        return np.zeros((0, self._channels), dtype=np.float32)


class SoxrResampler:
    """Resampler of libsoxr, quality 'HQ'."""

    name = "soxr"

    def __init__(self, from_hz: float, to_hz: float, channels: int) -> None:
        from soxr import ResampleStream  # Only here: live streams do without.

        self._channels = channels
        self._stream = ResampleStream(from_hz, to_hz, channels, dtype="float32", quality="HQ")

    def process(self, block: Samples) -> Samples:
        return self._resample_chunk(block, last=False)

    def finish(self) -> Samples:
        return self._resample_chunk(np.zeros((0, self._channels), dtype=np.float32), last=True)

    def _resample_chunk(self, block: Samples, *, last: bool) -> Samples:
        contiguous = np.ascontiguousarray(block, dtype=np.float32)
        resampled = np.asarray(self._stream.resample_chunk(contiguous, last=last), dtype=np.float32)
        return resampled.reshape(-1, self._channels)


class PolyphaseResampler:
    """Windowed-sinc resampler with a table of filter phases.

    Output frame k lies at input frame k · from / to, an exact fraction (to 1 part in 10¹² if the rates have none below
    10⁶), so nothing drifts. Every output frame is one sum in a fixed order, so the cut into blocks changes nothing.
    """

    name = "polyphase"

    def __init__(self, from_hz: float, to_hz: float, channels: int) -> None:
        ratio = (Fraction(from_hz) / Fraction(to_hz)).limit_denominator(1_000_000)
        self._step, self._frames_per_step = ratio.numerator, ratio.denominator
        if self._step == 0:
            raise UsageError(f"{from_hz:g} Hz and {to_hz:g} Hz lie too far apart to convert.")
        self._half = math.ceil(ZERO_CROSSINGS * max(1.0, from_hz / to_hz))
        exact = self._frames_per_step <= _MAX_EXACT_PHASES
        self._phases = self._frames_per_step if exact else _INTERPOLATED_PHASES
        self._table = design_polyphase_taps(
            np.arange(self._phases + (not exact)) / self._phases, self._half, min(1.0, to_hz / from_hz)
        )
        self._buffer = np.zeros((channels, self._half - 1))
        self._buffer_start = 1 - self._half
        self._frames_in = 0
        self._frames_out = 0

    def process(self, block: Samples) -> Samples:
        self._frames_in += len(block)
        self._buffer = np.concatenate([self._buffer, np.asarray(block, dtype=np.float64).T], axis=1)
        return self._render_until(-((self._half - self._frames_in) * self._frames_per_step // self._step))

    def finish(self) -> Samples:
        self._buffer = np.concatenate([self._buffer, np.zeros((len(self._buffer), self._half + 1))], axis=1)
        return self._render_until(-(-self._frames_in * self._frames_per_step // self._step))

    def _render_until(self, end: int) -> Samples:
        """Return all output frames before index `end` that have not been rendered yet."""
        chunks = [
            self._render_frames(k, min(k + _CHUNK_FRAMES, end)) for k in range(self._frames_out, end, _CHUNK_FRAMES)
        ]
        self._frames_out = max(self._frames_out, end)
        needed = self._frames_out * self._step // self._frames_per_step - self._half + 1
        drop = min(max(needed - self._buffer_start, 0), self._buffer.shape[1])
        self._buffer = self._buffer[:, drop:]
        self._buffer_start += drop
        if not chunks:
            return np.zeros((0, len(self._buffer)), dtype=np.float32)
        return np.concatenate(chunks)

    def _render_frames(self, start: int, end: int) -> Samples:
        position = np.arange(start, end, dtype=np.int64) * self._step
        base, phase = position // self._frames_per_step, position % self._frames_per_step
        windows = np.lib.stride_tricks.sliding_window_view(self._buffer, 2 * self._half, axis=1)
        rows = windows[:, base - (self._half - 1) - self._buffer_start]
        frames = np.einsum("cnt,nt->cn", rows, self._get_filter_weights(phase))
        return np.ascontiguousarray(frames.T, dtype=np.float32)

    def _get_filter_weights(self, phase: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the filter weights (n, taps) for n output frames by their phase.

        A phase is the position between two input frames, in units of 1 / `_frames_per_step` of a frame.
        """
        if self._phases == self._frames_per_step:
            return np.asarray(self._table[phase])
        table_position = phase * (self._phases / self._frames_per_step)
        lower = table_position.astype(np.int64)
        fraction = (table_position - lower)[:, None]
        return np.asarray(self._table[lower] * (1.0 - fraction) + self._table[lower + 1] * fraction)


def design_polyphase_taps(shift: NDArray[np.float64], half: int, rate_ratio: float) -> NDArray[np.float64]:
    """Design the filter taps for fractional delays.

    Parameters
    ----------
    shift : (n,) array
        Delays, 0–1 [input frames], after frame `half` − 1 of those under the filter.
    half : int
        Half of the filter's length [input frames].
    rate_ratio : float
        Lower rate divided by the input's rate, at most 1.

    Returns
    -------
    (n, 2 · half) array
        Weights. Each row sums to 1, so a constant stays a constant.
    """
    width = (STOP_BAND_DB - 7.95) / (14.36 * 2.0 * ZERO_CROSSINGS) * rate_ratio
    cutoff = 0.5 * rate_ratio - 0.5 * width
    beta = 0.1102 * (STOP_BAND_DB - 8.7)
    distance = np.arange(1 - half, half + 1)[None] - shift[:, None]
    window = np.i0(beta * np.sqrt(np.clip(1.0 - np.square(distance / half), 0.0, None))) * (np.abs(distance) <= half)
    weights = np.sinc(2.0 * cutoff * distance) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


class SignalChain:
    """The stages between a source and a device (filters, resampler, limiter), rendered block by block.

    A source of one channel is copied to all channels of the device.

    Parameters
    ----------
    source : Source
        Where the samples come from.
    device : SinkFormat
        Rate, channels and peak of the device.
    limits : Limits
        Limits of the actuator; the peak is lowered to the device's own.
    processors : sequence of Processor
        Filters applied before resampling, in this order.
    low_latency : bool
        Passed to `make_resampler`.
    initial_heat : array_like
        Warmth of the coils at the start, 0–1; a scalar or (channels,).

    Attributes
    ----------
    ended : bool
        Whether the source has given its last frame.
    nonfinite : int
        Number of values that were NaN or infinite. They are set to 0 before any filter can store them.

    Raises
    ------
    UsageError
        If the source has neither one channel nor as many as the device.
    """

    def __init__(
        self,
        source: Source,
        device: SinkFormat,
        limits: Limits,
        processors: Sequence[Processor] = (),
        *,
        low_latency: bool = True,
        initial_heat: ArrayLike = 0.0,
    ) -> None:
        if source.channels not in (1, device.channels):
            raise UsageError(
                f"the signal has {source.channels} channels and '{device.device}' plays {device.channels}.",
                remedy="Give one channel, or as many as the device has.",
            )
        # The device clips beyond its own peak. Limiting to that peak here avoids it, and counts the samples.
        self.limiter = Limiter(
            limits.with_device_peak(device.peak), device.rate_hz, device.channels, initial_heat=initial_heat
        )
        self.ended = False
        self._nonfinite = 0
        self._source, self._processors, self._device = source, processors, device
        self._preparable_source = source if isinstance(source, PreparableSource) else None
        self._resampler = make_resampler(source.rate_hz, device.rate_hz, source.channels, low_latency=low_latency)
        self._source_frames_per_frame = source.rate_hz / device.rate_hz
        self._frame_balance = 0.0

    @property
    def channels(self) -> int:
        """Number of channels of the device."""
        return self._device.channels

    @property
    def resampler_name(self) -> str:
        return self._resampler.name

    @property
    def nonfinite(self) -> int:
        return self._nonfinite + self.limiter.nonfinite

    def render_block(self, frames: int) -> Counts:
        """Render about `frames` frames, (m, channels) counts: as much of the source as lasts that long.

        After the source's end the resampler's remaining frames follow, and then none. Errors of the source and of the
        processors pass through.
        """
        if self.ended:
            return np.zeros((0, self._device.channels), dtype=np.int16)
        self._frame_balance += frames * self._source_frames_per_frame
        source_frames = max(math.floor(self._frame_balance), 1)
        self._frame_balance -= source_frames
        block = self._replace_nonfinite(self._source.read(source_frames))
        self.ended = len(block) < source_frames
        for processor in self._processors if len(block) else ():
            block = processor.process(block)
        samples = self._resampler.process(block)
        if self.ended:
            samples = np.concatenate([samples, self._resampler.finish()])
        if samples.shape[1] < self._device.channels:
            samples = np.repeat(samples, self._device.channels, axis=1)
        return self.limiter.process(samples)

    def prepare(self) -> None:
        """Let the source compute ahead, while no block is requested; see `PreparableSource`."""
        if self._preparable_source is not None and not self.ended:
            self._preparable_source.prepare()

    def _replace_nonfinite(self, block: Samples) -> Samples:
        finite = np.isfinite(block)
        if finite.all():
            return block
        self._nonfinite += int(finite.size - np.count_nonzero(finite))
        return np.where(finite, block, np.float32(0.0))


def render_counts(
    source: Source,
    device: SinkFormat,
    limits: Limits,
    processors: Sequence[Processor] = (),
    *,
    low_latency: bool = True,
) -> Counts:
    """Render a whole source offline: every count that a stream sends to `device`, byte for byte.

    The coils start cold and nothing pauses. The source must end. Parameters are those of `SignalChain`.

    Returns
    -------
    (n, channels) int16 array
        Counts, including the final fade-out.
    """
    chain = SignalChain(source, device, limits, processors, low_latency=low_latency)
    blocks: list[Counts] = []
    while not chain.ended:
        blocks.append(chain.render_block(4096))
    return np.concatenate([*blocks, chain.limiter.flush()])
