"""A stream on a virtual device, something that goes wrong with it at a known frame, and what came of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from types import TracebackType

import numpy as np

from ..actuators.law import law_of
from ..actuators.limits import Limits
from ..actuators.sinks.serial import SerialSink
from ..actuators.source import Samples
from ..actuators.sources.recorded import Recorded
from ..actuators.stream import Stream
from ..actuators.virtual.device import VirtualDevice
from ..actuators.virtual.port import VirtualPort
from ..errors import HnfError

RATE_HZ = 8000
LIMITS = Limits(30.0, peak=0.5, slew_per_s=2.0 * np.pi * 300.0, sustained=0.4)
LAW = law_of(LIMITS, RATE_HZ)
SILENT_S = 0.02
"""What is promised."""

HANG_S = 5.0
"""Longest that a host may take to notice; nothing waits longer for anything."""

QUIET_S = 0.04
"""Of nothing played, after which nothing owed can be left."""


@dataclass(frozen=True)
class Outcome:
    """silent_s: by the device's sample clock, from the fault (see Since) to the last frame that was no silence.
    messages: that a person gets. noticed_s: from the fault until the host knew, None where it did not. beyond: counts
    past peak or slew. hung: something did not come to its end. not_again: why the stream cannot be started again, or
    "". played_on: the stream was not ended by it."""

    silent_s: float
    messages: tuple[str, ...]
    noticed_s: float | None = None
    beyond: int = 0
    hung: bool = False
    not_again: str = ""
    played_on: bool = False


class Since(Enum):
    """FAULT: nothing gets to the device any more. SAMPLES: the last of them, for the host may send what it still has
    credit for. NOTICE: when the host knew, for until then all goes on."""

    FAULT = 0
    SAMPLES = 1
    NOTICE = 2


class WatchedSink(SerialSink):
    """noticed: the device's clock when it knew of a problem."""

    def __init__(self, port: VirtualPort, channels: int = 1) -> None:
        super().__init__(port.path, rate_hz=RATE_HZ, channels=channels, peak=LAW.peak, slew_per_s=LIMITS.slew_per_s)
        self._watched = port
        self.noticed: int | None = None

    def close(self) -> None:
        if self.noticed is None and self.status().problem:
            self.noticed = self._watched.device.clock
        super().close()


class Rig:
    """One virtual device, and a stream on it. rng: for all that is drawn."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.port = rng, VirtualPort()
        self.sink: WatchedSink | None = None
        self.stream: Stream | None = None
        self._strays: list[str] = []
        self._hook = threading.excepthook

    def __enter__(self) -> Rig:
        threading.excepthook = lambda stray: self._strays.append(f"{stray.exc_type.__name__} in a thread")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.stream is not None:
            self.stream.stop()
        self.port.close()
        threading.excepthook = self._hook

    @property
    def device(self) -> VirtualDevice:
        return self.port.device

    def play(self, channels: int = 1) -> None:
        """A loud stream without an end. Raises DeviceError where it cannot start."""
        self.sink = WatchedSink(self.port, channels)
        self.stream = Stream(Recorded(noise(self.rng, channels), RATE_HZ, loop=True), self.sink, LIMITS)
        self.stream.start()

    def play_for_a_while(self, channels: int = 1) -> None:
        """Until a frame drawn at random, 25 … 250 ms from the start on."""
        self.port.recording.forget()
        self.play(channels)
        self.reach(int(self.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))

    def reach(self, played: int) -> bool:
        """Wait for so many frames of the stream."""
        return until(lambda: self.device.played >= played)

    def strike(self, fault: Callable[[], object]) -> int:
        """Do it between two frames; the clock at the next one."""
        with self.port.standing() as device:
            fault()
            return device.clock

    def ended(self, struck: int, since: Since = Since.FAULT, hang_s: float = HANG_S) -> Outcome:
        """The stream's end by itself. since: what silence is counted from. hang_s: longest to wait for it."""
        assert self.stream is not None
        assert self.sink is not None
        hung = not self.stream.wait(hang_s) or not self.quiet()
        noticed, problem = self.sink.noticed, self.stream.report.problem
        begin = {Since.FAULT: struck, Since.SAMPLES: max(struck, self.device.sampled), Since.NOTICE: noticed or struck}
        return Outcome(
            seconds(self.device.sounded - begin[since]),
            (*((problem,) if problem else ()), *self._strays),
            None if noticed is None else seconds(noticed - struck),
            self.beyond(),
            hung,
        )

    def stopped(self, messages: tuple[str, ...] = ()) -> Outcome:
        """A stream that plays on until it is stopped from here."""
        assert self.stream is not None
        played_on = not self.stream.wait(0.0) and self.reach(self.device.played + RATE_HZ // 20)
        struck = self.device.clock
        self.stream.stop()
        hung = not self.stream.wait(HANG_S) or not self.quiet()
        problem = self.stream.report.problem
        told = (*messages, *((problem,) if problem else ()), *self._strays)
        return Outcome(seconds(self.device.sounded - struck), told, None, self.beyond(), hung, self.again(), played_on)

    def again(self) -> str:
        """A new stream, on the same path, plays; and is stopped. Why not, or nothing."""
        try:
            self.play()
        except HnfError as error:
            return str(error)
        assert self.stream is not None
        plays = self.reach(RATE_HZ // 40)
        self.stream.stop()
        if problem := self.stream.report.problem:
            return problem
        return "" if plays and self.quiet() else "silent, or not silent, for too long"

    def quiet(self) -> bool:
        """Wait until nothing has sounded for a while."""
        return until(lambda: self.device.clock - self.device.sounded > QUIET_S * self.device.rate_hz)

    def beyond(self) -> int:
        """Counts of all that was played that are past peak or slew."""
        counts = self.port.recording.counts.astype(np.int64)
        steps = np.abs(np.diff(counts, axis=0, prepend=0, append=0))
        return int((np.abs(counts) > LAW.peak).sum() + (steps > LAW.step).sum())


def noise(rng: np.random.Generator, channels: int) -> Samples:
    """A second of m/s², loud enough for the limiter: a sine and noise."""
    time_s = np.arange(RATE_HZ)[:, None] / RATE_HZ
    sine = 12.0 * np.sin(2.0 * np.pi * 100.0 * time_s)
    return np.asarray(sine + rng.normal(0.0, 3.0, (RATE_HZ, channels)), dtype=np.float32)


def until(so: Callable[[], bool]) -> bool:
    """Whether it came so within HANG_S."""
    give_up = time.monotonic() + HANG_S
    while not so():
        if time.monotonic() > give_up:
            return False
        time.sleep(0.002)
    return True


def seconds(frames: int) -> float:
    return max(0, frames) / RATE_HZ
