"""Where samples come from.

What happens to a stream between its source and the limiter.

One sample rate to another, block by block, without clicks or drift.

A stream uses its own polyphase filter (windowed sinc, Kaiser's window): stop-band below −90 dB from the lower rate's
Nyquist frequency on, flat up to 0.41 of the lower rate; what goes in comes out 32 frames of the lower rate later.
soxr's filters are sharper and better still, but they answer in lumps: measured with soxr 1.1.0 ('HQ'), 115 ms late at
8 → 10 kHz and 330 ms at 2.8 → 10 kHz. So soxr is for what nobody changes while it plays.

Kaiser's window: J. F. Kaiser, "Nonrecursive digital filter design using the I0-sinh window function", ISCAS 1974; its
parameter and width for an attenuation as in A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", § 7.5.

From a source to counts: stages, rate, limiter. No thread, no device, no clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .limiter import Limiter
from .limits import Limits
from .sink import Counts, SinkFormat

Samples = NDArray[np.float32]


class Source(Protocol):
    """Acceleration in m/s², block by block. One thread calls read(); commands (seek, gain, pause, …) of an
    implementation may come from another."""

    @property
    def rate_hz(self) -> float: ...

    @property
    def channels(self) -> int: ...

    def read(self, frames: int) -> Samples:
        """(n, channels) float32 m/s²: the next n ≤ frames; n < frames says that it has ended."""
        ...


@runtime_checkable
class PreparableSource(Source, Protocol):
    """A source with work that needs not wait until the next block is asked for."""

    def prepare(self) -> None:
        """Do it: the last block is on its way. By the thread that reads; who never calls it gets the same samples."""
        ...


class Processor(Protocol):
    """A causal filter at the source's rate, where there are fewest samples, with memory of its own."""

    def process(self, block: Samples) -> Samples:
        """(n, channels) m/s² → as many."""
        ...


STOP_BAND_DB = 90.0
ZERO_CROSSINGS = 32
"""Of the sinc, to either side: frames of the lower rate that the filter looks ahead."""
_MAX_EXACT_PHASES = 4096
_INTERPOLATED_PHASES = 1024
_CHUNK_FRAMES = 1024


class Resampler(Protocol):
    """Blocks cut anyhow give the same frames. name: for reports."""

    name: str

    def process(self, block: Samples) -> Samples:
        """(n, channels) float32 → (m, channels) float32, as far as it is known yet."""
        ...

    def finish(self) -> Samples:
        """What is left: with it, n frames in have given ⌈n · to / from⌉ out."""
        ...


def make_resampler(from_hz: float, to_hz: float, channels: int, *, low_latency: bool = True) -> Resampler:
    """prompt: answer within CROSSINGS frames of the lower rate. Otherwise soxr where it is installed. Equal rates: what
    comes goes, untouched. Raises UsageError where a rate is none."""
    if not (0.0 < from_hz < 1e9 and 0.0 < to_hz < 1e9):
        raise UsageError(f"nothing can be converted from {from_hz:g} Hz to {to_hz:g} Hz.")
    if from_hz == to_hz:
        return PassThroughResampler(channels)
    if not low_latency:
        try:
            import soxr
        except ImportError:
            pass
        else:
            return SoxrResampler(soxr, from_hz, to_hz, channels)
    return PolyphaseResampler(from_hz, to_hz, channels)


class PassThroughResampler:
    """Nothing to convert."""

    name = "none"

    def __init__(self, channels: int) -> None:
        self._channels = channels

    def process(self, block: Samples) -> Samples:
        return block

    def finish(self) -> Samples:
        return np.zeros((0, self._channels), dtype=np.float32)


class SoxrResampler:
    """libsoxr, 'HQ'."""

    name = "soxr"

    def __init__(self, module: Any, from_hz: float, to_hz: float, channels: int) -> None:
        self._channels = channels
        self._stream = module.ResampleStream(from_hz, to_hz, channels, dtype="float32", quality="HQ")

    def process(self, block: Samples) -> Samples:
        return self._resample_chunk(block, last=False)

    def finish(self) -> Samples:
        return self._resample_chunk(np.zeros((0, self._channels), dtype=np.float32), last=True)

    def _resample_chunk(self, block: Samples, *, last: bool) -> Samples:
        given = np.ascontiguousarray(block, dtype=np.float32)
        found = np.asarray(self._stream.resample_chunk(given, last=last), dtype=np.float32)
        return found.reshape(-1, self._channels)


