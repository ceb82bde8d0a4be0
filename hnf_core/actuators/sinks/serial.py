"""Sink for a device on a serial port that speaks the protocol of docs/serial-protocol.md.

`open_port` opens a port exclusively and explains failures; `SerialSink` performs the handshake, sends samples as far as
the device's credit allows, and detects faults.
"""

from __future__ import annotations

import errno
import math
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ...errors import DeviceError, UsageError
from ..limits import FULL_SCALE_COUNTS, compute_max_step
from ..runtime import import_optional, request_realtime_priority
from ..serial_protocol import (
    FROM_DEVICE,
    NO_SLEW_LIMIT,
    RAMP_MS,
    VERSION,
    Bye,
    Caps,
    Decoder,
    Encoder,
    ErrorCode,
    FromHost,
    Hello,
    Samples,
    Start,
    Stop,
    frames_per_message,
)
from ..sink import Counts, SinkFormat, SinkStatus
from .serial_session import RESTART_REMEDY, SerialSession

READ_TIMEOUT_S = 0.02
"""Longest wait of a read for the first byte [s]."""

WRITE_TIMEOUT_S = 0.1
"""Longest wait of a write for a device that does not read [s]."""


def open_port(port: str, baudrate: int) -> Any:
    """Open a port as a `serial.Serial` in raw mode, exclusively, with empty buffers.

    Raises
    ------
    DeviceError
        If there is no such port, another program uses it, or this user may not open it.
    """
    serial = import_optional("serial")
    try:
        opened = serial.Serial(port, baudrate, timeout=READ_TIMEOUT_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise _make_open_error(port, baudrate, error) from error
    except Exception as error:  # termios.error is no OSError, and Windows has no termios
        raise DeviceError(
            f"is no serial port ({error}).", where=port, remedy=f"Choose one of these: {_list_ports()}."
        ) from error
    try:
        opened.reset_input_buffer()
        opened.reset_output_buffer()
    except Exception as error:
        opened.close()
        raise make_disconnected_error(port, error) from error
    return opened


def make_disconnected_error(port: str, error: Exception) -> DeviceError:
    """Make the error of a port whose device was disconnected."""
    reason = _format_reason(error)
    return DeviceError(
        f"the device is gone{'' if 'returned no data' in reason else f' ({reason})'}.",
        where=port,
        remedy="Check cable and power, plug it in again, then start again.",
    )


def _make_open_error(port: str, baudrate: int, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    reason = str(error)
    # On Windows pyserial passes on the reason (no such file, access denied) in the text only.
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in reason:
        return DeviceError(
            "there is no such port.", where=port, remedy=f"Plug the device in, or choose one of these: {_list_ports()}."
        )
    if number in (errno.EAGAIN, errno.EBUSY) or "PermissionError" in reason:
        return DeviceError("another program uses this port.", where=port, remedy=f"Close {_find_port_user(port)}.")
    if number in (errno.EACCES, errno.EPERM):
        return DeviceError(
            "this user may not open the port.",
            where=port,
            remedy="On Linux: sudo usermod -aG dialout $USER (uucp on Arch), then log out and in again.",
        )
    if isinstance(error, ValueError):
        return DeviceError(f"cannot run at {baudrate} baud ({error}).", where=port, remedy="Choose another rate.")
    return DeviceError(
        f"cannot be opened ({_format_reason(error)}).", where=port, remedy=f"Known ports: {_list_ports()}."
    )


def _list_ports() -> str:
    from serial.tools import list_ports

    return ", ".join(sorted(port.device for port in list_ports.comports())) or "none is connected"


def _find_port_user(port: str) -> str:
    """Name the processes that have the port open, as far as Linux shows them."""
    users, device = [], os.path.realpath(port)
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        process = link.parents[1]
        try:
            if os.readlink(link) == device:
                users.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:
            continue
    return " and ".join(sorted(set(users))) or "it (another stream, a serial monitor, a modem manager)"


def _format_reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


CONNECT_S = 10.0
"""Longest wait for a device to answer [s]: opening its port resets many boards, whose bootloader takes seconds."""
BAUDRATE = 3_000_000
"""Usual baud rate of the protocol."""
DEFAULT_RATE_HZ = 8000
"""Frame rate requested if the source states none [Hz]."""
MAX_QUEUE_S = 0.015
"""Longest queue accepted on a device [s]."""
FRAMES_PER_MESSAGE = 32
"""Largest number of frames in one SAMPLES message; small, so that a damaged one is a short gap."""

MAX_STALL_S = 1.0
"""Stall of this program or of the computer that ends the stream [s]; scheduling delays are shorter."""

POLL_S = 0.02
"""Longest sleep between two checks [s]."""
RESEND_S = 0.03
"""Time after which the host's position is sent again [s]."""
HELLO_S, HELLO_BUSY_S, BUSY_S = 0.1, 0.05, 0.5
START_S, START_BUSY_S = 0.2, 0.005
STOP_S = 0.02
"""Timing from docs/serial-protocol.md [s]: repetition of HELLO, START and STOP, and how long to wait for a busy device.
"""


def compute_device_slew(slew_per_s: float, peak: int, rate_hz: int) -> int:
    """Compute the slew limit of a START message [counts per frame].

    It is the limiter's, but at least that of the device's own fades.
    """
    if math.isinf(slew_per_s):
        return NO_SLEW_LIMIT
    fade = -(-peak // max(rate_hz // 1000 * RAMP_MS, 1))
    return max(compute_max_step(slew_per_s, rate_hz), fade)


def _read_boot_clock_s() -> float:
    """Return a monotonic time that includes suspension of the computer [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class SerialSink:
    """Sink for a serial device; a thread reads its messages, so that neither pauses nor a slow caller lose any.

    Parameters
    ----------
    port : str
        Serial port.
    baudrate : int
        Baud rate.
    rate_hz : int or None
        Requested frame rate [Hz]; the device's nearest is used. None requests 8 kHz.
    channels : int
        Number of channels.
    peak : int
        Largest count that the device may play.
    slew_per_s : float
        Largest rate of change that the device may play [full scales per second].
    versions : tuple of int
        Lowest and highest protocol version.
    reply_timeout_s : float
        Longest wait for a device that was just connected [s].
    clock : callable or None
        Returns seconds, counting while the computer is suspended.

    Raises
    ------
    UsageError
        If the number of channels is not within 1–255.
    """

    def __init__(
        self,
        port: str,
        baudrate: int = BAUDRATE,
        rate_hz: int | None = None,
        channels: int = 1,
        *,
        peak: int = FULL_SCALE_COUNTS,
        slew_per_s: float = math.inf,
        versions: tuple[int, int] = (VERSION, VERSION),
        reply_timeout_s: float = CONNECT_S,
        clock: Callable[[], float] | None = None,
    ) -> None:
        if not 1 <= channels <= 255:
            raise UsageError(f"a serial device has 1 to 255 channels, not {channels}.")
        self._port, self._baudrate, self._wanted_hz, self._channels = port, baudrate, rate_hz, channels
        self._peak, self._slew_per_s, self._versions, self._reply_timeout_s = (
            peak,
            slew_per_s,
            versions,
            reply_timeout_s,
        )
        self._clock = clock or _read_boot_clock_s
        self._condition = threading.Condition()
        self._session = SerialSession(port)
        self._serial: Any = None
        self._reader: threading.Thread | None = None
        self._closing = threading.Event()
        self._encoder = Encoder()
        self._rate_hz, self._last_tick_s, self._last_sent_s, self._late_writes = 0, 0.0, 0.0, 0

    def open(self) -> SinkFormat:
        """Open the port and start a session.

        Raises
        ------
        DeviceError
            If the port cannot be opened, nothing replies, or the device lacks a requested capability.
        """
        self.close()
        return self._connect()

    def _connect(self) -> SinkFormat:
        self._session, self._encoder, self._last_tick_s = SerialSession(self._port), Encoder(), self._clock()
        self._serial = open_port(self._port, self._baudrate)
        self._closing.clear()
        self._reader = threading.Thread(target=self._read_loop, name=f"hnf read {self._port}", daemon=True)
        self._reader.start()
        with self._closing_on_error():
            caps = self._handshake()
            self._rate_hz = self._negotiate_rate(caps)
            queue = self._start_session(caps)
        return SinkFormat(float(self._rate_hz), self._channels, queue, caps.name, peak=caps.peak)

    def wait(self, timeout_s: float) -> int:
        """Wait for room in the device's queue; after `stop` or `finish` start a new session."""
        deadline = self._clock() + timeout_s
        with self._closing_on_error():
            self._check_problem()
            if self._session.number is None:
                self._start_session(self._caps)
            while True:
                free_frames, now = self._session.sendable_frames, self._clock()
                if free_frames > 0 or now >= deadline:
                    return free_frames
                # The frames that the device waits for may have been lost, so report the host's position.
                if self._session.pending_frames > 0 and now - self._last_sent_s > RESEND_S:
                    self._last_sent_s = now
                    self._send(Samples(self._session_number, self._session.sent & 0xFFFFFFFF, b""))
                self._condition.wait(min(POLL_S, deadline - now))
                self._check_problem()

    def write(self, counts: Counts) -> None:
        with self._closing_on_error():
            self._check_problem()
            session, max_frames = (
                self._session,
                min(FRAMES_PER_MESSAGE, frames_per_message(self._channels, self._caps.payload)),
            )
            messages = [
                Samples.from_counts(
                    self._session_number, (session.sent + start) & 0xFFFFFFFF, counts[start : start + max_frames]
                )
                for start in range(0, len(counts), max_frames)
            ]
            session.sent += len(counts)
            self._last_sent_s = self._clock()
            self._send(*messages)

    def status(self) -> SinkStatus:
        with self._condition:
            return self._session.to_sink_status()

    def finish(self, timeout_s: float) -> None:
        deadline = self._clock() + timeout_s
        with self._closing_on_error():
            self._check_problem()
            if self._session.number is None:
                return
            last_stop_s = -STOP_S
            while not self._session.is_resting and (now := self._clock()) < deadline:
                if now - last_stop_s >= STOP_S:
                    last_stop_s = now
                    self._send(Stop(drain=True))
                self._condition.wait(POLL_S)
                self._check_problem()
            self._session.end()

    def stop(self) -> None:
        with self._condition:
            self._session.end()
            with suppress(DeviceError):
                self._send(Stop())

    def close(self) -> None:
        with self._condition:
            serial, self._serial = self._serial, None
            self._session.end()
        if serial is None:
            return
        self._closing.set()
        # Closing can take half a minute if the device no longer reads, so unsent bytes are dropped first.
        with suppress(Exception):
            serial.write(self._encoder.encode(Stop()) + self._encoder.encode(Bye()))
            for _ in range(20):
                # Sleep first: a pty reports an empty buffer at once, and resetting it would drop the STOP.
                time.sleep(0.002)
                if not serial.out_waiting:
                    break
        with suppress(Exception):
            serial.reset_output_buffer()
        if self._reader is not None:
            self._reader.join(1.0)
        with suppress(Exception):
            serial.close()

    @property
    def _session_number(self) -> int:
        number = self._session.number
        if number is None:
            raise UsageError("nothing can be written after stop(): call wait() first, which starts again.")
        return number

    def _handshake(self) -> Caps:
        """Repeat HELLO until the device replies.

        Boards restart when their port is opened, and a previous host may just have ended with some milliseconds still
        queued.
        """
        started_s, session = self._clock(), self._session
        while True:
            session.refusal = None
            session.unanswered_hellos += 1
            self._send(Hello(*self._versions))
            self._condition.wait_for(self._has_reply, HELLO_S)
            self._raise_problem()
            if session.caps is not None:
                if self._versions[0] <= session.caps.version <= self._versions[1]:
                    return session.caps
                raise self._make_version_error(f"version {session.caps.version}")
            busy, waited_s = session.is_refused_with(ErrorCode.BUSY), self._clock() - started_s
            if session.is_refused_with(ErrorCode.VERSION):
                raise self._make_version_error(f"'{session.refusal_text}'")
            if busy and waited_s >= BUSY_S:
                raise DeviceError(
                    "the device plays for another program.",
                    where=self._port,
                    remedy="Stop the other stream, then start again.",
                )
            if waited_s >= self._reply_timeout_s:
                raise self._make_no_reply_error()
            if busy:
                self._sleep(HELLO_BUSY_S)

    def _has_reply(self) -> bool:
        session = self._session
        return session.caps is not None or session.refusal is not None or session.problem is not None

    def _make_no_reply_error(self) -> DeviceError:
        return DeviceError(
            "nothing answers there.",
            where=self._port,
            remedy="Check that this is the device's port, that it has power, that its firmware speaks HNF's protocol, "
            f"and that it runs at {self._baudrate} baud.",
        )

    def _make_version_error(self, device_version: str) -> DeviceError:
        low, high = self._versions
        ours = f"version {low}" if low == high else f"versions {low} to {high}"
        return DeviceError(
            f"no version of the protocol in common: this program speaks {ours}, the device says {device_version}.",
            where=self._port,
            remedy="Update the device's firmware, or this program.",
        )

    def _negotiate_rate(self, caps: Caps) -> int:
        if self._channels > caps.channels:
            raise DeviceError(
                f"the device has {caps.channels} channels, not {self._channels}.",
                where=self._port,
                remedy=f"Play at most {caps.channels} channels.",
            )
        return min(max(self._wanted_hz or DEFAULT_RATE_HZ, caps.lowest_hz), caps.highest_hz)

    def _start_session(self, caps: Caps) -> int:
        """Repeat START until the first CREDIT of the session; return the device's queue size [frames]."""
        number, max_queue = secrets.randbelow(0xFFFF) + 1, int(MAX_QUEUE_S * self._rate_hz)
        peak, queue = min(self._peak, caps.peak), min(caps.queue, max_queue)
        slew = compute_device_slew(self._slew_per_s, peak, self._rate_hz)
        session, started_s, timeout_s = self._session, self._clock(), START_S
        while session.credit is None:
            session.begin(number, self._rate_hz, self._clock())
            self._send(Start(self._rate_hz, self._channels, peak, number, slew, queue))
            self._condition.wait_for(self._has_started, timeout_s)
            self._raise_problem()
            busy = session.is_refused_with(ErrorCode.BUSY)
            if session.credit is None and self._clock() - started_s >= (BUSY_S if busy else self._reply_timeout_s):
                raise self._fail("the device does not start.", RESTART_REMEDY)
            if busy:  # a stopped stream still fades out, and the device reports that only once
                timeout_s = START_BUSY_S
                self._sleep(START_BUSY_S)
        credit = session.credit
        if credit.queue > max_queue:
            raise self._fail(
                f"the device would sound on for {1e3 * credit.queue / self._rate_hz:.0f} ms after a fault.",
                f"Its queue may hold {max_queue} frames at most; update its firmware.",
            )
        return credit.queue

    def _has_started(self) -> bool:
        session = self._session
        return session.credit is not None or session.refusal is not None or session.problem is not None

    def _sleep(self, seconds: float) -> None:
        """Sleep with the lock released, so that the reader continues."""
        self._condition.wait_for(lambda: False, seconds)

    @property
    def _caps(self) -> Caps:
        caps = self._session.caps
        if caps is None:
            raise DeviceError("the port is not open.", where=self._port, remedy="Start again.")
        return caps

    @contextmanager
    def _closing_on_error(self) -> Iterator[None]:
        """Hold the lock in the with block; on DeviceError close the port after releasing it.

        The reader thread needs the lock to end.
        """
        try:
            with self._condition:
                yield
        except DeviceError:
            self.close()
            raise

    def _fail(self, what: str, remedy: str) -> DeviceError:
        self._session.fail(what, remedy)
        problem = self._session.problem
        assert problem is not None
        return problem

    def _send(self, *messages: FromHost) -> None:
        """Send messages in one write; raise DeviceError if that fails or takes too long."""
        if self._serial is None:
            raise DeviceError("the port is not open.", where=self._port, remedy="Start again.")
        data = b"".join(self._encoder.encode(message) for message in messages)
        try:
            self._serial.write(data)
            self._late_writes = 0
        except Exception as error:
            if type(error).__name__ != "SerialTimeoutException":
                self._session.problem = self._session.problem or make_disconnected_error(self._port, error)
            else:
                # pyserial also times out if this process was suspended. That is tolerated once, since the device
                # interpolates the lost frames.
                self._late_writes += 1
                if self._late_writes > 1:
                    self._session.fail("the device has stopped reading.", RESTART_REMEDY)
            self._raise_problem()

    def _check_problem(self) -> None:
        """Raise the problem that has occurred since the last check, if any."""
        self._check_stall(self._clock())
        self._raise_problem()

    def _raise_problem(self) -> None:
        if self._session.problem is not None:
            raise self._session.problem

    def _check_stall(self, now: float) -> None:
        stalled_s = now - self._last_tick_s
        if stalled_s > MAX_STALL_S and self._session.number is not None:
            self._session.fail(f"this program, or the computer, stood still for {stalled_s:.1f} s.", "Start again.")

    def _read_loop(self) -> None:
        """Read messages on the reader thread, until `close` or the first problem."""
        request_realtime_priority()
        serial, decoder = self._serial, Decoder(FROM_DEVICE)
        while not self._closing.is_set():
            try:
                data = serial.read(max(1, serial.in_waiting))
            except Exception as error:
                with self._condition:
                    if not self._closing.is_set():
                        self._session.problem = self._session.problem or make_disconnected_error(self._port, error)
                    self._condition.notify_all()
                return
            messages = decoder.feed(data) if data else decoder.flush()
            with self._condition:
                now = self._clock()
                self._check_stall(now)
                self._last_tick_s = now
                self._session.damaged = decoder.crc_errors + decoder.malformed
                self._session.handle_messages(messages, now)
                self._session.check_timeouts(now)
                self._condition.notify_all()
