"""A virtual device on a pty, served in real time by a thread, and a sink that uses it.

Whatever a program can do with a serial port, it can do with `VirtualPort.path`. A `Recording` stores what was played,
frame by frame of the sample clock, and computes the resulting motion of the transducer.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import DeviceError
from ..files import make_run_folder
from .limits import FULL_SCALE_COUNTS
from .runtime import request_realtime_priority
from .serial_protocol import State
from .sink import Counts, SinkFormat
from .sinks.serial import SerialSink
from .virtual_serial_device import Capabilities, VirtualDevice
from .virtual_transducer import GENERIC_TRANSDUCER, Motion, Transducer, counts_to_drive, simulate_motion

CHUNK_FRAMES = 16_384
"""Frames allocated at once; few large arrays, since an hour of small ones would slow Python down."""


@dataclass
class _Chunk:
    """Counts played without a gap since sample clock `clock`; the first `filled` frames of `buffer` are used."""

    clock: int
    buffer: Counts
    filled: int = 0

    @property
    def counts(self) -> Counts:
        return self.buffer[: self.filled]


@dataclass
class Recording:
    """Recorded output of a virtual device: chunks and the sample clocks at which they began, with silence between them.

    May be used from any thread.
    """

    transducer: Transducer = GENERIC_TRANSDUCER
    rate_hz: float = 0.0
    _chunks: list[_Chunk] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def record(self, clock: int, rate_hz: float, counts: Counts) -> None:
        """Append counts (n, channels) played at sample clock `clock` (frames since the device was switched on).

        Earlier counts with another rate or another number of channels are discarded.
        """
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
        """Recorded counts (n, channels), from the first frame that is not silent to the last."""
        with self._lock:
            chunks = [(chunk.clock, chunk.counts.copy()) for chunk in self._chunks]
        if not chunks:
            return np.zeros((0, 1), dtype=np.int16)
        first = chunks[0][0]
        last, tail = chunks[-1]
        out: Counts = np.zeros((last + len(tail) - first, tail.shape[1]), dtype=np.int16)
        for clock, chunk in chunks:
            out[clock - first : clock - first + len(chunk)] = chunk
        loud = np.flatnonzero(out.any(axis=1))
        return out[loud[0] : loud[-1] + 1]

    @property
    def motion(self) -> Motion:
        """Motion of the transducer, initially at rest and cool: acceleration [m/s²], temperature [°C]."""
        return simulate_motion(self.transducer, counts_to_drive(self.counts), self.rate_hz or 1.0)


TICK_S = 0.001
"""Period of the device's thread [s]."""
MAX_CATCH_UP_S = 0.005
"""Longest time played at once [s].

If the computer delays the thread, as never happens to a device, it catches up in steps between which the host can send.
"""

MAX_LAG_S = 0.5
"""Lag that is caught up [s]; beyond it the clock stood still, which is counted."""

READ_BYTES = 65_536
"""Largest read from the pty [bytes]."""
MAX_PENDING_BYTES = 4096
"""Output that waits for a host that does not read [bytes]; more is lost, as on any wire."""

"""Start of the name of a port's folder, followed by the owner's process number."""

WireFilter = Callable[[bytes], bytes]
"""Function that changes bytes on the wire."""


def _pass_through(data: bytes) -> bytes:
    return data