class PolyphaseResampler:
    """Output frame k lies at k · from / to frames of the input, an exact fraction (to 1 part in 10¹² where rates have
    none below 10⁶): no drift. Every output frame is one sum in one order, so that no cut shows."""

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
        """All frames before end that are not made yet."""
        made = [
            self._render_frames(k, min(k + _CHUNK_FRAMES, end)) for k in range(self._frames_out, end, _CHUNK_FRAMES)
        ]
        self._frames_out = max(self._frames_out, end)
        needed = self._frames_out * self._step // self._frames_per_step - self._half + 1
        drop = min(max(needed - self._buffer_start, 0), self._buffer.shape[1])
        self._buffer = self._buffer[:, drop:]
        self._buffer_start += drop
        if not made:
            return np.zeros((0, len(self._buffer)), dtype=np.float32)
        return np.concatenate(made)

    def _render_frames(self, start: int, end: int) -> Samples:
        position = np.arange(start, end, dtype=np.int64) * self._step
        before, phase = position // self._frames_per_step, position % self._frames_per_step
        under = np.lib.stride_tricks.sliding_window_view(self._buffer, 2 * self._half, axis=1)
        rows = under[:, before - (self._half - 1) - self._buffer_start]
        found = np.einsum("cnt,nt->cn", rows, self._get_filter_weights(phase))
        return np.ascontiguousarray(found.T, dtype=np.float32)

    def _get_filter_weights(self, phase: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, taps) for phases in 1 / per of a frame."""
        if self._phases == self._frames_per_step:
            return np.asarray(self._table[phase])
        place = phase * (self._phases / self._frames_per_step)
        below = place.astype(np.int64)
        share = (place - below)[:, None]
        return np.asarray(self._table[below] * (1.0 - share) + self._table[below + 1] * share)


def design_polyphase_taps(shift: NDArray[np.float64], half: int, rate_ratio: float) -> NDArray[np.float64]:
    """(n, 2 · half) weights of a frame that lies shift (n,) frames, 0 … 1, behind frame half − 1 of those under the
    filter. share: of the input's rate, what the lower rate is. Each row sums to 1: a constant stays one."""
    width = (STOP_BAND_DB - 7.95) / (14.36 * 2.0 * ZERO_CROSSINGS) * rate_ratio
    cut = 0.5 * rate_ratio - 0.5 * width
    beta = 0.1102 * (STOP_BAND_DB - 8.7)
    away = np.arange(1 - half, half + 1)[None] - shift[:, None]
    window = np.i0(beta * np.sqrt(np.clip(1.0 - np.square(away / half), 0.0, None))) * (np.abs(away) <= half)
    weights = np.sinc(2.0 * cut * away) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


class SignalChain:
    """What a stream sends, block by block. A source of one channel goes to all of the device's.

    ended: the source has given its last frame. nonfinite: values that were no number; they are 0 before any filter
    could remember them. Raises UsageError where source and device have different channels.
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
        # What the device would cut off hard by itself, ours holds back softly, and counts.
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
        """Of the device."""
        return self._device.channels

    @property
    def resampler_name(self) -> str:
        return self._resampler.name

    @property
    def nonfinite(self) -> int:
        return self._nonfinite + self.limiter.nonfinite

    def render_block(self, frames: int) -> Counts:
        """(about frames, channels) counts: as many source frames as last that long, as far as the resampler can tell.
        After the source's end the rest of it, and then none. Raises what the source or a stage raises."""
        if self.ended:
            return np.zeros((0, self._device.channels), dtype=np.int16)
        self._frame_balance += frames * self._source_frames_per_frame
        wanted = max(math.floor(self._frame_balance), 1)
        self._frame_balance -= wanted
        given = self._replace_nonfinite(self._source.read(wanted))
        self.ended = len(given) < wanted
        for stage in self._processors if len(given) else ():
            given = stage.process(given)
        samples = self._resampler.process(given)
        if self.ended:
            samples = np.concatenate([samples, self._resampler.finish()])
        if samples.shape[1] < self._device.channels:
            samples = np.repeat(samples, self._device.channels, axis=1)
        return self.limiter.process(samples)

    def prepare(self) -> None:
        """See source.Preparing."""
        if self._preparable_source is not None and not self.ended:
            self._preparable_source.prepare()

    def _replace_nonfinite(self, block: Samples) -> Samples:
        good = np.isfinite(block)
        if good.all():
            return block
        self._nonfinite += int(good.size - np.count_nonzero(good))
        return np.where(good, block, np.float32(0.0))


def render_counts(
    source: Source,
    device: SinkFormat,
    limits: Limits,
    processors: Sequence[Processor] = (),
    *,
    low_latency: bool = True,
) -> Counts:
    """All that a stream of source sends to device, where coils are cold and nobody pauses: what any sink must have got,
    to the byte. source must end."""
    chain = SignalChain(source, device, limits, processors, low_latency=low_latency)
    blocks: list[Counts] = []
    while not chain.ended:
        blocks.append(chain.render_block(4096))
    return np.concatenate([*blocks, chain.limiter.flush()])
