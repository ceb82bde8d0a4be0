"""A device with a real clock and no wire, and what every Sink must do: one check for all of them."""

from __future__ import annotations

import time

import numpy as np

from hnf_core.actuators.sink import Counts, Sink, SinkFormat, SinkStatus
from hnf_core.errors import DeviceError


class ClockSink:
    """Plays on the machine's clock from the first write on, into memory. fails_after: frames, then it is unplugged.
    calls: names, in order."""

    def __init__(
        self, rate_hz: float = 10000.0, channels: int = 1, queue_frames: int = 150, *, fails_after: int | None = None
    ) -> None:
        self.format = SinkFormat(rate_hz, channels, queue_frames, f"clock {id(self)}")
        self.written: list[Counts] = []
        self.calls: list[str] = []
        self.fails_after = fails_after
        self._sent = self._underruns = 0
        self._started: float | None = None
        self.is_open = self._finishing = False

    @property
    def counts(self) -> Counts:
        return np.concatenate([np.zeros((0, self.format.channels), np.int16), *self.written])

    def open(self) -> SinkFormat:
        self.calls.append("open")
        if self.is_open:
            raise DeviceError("the clock is taken.", remedy="Close it elsewhere.")
        self.is_open, self._finishing, self._sent, self._underruns, self._started = True, False, 0, 0, None
        return self.format

    def wait(self, timeout_s: float) -> int:
        until = time.perf_counter() + timeout_s
        while (room := self.format.queue_frames - (self._sent - self._played())) <= 0:
            if time.perf_counter() >= until:
                return 0
            time.sleep(0.0005)
        return room

    def write(self, counts: Counts) -> None:
        assert counts.dtype == np.int16
        assert counts.shape[1] == self.format.channels
        if self.fails_after is not None and self._sent + len(counts) > self.fails_after:
            self.close()
            raise DeviceError("the clock has stopped.", remedy="Wind it up.")
        assert len(counts) <= self.format.queue_frames - (self._sent - self._played()), "more than it has room for"
        self.written.append(counts.copy())
        self._sent += len(counts)
        if self._started is None and len(counts):
            self._started = time.perf_counter()

    def status(self) -> SinkStatus:
        return SinkStatus(self._played(), self._underruns)

    def finish(self, timeout_s: float) -> None:
        self.calls.append("finish")
        self._finishing = True  # to run dry is what is wanted now
        until = time.perf_counter() + timeout_s
        while self._played() < self._sent and time.perf_counter() < until:
            time.sleep(0.001)

    def stop(self) -> None:
        self.calls.append("stop")
        self._sent = self._played()

    def close(self) -> None:
        if self.is_open:
            self.stop()
        self.calls.append("close")
        self.is_open = False

    def _played(self) -> int:
        if self._started is None:
            return 0
        played = int((time.perf_counter() - self._started) * self.format.rate_hz)
        if played > self._sent:
            self._underruns += not self._finishing
            self._started = time.perf_counter() - self._sent / self.format.rate_hz
            played = self._sent
        return played


def sine(frames: int, channels: int) -> Counts:
    """(frames, channels) counts, gentle enough for any limit of a device."""
    wave = np.rint(1000.0 * np.sin(0.1 * np.arange(frames)))
    return np.repeat(wave.astype(np.int16)[:, None], channels, axis=1)


def check_sink(sink: Sink) -> None:
    """The contract of hnf_core/actuators/sink.py, as far as a sink that works can show it."""
    for _ in range(2):  # it opens again after close()
        device = sink.open()
        assert device.rate_hz > 0.0
        assert device.channels >= 1
        assert device.queue_frames >= 1
        assert device.device
        room = sink.wait(1.0)
        assert 0 < room <= device.queue_frames, "empty, it has room, and no more than its queue"
        sink.write(sine(0, device.channels))
        sent = 0
        while sent < 3 * device.queue_frames:
            room = sink.wait(1.0)
            assert 0 <= room <= device.queue_frames
            count = min(room, 3 * device.queue_frames - sent)
            sink.write(sine(count, device.channels))
            sent += count
        sink.finish(2.0)
        status = sink.status()
        assert status.problem == ""
        assert status.played >= sent, "finish() plays what is owed"
        sink.stop()
        sink.stop()
        sink.close()
        sink.close()
