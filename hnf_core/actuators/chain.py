"""From a source to counts: stages, rate, limiter. No thread, no device, no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..errors import UsageError
from .limiter import Limiter
from .limits import Limits
from .resample import resampler
from .sink import Counts, SinkFormat
from .source import Preparing, Samples, Source
from .stage import Stage


class Chain:
    """What a stream sends, block by block. A source of one channel goes to all of the device's.

    ended: the source has given its last frame. nonfinite: values that were no number; they are 0 before any filter
    could remember them. Raises UsageError where source and device have different channels.
    """

    def __init__(
        self,
        source: Source,
        device: SinkFormat,
        limits: Limits,
        stages: Sequence[Stage] = (),
        *,
        prompt: bool = True,
        heat: ArrayLike = 0.0,
    ) -> None:
        if source.channels not in (1, device.channels):
            raise UsageError(
                f"the signal has {source.channels} channels and '{device.device}' plays {device.channels}.",
                remedy="Give one channel, or as many as the device has.",
            )
        # What the device would cut off hard by itself, ours holds back softly, and counts.
        self.limiter = Limiter(limits.within(device.peak), device.rate_hz, device.channels, heat=heat)
        self.ended = False
        self._nonfinite = 0
        self._source, self._stages, self._device = source, stages, device
        self._preparing = source if isinstance(source, Preparing) else None
        self._resampler = resampler(source.rate_hz, device.rate_hz, source.channels, prompt=prompt)
        self._per_frame = source.rate_hz / device.rate_hz
        self._owed = 0.0

    @property
    def channels(self) -> int:
        """Of the device."""
        return self._device.channels

    @property
    def resampler(self) -> str:
        return self._resampler.name

    @property
    def nonfinite(self) -> int:
        return self._nonfinite + self.limiter.nonfinite

    def block(self, frames: int) -> Counts:
        """(about frames, channels) counts: as many source frames as last that long, as far as the resampler can tell.
        After the source's end the rest of it, and then none. Raises what the source or a stage raises."""
        if self.ended:
            return np.zeros((0, self._device.channels), dtype=np.int16)
        self._owed += frames * self._per_frame
        wanted = max(math.floor(self._owed), 1)
        self._owed -= wanted
        given = self._finite(self._source.read(wanted))
        self.ended = len(given) < wanted
        for stage in self._stages if len(given) else ():
            given = stage.process(given)
        samples = self._resampler.process(given)
        if self.ended:
            samples = np.concatenate([samples, self._resampler.finish()])
        if samples.shape[1] < self._device.channels:
            samples = np.repeat(samples, self._device.channels, axis=1)
        return self.limiter.process(samples)

    def prepare(self) -> None:
        """See source.Preparing."""
        if self._preparing is not None and not self.ended:
            self._preparing.prepare()

    def _finite(self, block: Samples) -> Samples:
        good = np.isfinite(block)
        if good.all():
            return block
        self._nonfinite += int(good.size - np.count_nonzero(good))
        return np.where(good, block, np.float32(0.0))


def counts_of(
    source: Source, device: SinkFormat, limits: Limits, stages: Sequence[Stage] = (), *, prompt: bool = True
) -> Counts:
    """All that a stream of source sends to device, where coils are cold and nobody pauses: what any sink must have got,
    to the byte. source must end."""
    chain = Chain(source, device, limits, stages, prompt=prompt)
    blocks: list[Counts] = []
    while not chain.ended:
        blocks.append(chain.block(4096))
    return np.concatenate([*blocks, chain.limiter.release()])
