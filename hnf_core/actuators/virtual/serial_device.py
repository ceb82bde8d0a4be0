"""What a device plays: a short queue, its limits, and the ramps that are its watchdog.

The law is that of tools/firmware/hnf_tick.c, tick by tick: equal counts in, equal counts out.

The device's side of docs/serial-protocol.md, on a sample clock of its own.

What it does to every message is what tools/firmware/hnf_device.c does; time passes by advance() only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import singledispatchmethod

import numpy as np
from numpy.typing import NDArray

from ..limits import FULL_SCALE_COUNTS
from ..serial_protocol import (
    FRAME_TIMEOUT_S,
    FROM_HOST,
    LARGEST_PAYLOAD,
    RAMP_MS,
    VERSION,
    Bye,
    Caps,
    Credit,
    Decoder,
    Encoder,
    Error,
    ErrorCode,
    FromDevice,
    FromHost,
    Hello,
    Ping,
    Pong,
    Samples,
    Start,
    State,
    Status,
    Stop,
)
from ..sink import Counts
from .transducer import GENERIC_TRANSDUCER, Transducer, compute_temperature_after, counts_to_drive

IntArray = NDArray[np.int64]

QUEUE_MS = 15
"""With so much owed at most and ramps of RAMP_MS, silence comes within 20 ms, whatever has happened to the host."""


class PlayoutCommand(Enum):
    """What is wanted: nothing; to play; to play what is there and then rest; to rest now."""

    OFF = 0
    RUN = 1
    DRAIN = 2
    DROP = 3


class PlayoutPhase(Enum):
    QUIET = 0
    SOUNDING = 1
    FADING = 2


@dataclass(frozen=True)
class PlayoutFormat:
    """channels. queue: most frames owed. peak, slew: counts. ramp: frames. step: of a fade, counts a frame."""

    channels: int
    queue: int
    peak: int
    slew: int
    ramp: int

    @property
    def step(self) -> int:
        return -(-self.peak // self.ramp)

    @classmethod
    def from_start(cls, start: Start, queue: int) -> PlayoutFormat:
        return cls(start.channels, queue, start.peak, start.slew, start.rate_hz // 1000 * RAMP_MS)


class Playout:
    """Frames in, what the converter gets out. Its sample clock is what advance() says.

    It begins once half the queue is full, or after a ramp's time with less; as the host's frames are, for they begin
    softly. With nothing left it fades to silence, counts an underrun, and begins again with a soft start of its own, on
    top of what still fades: to wait for that would sound on for 4 ms longer when the host dies just then.
    """

    def __init__(self, form: PlayoutFormat) -> None:
        self.form = form
        self.command, self.phase = PlayoutCommand.RUN, PlayoutPhase.QUIET
        self.played = self.underruns = self.limited = 0
        self._queue: Counts = np.zeros((0, form.channels), dtype=np.int16)
        self._out = np.zeros(form.channels, dtype=np.int64)
        self._fading = np.zeros(form.channels, dtype=np.int64)
        self._fade_in_frames, self._ticks_waited = form.ramp, 0

    @property
    def fill(self) -> int:
        """Frames that are owed."""
        return len(self._queue)

    @property
    def free(self) -> int:
        return self.form.queue - self.fill

    def push(self, counts: Counts) -> None:
        """(n, channels), n at most free."""
        self._queue = np.concatenate([self._queue, counts])

    def advance(self, frames: int) -> Counts:
        """(frames, channels): the next that sound."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        at = 0
        while at < frames:
            self._update_phase()
            if self.phase is PlayoutPhase.SOUNDING:
                at += self._play(out[at:])
            elif self.phase is PlayoutPhase.FADING:
                at += self._fade(out[at:])
            else:
                at += self._wait_ticks(frames - at)
        return out

    def _update_phase(self) -> None:
        """At the beginning of a tick: what the phase is in it."""
        if self.command in (PlayoutCommand.DROP, PlayoutCommand.OFF):
            self._queue = self._queue[:0]
            if self.phase is PlayoutPhase.SOUNDING:
                self._start_fade()
        elif self.phase is PlayoutPhase.SOUNDING:
            if not self.fill:
                self.underruns += self.command is PlayoutCommand.RUN
                self._start_fade()
        elif self.fill and self._can_begin():
            self.phase = PlayoutPhase.SOUNDING

    def _can_begin(self) -> bool:
        if self.command is PlayoutCommand.DRAIN or self.fill >= -(-self.form.queue // 2):
            return True
        self._ticks_waited += 1
        return self._ticks_waited >= self.form.ramp

    def _start_fade(self) -> None:
        self.phase, self._fading, self._fade_in_frames, self._ticks_waited = PlayoutPhase.FADING, self._out.copy(), 0, 0

    def _wait_ticks(self, max_ticks: int) -> int:
        """Of at most so many ticks, those before it may begin; _decide() has had the first."""
        if not self.fill or self.command in (PlayoutCommand.DROP, PlayoutCommand.OFF):
            return max_ticks
        count = min(max_ticks, self.form.ramp - self._ticks_waited)
        self._ticks_waited += count - 1
        return count

    def _play(self, out: Counts) -> int:
        count = min(len(out), self.fill)
        rising = self.form.ramp - self._fade_in_frames
        if rising > 0:
            count = min(count, rising)
            gain = np.arange(self._fade_in_frames + 1, self._fade_in_frames + 1 + count)[:, None]
            product = self._queue[:count].astype(np.int64) * gain
            wanted = np.sign(product) * (np.abs(product) // self.form.ramp)  # towards zero, as C divides
            self._fade_in_frames += count
        else:
            wanted = self._queue[:count].astype(np.int64)
        out[:count] = self._limit(wanted + self._render_fade(count))
        self._out = out[count - 1].astype(np.int64)
        self._queue = self._queue[count:]
        self.played += count
        return count

    def _limit(self, wanted: IntArray) -> IntArray:
        """(n, channels): within peak, and no step larger than slew."""
        found = np.clip(wanted, -self.form.peak, self.form.peak)
        if np.abs(np.diff(found, axis=0, prepend=self._out[None])).max() > self.form.slew:
            before = self._out
            for at, value in enumerate(found):
                before = np.clip(value, before - self.form.slew, before + self.form.slew)
                found[at] = before
        self.limited += int(np.count_nonzero(found != wanted))
        return found

    def _fade(self, out: Counts) -> int:
        left = max(1, -(-int(np.abs(self._fading).max()) // self.form.step))
        count = self._wait_ticks(min(len(out), left))
        out[:count] = self._render_fade(count)
        self._out = self._fading
        if not self._fading.any():
            self.phase = PlayoutPhase.QUIET
        return count

    def _render_fade(self, count: int) -> IntArray:
        """(count, channels): what fades, on its way to silence."""
        down = self.form.step * np.arange(1, count + 1)[:, None]
        found: IntArray = np.sign(self._fading) * np.maximum(np.abs(self._fading) - down, 0)
        self._fading = found[-1]
        return found


CREDIT_HZ = 1000
STATUS_HZ = 10
ERROR_HZ = 10
"""How often the same ERROR is told at most."""

OutputCallback = Callable[[int, float, Counts], None]


@dataclass(frozen=True)
class Capabilities:
    """What CAPS tells. version: that it speaks. hot_c: temperature at which it falls silent."""

    name: str = "virtual actuator"
    channels: int = 16
    lowest_hz: int = 1000
    highest_hz: int = 48_000
    peak: int = FULL_SCALE_COUNTS
    version: int = VERSION
    shutdown_c: float = 120.0


class VirtualDevice:
    """receive() bytes of the host, advance() the sample clock, take() bytes for the host. One thread.

    clock: frames that have passed since it was switched on, at whatever rate. sounded: clock after the last frame that
    was no silence, 0 = none yet. sampled: clock when samples came last. rate_hz: of the stream, before one 8000.
    """

    def __init__(
        self,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        on_output: OutputCallback = lambda clock, rate_hz, counts: None,
    ) -> None:
        """heard: gets every piece that is no silence: the clock at its first frame, the rate, (n, channels) counts."""
        self.capabilities, self.transducer = capabilities or Capabilities(), transducer
        self.clock, self.last_sound_clock, self.last_samples_clock, self.rate_hz = 0, 0, 0, 8000
        self._on_output = on_output
        self._decoder, self._encoder, self._outgoing = Decoder(FROM_HOST), Encoder(), bytearray()
        self._mode, self._next_state = State.IDLE, State.IDLE
        self._playout = Playout(PlayoutFormat(1, 1, FULL_SCALE_COUNTS, FULL_SCALE_COUNTS, 1))
        self._playout.command = PlayoutCommand.OFF
        self._temperature_c, self._squares, self._temperature_clock = np.full(1, transducer.ambient_c), np.zeros(1), 0
        self._session = self._position = self._lost = self._crc_before = 0
        self._has_session = False  # whether the session is of a stream since the last HELLO
        self._last = np.zeros(1, dtype=np.int16)
        self._credit_clock = self._status_clock = self._receive_clock = 0
        self._reported_state, self._status_due = State.IDLE, False
        self._errors: dict[ErrorCode, int] = {}

    @property
    def state(self) -> State:
        if self._mode is not State.PLAYING:
            return self._mode
        if self._playout.command is not PlayoutCommand.RUN:
            return State.STOPPING
        return State.PLAYING if self._playout.phase is PlayoutPhase.SOUNDING else State.WAITING

    @property
    def played(self) -> int:
        """Frames of the stream that have left the queue."""
        return self._playout.played

    @property
    def temperature_c(self) -> float:
        """Of the warmest coil."""
        return float(self._temperature_c.max())

    @property
    def status(self) -> Status:
        damaged = self._decoder.crc_errors - self._crc_before
        tenths = min(int(10.0 * self.temperature_c), 32767)
        out = self._playout
        return Status(out.underruns, damaged, self._lost, out.limited, tenths, self.state)

    def receive(self, data: bytes) -> None:
        """Bytes of the host, as they come."""
        if data:
            self._receive_clock = self.clock
        for message in self._decoder.feed(data):
            self._handle(message)

    def poll_output(self) -> bytes:
        """What it has said since the last time."""
        said, self._outgoing = bytes(self._outgoing), bytearray()
        return said

    def disconnect(self) -> None:
        """The cable is out, or the port was closed, as far as a device can notice that."""
        if self._mode is not State.FAULT:
            self._stop(PlayoutCommand.DROP, State.IDLE)

    def advance(self, frames: int) -> Counts:
        """(frames, channels): the next that sound; what is due is said meanwhile."""
        pieces = [np.zeros((0, self._playout.form.channels), dtype=np.int16)]
        most = max(1, self.rate_hz // CREDIT_HZ)
        while frames > 0:
            count = min(frames, most)
            frames -= count
            pieces.append(self._render(count))
            self._update_state()
        return np.concatenate(pieces)

    def _render(self, frames: int) -> Counts:
        counts = self._playout.advance(frames)
        if counts.any():
            self.last_sound_clock = self.clock + int(np.flatnonzero(counts.any(axis=1))[-1]) + 1
            self._squares += np.square(counts_to_drive(counts)).sum(axis=0)
            self._on_output(self.clock, self.rate_hz, counts)
        self.clock += frames
        return counts

    def _update_temperature(self) -> None:
        """Coils are slow: the mean of what has sounded since the last time is enough."""
        frames = self.clock - self._temperature_clock
        if frames:
            seconds, mean = frames / self.rate_hz, self._squares / frames
            self._temperature_c = compute_temperature_after(
                self.transducer, np.sqrt(mean), seconds, self._temperature_c
            )
        self._temperature_clock, self._squares = self.clock, np.zeros_like(self._temperature_c)

    def _update_state(self) -> None:
        out = self._playout
        if self.clock - self._receive_clock > FRAME_TIMEOUT_S * self.rate_hz:
            for message in self._decoder.flush():
                # Held back behind a damaged length: too old to be played, and not too old to stop.
                if not isinstance(message, Samples):
                    self._handle(message)
        if self.clock - self._temperature_clock >= self.rate_hz // STATUS_HZ:
            self._update_temperature()
        if self.temperature_c >= self.capabilities.shutdown_c and self._mode is State.PLAYING:
            self._send_error(ErrorCode.HOT, "Too hot: let it cool.")
            self._stop(PlayoutCommand.DROP, State.FAULT)
        if self._mode is State.PLAYING:
            if out.command is not PlayoutCommand.RUN and out.phase is PlayoutPhase.QUIET and not out.fill:
                out.command, self._mode = PlayoutCommand.OFF, self._next_state
                self._send_credit()
            elif self.clock - self._credit_clock >= self.rate_hz // CREDIT_HZ:
                self._send_credit()
            self._status_due |= self.clock - self._status_clock >= self.rate_hz // STATUS_HZ
        if self._status_due or self.state is not self._reported_state:
            self._status_clock, self._reported_state, self._status_due = self.clock, self.state, False
            self._send(self.status)

    def _send(self, message: FromDevice) -> None:
        self._outgoing += self._encoder.encode(message)

    def _send_credit(self) -> None:
        self._credit_clock, out = self.clock, self._playout
        self._send(Credit(self._session, out.played & 0xFFFFFFFF, out.form.queue, out.free, self.state))

    def _send_error(self, code: ErrorCode, text: str) -> None:
        told = self._errors.get(code)
        if told is None or self.clock - told >= self.rate_hz // ERROR_HZ:
            self._errors[code] = self.clock
            self._send(Error(code, text))

    def _stop(self, command: PlayoutCommand, next_state: State) -> None:
        """Towards silence; mode `after` once it is reached."""
        if self._mode is not State.PLAYING:
            self._mode = next_state
            return
        # FAULT outranks IDLE, and that READY.
        if self._playout.command is PlayoutCommand.RUN or next_state is State.FAULT or self._next_state is State.READY:
            self._next_state = next_state
        if self._playout.command is not PlayoutCommand.DROP:
            self._playout.command = command

    @singledispatchmethod
    def _handle(self, message: FromHost) -> None:
        raise TypeError(f"a host does not send {message}")

    @_handle.register
    def _(self, hello: Hello) -> None:
        version = self.capabilities.version
        if self._playout.phase is not PlayoutPhase.QUIET:
            self._send_error(ErrorCode.BUSY, "Somebody is playing: stop that first.")
            return
        if not hello.lowest <= version <= hello.highest:
            self._send_error(ErrorCode.VERSION, f"I speak version {version} only: use a host program of that version.")
            return
        out, can = self._playout, self.capabilities
        out.command, self._mode, self._has_session = PlayoutCommand.OFF, State.READY, False
        self._crc_before, self._lost = self._decoder.crc_errors, 0
        out.underruns = out.limited = 0
        self._errors.clear()
        queue, bits = compute_queue_frames(can.highest_hz), 16
        caps = Caps(
            version, can.channels, bits, can.lowest_hz, can.highest_hz, queue, can.peak, LARGEST_PAYLOAD, can.name
        )
        self._send(caps)
        self._status_due = True

    @_handle.register
    def _(self, start: Start) -> None:
        refusal = self._find_start_error(start)
        if refusal is not None:
            self._send_error(*refusal)
            return
        queue = compute_queue_frames(start.rate_hz)
        before, form = self._playout, PlayoutFormat.from_start(start, min(start.queue or queue, queue))
        self._playout = Playout(form)
        self._playout.underruns, self._playout.limited = before.underruns, before.limited
        self._update_temperature()
        if len(self._temperature_c) != start.channels:
            self._temperature_c = np.full(start.channels, self.temperature_c)
        self._squares = np.zeros(start.channels)
        self._last = np.zeros(start.channels, dtype=np.int16)
        self._session, self._position, self.rate_hz = start.session, 0, start.rate_hz
        self._mode, self._has_session = State.PLAYING, True
        self._send_credit()
        self._status_due = True

    def _find_start_error(self, start: Start) -> tuple[ErrorCode, str] | None:
        """Why START cannot be obeyed."""
        can, form = self.capabilities, PlayoutFormat.from_start(start, 1)
        if self._playout.phase is not PlayoutPhase.QUIET:
            return ErrorCode.BUSY, "Stop first."
        if self._mode in (State.IDLE, State.FAULT):
            return ErrorCode.STATE, "Say HELLO first."
        if self.temperature_c >= can.shutdown_c:
            return ErrorCode.HOT, "Too hot: let it cool."
        if not can.lowest_hz <= start.rate_hz <= can.highest_hz:
            return ErrorCode.RATE, "No such rate here: see CAPS."
        if not 1 <= start.channels <= can.channels:
            return ErrorCode.CHANNELS, "Not so many channels here: see CAPS."
        if not 1 <= start.peak <= can.peak:
            return ErrorCode.LIMITS, "The peak is 0 or above that of CAPS."
        if form.step > start.slew:
            return ErrorCode.LIMITS, "With so small a slew silence would take more than 4 ms."
        return None if start.flags == 0 else (ErrorCode.MALFORMED, "Flags are 0 in version 1.")

    @_handle.register
    def _(self, samples: Samples) -> None:
        out = self._playout
        if not self._has_session or samples.session != self._session:
            self._send_error(
                ErrorCode.SESSION, "These samples belong to no stream of mine: another program has the port."
            )
            return
        if self._mode is not State.PLAYING or out.command is not PlayoutCommand.RUN:
            return
        if len(samples.data) % (2 * out.form.channels):
            self._send_error(ErrorCode.MALFORMED, "Half a frame.")
            return
        counts = samples.counts(out.form.channels)
        gap = (samples.position - self._position) & 0xFFFFFFFF
        if gap >= 0x80000000:
            return
        if gap + len(counts) > out.free:
            self._send_error(ErrorCode.OVERRUN, "More than the credit allows: these samples are dropped.")
            return
        ahead = counts[0] if len(counts) else np.zeros_like(self._last)
        whole = np.concatenate([interpolate_gap(self._last, ahead, gap), counts])
        if len(whole):
            self.last_samples_clock = self.clock
            out.push(whole)
            self._last = whole[-1]
        self._lost += gap
        self._position = (self._position + len(whole)) & 0xFFFFFFFF

    @_handle.register
    def _(self, stop: Stop) -> None:
        if self._mode is State.PLAYING:
            self._stop(PlayoutCommand.DRAIN if stop.drain else PlayoutCommand.DROP, State.READY)
        elif self._mode is State.READY:
            self._send_credit()

    @_handle.register
    def _(self, ping: Ping) -> None:
        self._send(Pong(ping.token))
        self._status_due = True

    @_handle.register
    def _(self, bye: Bye) -> None:
        self.disconnect()


def compute_queue_frames(rate_hz: int) -> int:
    """Frames that are owed at most."""
    return rate_hz * QUEUE_MS // 1000


def interpolate_gap(before: Counts, after: Counts, gap: int) -> Counts:
    """before, after: (channels,). gap lost frames between them, as a straight line: (gap, channels)."""
    product = (after.astype(np.int64) - before) * np.arange(1, gap + 1)[:, None]
    found: Counts = (before + np.sign(product) * (np.abs(product) // (gap + 1))).astype(np.int16)
    return found
