"""From a source to counts: stages, rate, limiter. No thread, no device, no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..errors import UsageError
from .limiter import Limiter
from .limits import Limits
from .resample import make_resampler
from .sink import Counts, SinkFormat
from .source import PreparableSource, Samples, Source
from .stage import Processor


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