class VirtualPort:
    """A virtual device on a pty; a context manager.

    Parameters
    ----------
    capabilities : Capabilities or None
        Capabilities of the device.
    transducer : Transducer
        Mechanics of the device.
    speed : float
        Speed of its sample clock; 1 = correct.

    Attributes
    ----------
    path : str
        Port for the host; it stays the same when the device is unplugged and plugged in again.
    recording : Recording
        Everything that was played.
    skipped_frames : int
        Frames for which the sample clock stood still because the computer was busy.
    speed, ignores_host, baud, from_host, to_host
        Faults and properties of the wire, which may be changed at any time: speed of the sample clock, whether the
        device stops reading, baud rate at 10 bits a byte (None = as fast as a pty), and filters for the bytes in both
        directions.

    Raises
    ------
    DeviceError
        If the system has no ptys (Windows), or none is free.
    """

    def __init__(
        self,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
    ) -> None:
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
        self.speed, self.ignores_host, self.skipped_frames = 1.0, False, 0
        self.baud: int | None = None
        self.from_host: WireFilter = _pass_through
        self.to_host: WireFilter = _pass_through
        self._folder = make_run_folder("virtual")
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
        """Connect the cable, if it is not connected; raise DeviceError if no pty is free."""
        with self._lock:
            if self._descriptors is not None:
                return
            try:
                device_end, host_end = self._open_pty()
            except OSError as error:
                raise DeviceError(
                    f"the virtual actuator needs a pty, and the system gives none ({error}).",
                    remedy="In a container: mount /dev/pts; or play to a file, or on a real device.",
                ) from error
            # The host's end stays open here too, since a device on a wire does not notice that its host is gone.
            self._set_raw(device_end)
            self._set_raw(host_end)
            os.set_blocking(device_end, False)
            self._descriptors, self._pending = (device_end, host_end), b""
            link = Path(self.path)
            link.unlink(missing_ok=True)
            link.symlink_to(os.ttyname(host_end))

    def unplug(self) -> None:
        """Disconnect the cable; the device has its own power and does not notice."""
        with self._lock:
            self._unplug()

    def close(self) -> None:
        """Switch the device off."""
        self._closing.set()
        self._thread.join(1.0)
        self.unplug()
        self._folder.cleanup()

    @contextmanager
    def freeze_clock(self) -> Iterator[VirtualDevice]:
        """Halt the sample clock in the with block and yield the device, so that everything happens at one frame."""
        with self._lock:
            yield self.device

    def _unplug(self) -> None:
        ends, self._descriptors = self._descriptors, None
        Path(self.path).unlink(missing_ok=True)
        for end in ends or ():
            with suppress(OSError):
                os.close(end)

    def _run(self) -> None:
        request_realtime_priority()  # a real device's clock does not depend on other programs
        frames_due, last = 0.0, time.monotonic()
        while not self._closing.is_set():
            time.sleep(TICK_S)
            with self._lock:
                now = time.monotonic()
                frames_due += (now - last) * self.device.rate_hz * self.speed
                last, excess = now, frames_due - MAX_LAG_S * self.device.rate_hz
                if excess > 0.0:
                    self.skipped_frames += int(excess)
                    frames_due -= excess
                count = min(int(frames_due), int(MAX_CATCH_UP_S * self.device.rate_hz))
                frames_due -= count
                self._receive(count / self.device.rate_hz)
                self.device.advance(count)
                self._transmit()

    def _receive(self, seconds: float) -> None:
        """Read from the host as much as a line of that baud rate carries in `seconds`."""
        if self._descriptors is None or self.ignores_host:
            return
        max_bytes = READ_BYTES
        if self.baud is not None:
            self._budget = min(self._budget + seconds * self.baud / 10.0, 2.0 * MAX_CATCH_UP_S * self.baud / 10.0)
            max_bytes = int(self._budget)
        try:
            data = os.read(self._descriptors[0], max_bytes) if max_bytes else b""
        except BlockingIOError:
            data = b""
        except OSError:
            return
        self._budget -= len(data)
        self.device.receive(self.from_host(data))

    def _transmit(self) -> None:
        data = self._pending + self.to_host(self.device.poll_output())
        if self._descriptors is None or not data:
            self._pending = b""
            return
        try:
            data = data[os.write(self._descriptors[0], data) :]
        except BlockingIOError:
            pass
        except OSError:
            data = b""
        self._pending = data if len(data) <= MAX_PENDING_BYTES else b""


REST_TIMEOUT_S = 0.1
"""Longest wait for the device to become idle [s]."""


class VirtualSink(SerialSink):
    """Sink for a virtual device, with every byte going through a pty as to a real one.

    A device exists from `open` to `close`; `recording`, the output of the last one, remains.

    Parameters
    ----------
    rate_hz, channels, peak, slew_per_s
        As for `SerialSink`.
    """

    def __init__(
        self,
        rate_hz: int | None = None,
        channels: int = 1,
        *,
        peak: int = FULL_SCALE_COUNTS,
        slew_per_s: float = math.inf,
    ) -> None:
        super().__init__("virtual", rate_hz=rate_hz, channels=channels, peak=peak, slew_per_s=slew_per_s)
        self._device: VirtualPort | None = None
        self.recording = Recording(GENERIC_TRANSDUCER)

    def open(self) -> SinkFormat:
        """Create the device and connect to it; raise DeviceError also if the system has no ptys."""
        self.close()
        self._device = VirtualPort()
        self._port, self.recording = self._device.path, self._device.recording
        return self._connect()

    def close(self) -> None:
        """Disconnect and end the device once all is silent."""
        super().close()
        port, self._device = self._device, None
        if port is None:
            return
        deadline = time.monotonic() + REST_TIMEOUT_S
        while port.device.state is not State.IDLE and time.monotonic() < deadline:
            time.sleep(0.001)
        port.close()
