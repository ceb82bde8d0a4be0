"""A virtual device on a serial port that is none: a pty, served in real time by a thread.

What a virtual device has played, frame by frame of its sample clock, and what a skin would have got of it.

The virtual actuator as a sink of its own: a device, its port and the host's side of the wire in one.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import DeviceError
from ..limits import FULL_SCALE_COUNTS
from ..runtime import request_realtime_priority
from ..serial_protocol import State
from ..sink import Counts, SinkFormat
from ..sinks.serial import SerialSink
from .serial_device import Capabilities, VirtualDevice
from .transducer import GENERIC_TRANSDUCER, Motion, Transducer, counts_to_drive, simulate_motion

CHUNK_FRAMES = 16_384
"""Frames of memory that are taken at once: few and large, for an hour of small pieces would wear out Python."""


@dataclass
class _Chunk:
    """What sounded without a gap from the clock at its first frame on; filled frames of room are used."""

    clock: int
    buffer: Counts
    filled: int = 0

    @property
    def counts(self) -> Counts:
        return self.buffer[: self.filled]


@dataclass
class Recording:
    """Pieces of sound and the clock at which each began; silence is what lies between them. Any thread."""

    transducer: Transducer = GENERIC_TRANSDUCER
    rate_hz: float = 0.0
    _chunks: list[_Chunk] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def record(self, clock: int, rate_hz: float, counts: Counts) -> None:
        """As VirtualDevice tells it. What was played at another rate or on other channels before is forgotten."""
        with self._lock:
            if self._chunks and (rate_hz != self.rate_hz or counts.shape[1] != self._chunks[0].buffer.shape[1]):
                self._chunks.clear()
            self.rate_hz = rate_hz
            last = self._chunks[-1] if self._chunks else None
            if last is None or clock != last.clock + last.filled or last.filled + len(counts) > len(last.buffer):
                last = _Chunk(clock, np.zeros((max(CHUNK_FRAMES, len(counts)), counts.shape[1]), dtype=np.int16))
                self._chunks.append(last)
            last.buffer[last.filled : last.filled + len(counts)] = counts
            last.filled += len(counts)

    def clear(self) -> None:
        with self._lock:
            self._chunks.clear()

    @property
    def counts(self) -> Counts:
        """(n, channels): from the first frame that was no silence to the last, with the silence between them."""
        with self._lock:
            pieces = [(piece.clock, piece.counts.copy()) for piece in self._chunks]
        if not pieces:
            return np.zeros((0, 1), dtype=np.int16)
        first = pieces[0][0]
        last, tail = pieces[-1]
        out: Counts = np.zeros((last + len(tail) - first, tail.shape[1]), dtype=np.int16)
        for clock, piece in pieces:
            out[clock - first : clock - first + len(piece)] = piece
        loud = np.flatnonzero(out.any(axis=1))
        return out[loud[0] : loud[-1] + 1]

    @property
    def motion(self) -> Motion:
        """Of the transducer that was at rest and cool: acceleration in m/s², temperature in °C."""
        return simulate_motion(self.transducer, counts_to_drive(self.counts), self.rate_hz or 1.0)


TICK_S = 0.001
MAX_CATCH_UP_S = 0.005
"""Most that is played at once. A thread that comes later has been kept waiting by the machine, which no device is: it
catches up in steps between which the host can feed it."""

MAX_LAG_S = 0.5
"""What it cannot catch up: its clock has stood still, and that is counted."""

READ_BYTES = 65_536
MAX_PENDING_BYTES = 4096
"""That wait for a host that does not read; more is lost, as on any wire."""

_FOLDER_PREFIX = "hnf-virtual-"
"""Of the folder that a port lies in; then follows whose it is."""

WireFilter = Callable[[bytes], bytes]


def _pass_through(data: bytes) -> bytes:
    return data


class VirtualPort:
    """path: what a host opens; it stays the same when the plug is pulled and put in again. recording: all that was
    played. slipped: frames that the sample clock stood still for want of a machine.

    speed: of its sample clock, 1 = honest. deaf: it does not read. baud: of the line, 10 bits a byte, by the sample
    clock; None: as fast as a pty. from_host, to_host: what the wire does to bytes. All may be changed at any time. A
    context manager.
    """

    def __init__(
        self,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        *,
        speed: float = 1.0,
    ) -> None:
        """Raises DeviceError where the system has no ptys (Windows), or none to give."""
        try:
            import pty
            import tty
        except ImportError as error:
            raise DeviceError(
                "the virtual actuator needs a pty, which this system does not have.",
                remedy="Use it on Linux or macOS; here, play to a file, or on a real device.",
            ) from error
        self._open_pty, self._set_raw = pty.openpty, tty.setraw
        self.recording = Recording(transducer)
        self.device = VirtualDevice(capabilities, transducer, self.recording.record)
        self.speed, self.ignores_host, self.skipped_frames = speed, False, 0
        self.baud: int | None = None
        self.from_host: WireFilter = _pass_through
        self.to_host: WireFilter = _pass_through
        _remove_abandoned()
        self._folder = tempfile.TemporaryDirectory(prefix=f"{_FOLDER_PREFIX}{os.getpid()}-")
        self.path = str(Path(self._folder.name) / "port")
        self._lock = threading.RLock()
        self._descriptors: tuple[int, int] | None = None
        self._pending, self._budget = b"", 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="hnf virtual device", daemon=True)
        try:
            self.plug()
        except DeviceError:
            self._folder.cleanup()
            raise
        self._thread.start()

    def __enter__(self) -> VirtualPort:
        return self

    def __exit__(self, *about: object) -> None:
        self.close()

    def plug(self) -> None:
        """Put the plug in; harmless where it is. Raises DeviceError where there is no pty to be had."""
        with self._lock:
            if self._descriptors is not None:
                return
            try:
                ours, theirs = self._open_pty()
            except OSError as error:
                raise DeviceError(
                    f"the virtual actuator needs a pty, and the system gives none ({error}).",
                    remedy="In a container: mount /dev/pts; or play to a file, or on a real device.",
                ) from error
            # Theirs stays open here too: nothing tells a device on a wire that its host is gone.
            self._set_raw(ours)
            self._set_raw(theirs)
            os.set_blocking(ours, False)
            self._descriptors, self._pending = (ours, theirs), b""
            link = Path(self.path)
            link.unlink(missing_ok=True)
            link.symlink_to(os.ttyname(theirs))

    def unplug(self) -> None:
        """Pull it. The device has power of its own, and is told nothing."""
        with self._lock:
            self._unplug()

    def close(self) -> None:
        """Switch it off."""
        self._closing.set()
        self._thread.join(1.0)
        self.unplug()
        self._folder.cleanup()

    @contextmanager
    def freeze_clock(self) -> Iterator[VirtualDevice]:
        """The device, its sample clock standing still: what is done meanwhile happens at one of its frames."""
        with self._lock:
            yield self.device

    def _unplug(self) -> None:
        ends, self._descriptors = self._descriptors, None
        Path(self.path).unlink(missing_ok=True)
        for end in ends or ():
            with suppress(OSError):
                os.close(end)

    def _run(self) -> None:
        request_realtime_priority()  # a device's clock waits for no other program
        debt, last = 0.0, time.monotonic()
        while not self._closing.is_set():
            time.sleep(TICK_S)
            with self._lock:
                now = time.monotonic()
                debt += (now - last) * self.device.rate_hz * self.speed
                last, lost = now, debt - MAX_LAG_S * self.device.rate_hz
                if lost > 0.0:
                    self.skipped_frames += int(lost)
                    debt -= lost
                due = min(int(debt), int(MAX_CATCH_UP_S * self.device.rate_hz))
                debt -= due
                self._receive(due / self.device.rate_hz)
                self.device.advance(due)
                self._transmit()

    def _receive(self, seconds: float) -> None:
        """To what a line with its baud carries in seconds."""
        if self._descriptors is None or self.ignores_host:
            return
        most = READ_BYTES
        if self.baud is not None:
            self._budget = min(self._budget + seconds * self.baud / 10.0, 2.0 * MAX_CATCH_UP_S * self.baud / 10.0)
            most = int(self._budget)
        try:
            data = os.read(self._descriptors[0], most) if most else b""
        except BlockingIOError:
            data = b""
        except OSError:
            return
        self._budget -= len(data)
        self.device.receive(self.from_host(data))

    def _transmit(self) -> None:
        said = self._pending + self.to_host(self.device.poll_output())
        if self._descriptors is None or not said:
            self._pending = b""
            return
        try:
            said = said[os.write(self._descriptors[0], said) :]
        except BlockingIOError:
            pass
        except OSError:
            said = b""
        self._pending = said if len(said) <= MAX_PENDING_BYTES else b""


def _remove_abandoned() -> None:
    """Folders of processes that were killed: they could not do it themselves."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_FOLDER_PREFIX}*-*"):
        owner = folder.name.removeprefix(_FOLDER_PREFIX).partition("-")[0]
        if owner.isdecimal() and not _is_alive(int(owner)):
            shutil.rmtree(folder, ignore_errors=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


REST_TIMEOUT_S = 0.1


class VirtualSink(SerialSink):
    """See Sink. Every byte goes through a pty, as to a real device. A device lives from open() to close(); recording,
    what the last one played, stays."""

    def __init__(
        self,
        rate_hz: int | None = None,
        channels: int = 1,
        *,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        peak: int = FULL_SCALE_COUNTS,
        slew_per_s: float = math.inf,
    ) -> None:
        """As SerialSink; abilities and transducer: of the device."""
        super().__init__("virtual", rate_hz=rate_hz, channels=channels, peak=peak, slew_per_s=slew_per_s)
        self._capabilities, self._transducer = capabilities, transducer
        self._device: VirtualPort | None = None
        self.recording = Recording(transducer)

    def open(self) -> SinkFormat:
        """See Sink. Raises DeviceError also where the system has no ptys."""
        self.close()
        self._device = VirtualPort(self._capabilities, self._transducer)
        self._port, self.recording = self._device.path, self._device.recording
        return self._connect()

    def close(self) -> None:
        """See Sink. The recording ends when all is silent."""
        super().close()
        port, self._device = self._device, None
        if port is None:
            return
        give_up = time.monotonic() + REST_TIMEOUT_S
        while port.device.state is not State.IDLE and time.monotonic() < give_up:
            time.sleep(0.001)
        port.close()
