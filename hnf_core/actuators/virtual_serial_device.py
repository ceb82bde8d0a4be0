"""The device's side of docs/serial-protocol.md: bytes in, bytes and counts out, on its own sample clock.

`Playout` is the queue with its limits and fades, equal to tools/firmware/hnf_tick.c tick by tick; `VirtualDevice`
handles messages as tools/firmware/hnf_device.c does. Time passes by `advance` only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import singledispatchmethod

import numpy as np
from numpy.typing import NDArray

from .limits import FULL_SCALE_COUNTS
from .serial_protocol import (
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
from .sink import Counts
from .virtual_transducer import GENERIC_TRANSDUCER, Transducer, compute_temperature_after, counts_to_drive

IntArray = NDArray[np.int64]

QUEUE_MS = 15
"""Longest queue [ms]. With fades of `RAMP_MS`, silence comes within 20 ms whatever happens to the host."""


class PlayoutCommand(Enum):
    """Instruction for the playout: nothing, play, play the queue and then rest, or rest now."""

    OFF = 0
    RUN = 1
    DRAIN = 2
    DROP = 3


class PlayoutPhase(Enum):
    """Current output of the playout: silence, samples, or a fade."""

    QUIET = 0
    SOUNDING = 1
    FADING = 2


@dataclass(frozen=True)
class PlayoutFormat:
    """Format and limits of a playout (the device's queue of frames).

    Attributes
    ----------
    channels : int
        Number of channels.
    queue : int
        Largest number of queued frames.
    peak, slew : int
        Largest magnitude and largest step between frames [counts].
    ramp : int
        Length of a fade [frames].
    """

    channels: int
    queue: int
    peak: int
    slew: int
    ramp: int

    @property
    def step(self) -> int:
        """Largest change of a count per frame during a fade."""
        return -(-self.peak // self.ramp)

    @classmethod
    def from_start(cls, start: Start, queue: int) -> PlayoutFormat:
        return cls(start.channels, queue, start.peak, start.slew, start.rate_hz // 1000 * RAMP_MS)


class Playout:
    """Queue of frames, whose output goes to the digital–analog converter; `advance` is its sample clock.

    It starts once half the queue is full, or with less after the time of a fade, and without a fade-in, since the
    host's frames have one. When the queue runs empty it fades out and counts an underrun. It then restarts with a
    fade-in that overlaps the fade-out: waiting for the fade-out would play 4 ms longer if the host dies at that moment.
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
        """Number of queued frames."""
        return len(self._queue)

    @property
    def free(self) -> int:
        return self.form.queue - self.fill

    def push(self, counts: Counts) -> None:
        """Append (n, channels) counts, n at most `free`."""
        self._queue = np.concatenate([self._queue, counts])

    def advance(self, frames: int) -> Counts:
        """Return the next (frames, channels) counts."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        done = 0
        while done < frames:
            self._update_phase()
            if self.phase is PlayoutPhase.SOUNDING:
                done += self._play(out[done:])
            elif self.phase is PlayoutPhase.FADING:
                done += self._fade(out[done:])
            else:
                done += self._wait_ticks(frames - done)
        return out

    def _update_phase(self) -> None:
        """Determine what is put out (silence, samples or a fade) at the start of a tick, one frame long."""
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
        """Return how many frames, up to `max_ticks`, pass in silence before playback may begin.

        `_update_phase` has counted one already.
        """
        if not self.fill or self.command in (PlayoutCommand.DROP, PlayoutCommand.OFF):
            return max_ticks
        count = min(max_ticks, self.form.ramp - self._ticks_waited)
        self._ticks_waited += count - 1
        return count

    def _play(self, out: Counts) -> int:
        count = min(len(out), self.fill)
        fade_frames_left = self.form.ramp - self._fade_in_frames
        if fade_frames_left > 0:
            count = min(count, fade_frames_left)
            gain = np.arange(self._fade_in_frames + 1, self._fade_in_frames + 1 + count)[:, None]
            product = self._queue[:count].astype(np.int64) * gain
            scaled = np.sign(product) * (
                np.abs(product) // self.form.ramp
            )  # rounds towards zero, as division in C does
            self._fade_in_frames += count
        else:
            scaled = self._queue[:count].astype(np.int64)
        out[:count] = self._limit(scaled + self._render_fade(count))
        self._out = out[count - 1].astype(np.int64)
        self._queue = self._queue[count:]
        self.played += count
        return count

    def _limit(self, wanted: IntArray) -> IntArray:
        """Limit counts (n, channels) to the peak and the slew."""
        limited = np.clip(wanted, -self.form.peak, self.form.peak)
        if np.abs(np.diff(limited, axis=0, prepend=self._out[None])).max() > self.form.slew:
            previous = self._out
            for index, value in enumerate(limited):
                previous = np.clip(value, previous - self.form.slew, previous + self.form.slew)
                limited[index] = previous
        self.limited += int(np.count_nonzero(limited != wanted))
        return limited

    def _fade(self, out: Counts) -> int:
        frames_left = max(1, -(-int(np.abs(self._fading).max()) // self.form.step))
        count = self._wait_ticks(min(len(out), frames_left))
        out[:count] = self._render_fade(count)
        self._out = self._fading
        if not self._fading.any():
            self.phase = PlayoutPhase.QUIET
        return count

    def _render_fade(self, count: int) -> IntArray:
        """Return the next (count, channels) frames of the fade-out."""
        decrease = self.form.step * np.arange(1, count + 1)[:, None]
        fade: IntArray = np.sign(self._fading) * np.maximum(np.abs(self._fading) - decrease, 0)
        self._fading = fade[-1]
        return fade


CREDIT_HZ = 1000
"""Rate of CREDIT messages during a stream [Hz]."""
STATUS_HZ = 10
"""Rate of STATUS messages [Hz]."""
ERROR_HZ = 10
"""Largest rate of the same ERROR [Hz]."""

OutputCallback = Callable[[int, float, Counts], None]
"""Function (sample clock, rate [Hz], (n, channels) counts) called for output that is not silent."""


@dataclass(frozen=True)
class Capabilities:
    """Capabilities reported in CAPS; at `shutdown_c` [°C] the device stops."""

    name: str = "virtual actuator"
    channels: int = 16
    lowest_hz: int = 1000
    highest_hz: int = 48_000
    peak: int = FULL_SCALE_COUNTS
    version: int = VERSION
    shutdown_c: float = 120.0


class VirtualDevice:
    """A device without a port, used by one thread.

    `receive` takes bytes from the host, `advance` moves the sample clock, `poll_output` gives bytes for the host.

    Parameters
    ----------
    capabilities : Capabilities or None
        Reported capabilities.
    transducer : Transducer
        Determines the coil's temperature.
    on_output : OutputCallback
        Called for every block that is not silent.

    Attributes
    ----------
    clock : int
        Frames since it was switched on, at any rate.
    last_sound_clock : int
        Clock after the last frame that was not silent; 0 = none yet.
    last_samples_clock : int
        Clock at which samples arrived last.
    rate_hz : int
        Rate of the stream; 8000 before the first one.
    """

    def __init__(
        self,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        on_output: OutputCallback = lambda clock, rate_hz, counts: None,
    ) -> None:
        self.capabilities, self.transducer = capabilities or Capabilities(), transducer
        self.clock, self.last_sound_clock, self.last_samples_clock, self.rate_hz = 0, 0, 0, 8000
        self._on_output = on_output
        self._decoder, self._encoder, self._outgoing = Decoder(FROM_HOST), Encoder(), bytearray()
        self._mode, self._next_state = State.IDLE, State.IDLE
        self._playout = Playout(PlayoutFormat(1, 1, FULL_SCALE_COUNTS, FULL_SCALE_COUNTS, 1))
        self._playout.command = PlayoutCommand.OFF
        self._temperature_c, self._squares, self._temperature_clock = np.full(1, transducer.ambient_c), np.zeros(1), 0
        self._session = self._position = self._lost = self._crc_before = 0
        self._has_session = False  # True if a stream was started since the last HELLO
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
        """Number of frames of the stream that have left the queue."""
        return self._playout.played

    @property
    def temperature_c(self) -> float:
        """Temperature of the warmest coil [°C]."""
        return float(self._temperature_c.max())

    @property
    def status(self) -> Status:
        damaged = self._decoder.crc_errors - self._crc_before
        tenths = min(int(10.0 * self.temperature_c), 32767)
        playout = self._playout
        return Status(playout.underruns, damaged, self._lost, playout.limited, tenths, self.state)

    def receive(self, data: bytes) -> None:
        """Process bytes from the host."""
        if data:
            self._receive_clock = self.clock
        for message in self._decoder.feed(data):
            self._handle(message)

    def poll_output(self) -> bytes:
        """Return and clear the bytes for the host."""
        data, self._outgoing = bytes(self._outgoing), bytearray()
        return data

    def disconnect(self) -> None:
        """React to a disconnected cable or closed port, as far as a device can notice it."""
        if self._mode is not State.FAULT:
            self._stop(PlayoutCommand.DROP, State.IDLE)

    def advance(self, frames: int) -> Counts:
        """Return the next (frames, channels) counts, and queue the messages that become due."""
        blocks = [np.zeros((0, self._playout.form.channels), dtype=np.int16)]
        max_count = max(1, self.rate_hz // CREDIT_HZ)
        while frames > 0:
            count = min(frames, max_count)
            frames -= count
            blocks.append(self._render(count))
            self._update_state()
        return np.concatenate(blocks)

    def _render(self, frames: int) -> Counts:
        counts = self._playout.advance(frames)
        if counts.any():
            self.last_sound_clock = self.clock + int(np.flatnonzero(counts.any(axis=1))[-1]) + 1
            self._squares += np.square(counts_to_drive(counts)).sum(axis=0)
            self._on_output(self.clock, self.rate_hz, counts)
        self.clock += frames
        return counts

    def _update_temperature(self) -> None:
        """Update the coils' temperature from the mean power since the last update, since coils react slowly."""
        frames = self.clock - self._temperature_clock
        if frames:
            seconds, mean = frames / self.rate_hz, self._squares / frames
            self._temperature_c = compute_temperature_after(
                self.transducer, np.sqrt(mean), seconds, self._temperature_c
            )
        self._temperature_clock, self._squares = self.clock, np.zeros_like(self._temperature_c)

    def _update_state(self) -> None:
        playout = self._playout
        if self.clock - self._receive_clock > FRAME_TIMEOUT_S * self.rate_hz:
            for message in self._decoder.flush():
                # Messages delayed behind a damaged length: samples are too old to play, but a STOP still counts.
                if not isinstance(message, Samples):
                    self._handle(message)
        if self.clock - self._temperature_clock >= self.rate_hz // STATUS_HZ:
            self._update_temperature()
        if self.temperature_c >= self.capabilities.shutdown_c and self._mode is State.PLAYING:
            self._send_error(ErrorCode.HOT, "Too hot: let it cool.")
            self._stop(PlayoutCommand.DROP, State.FAULT)
        if self._mode is State.PLAYING:
            if playout.command is not PlayoutCommand.RUN and playout.phase is PlayoutPhase.QUIET and not playout.fill:
                playout.command, self._mode = PlayoutCommand.OFF, self._next_state
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
        self._credit_clock, playout = self.clock, self._playout
        self._send(Credit(self._session, playout.played & 0xFFFFFFFF, playout.form.queue, playout.free, self.state))

    def _send_error(self, code: ErrorCode, text: str) -> None:
        last_clock = self._errors.get(code)
        if last_clock is None or self.clock - last_clock >= self.rate_hz // ERROR_HZ:
            self._errors[code] = self.clock
            self._send(Error(code, text))

    def _stop(self, command: PlayoutCommand, next_state: State) -> None:
        """Begin to stop; `next_state` applies once it is silent."""
        if self._mode is not State.PLAYING:
            self._mode = next_state
            return
        # FAULT has precedence over IDLE, and IDLE over READY.
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
        """Return why a START is refused, or None."""
        capabilities, playout_format = self.capabilities, PlayoutFormat.from_start(start, 1)
        if self._playout.phase is not PlayoutPhase.QUIET:
            return ErrorCode.BUSY, "Stop first."
        if self._mode in (State.IDLE, State.FAULT):
            return ErrorCode.STATE, "Say HELLO first."
        if self.temperature_c >= capabilities.shutdown_c:
            return ErrorCode.HOT, "Too hot: let it cool."
        if not capabilities.lowest_hz <= start.rate_hz <= capabilities.highest_hz:
            return ErrorCode.RATE, "No such rate here: see CAPS."
        if not 1 <= start.channels <= capabilities.channels:
            return ErrorCode.CHANNELS, "Not so many channels here: see CAPS."
        if not 1 <= start.peak <= capabilities.peak:
            return ErrorCode.LIMITS, "The peak is 0 or above that of CAPS."
        if playout_format.step > start.slew:
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
        filled = np.concatenate([interpolate_gap(self._last, ahead, gap), counts])
        if len(filled):
            self.last_samples_clock = self.clock
            out.push(filled)
            self._last = filled[-1]
        self._lost += gap
        self._position = (self._position + len(filled)) & 0xFFFFFFFF

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
    """Return the largest number of queued frames at `rate_hz`."""
    return rate_hz * QUEUE_MS // 1000


def interpolate_gap(before: Counts, after: Counts, gap: int) -> Counts:
    """Interpolate `gap` lost frames linearly between `before` and `after`, (channels,) each → (gap, channels)."""
    product = (after.astype(np.int64) - before) * np.arange(1, gap + 1)[:, None]
    frames: Counts = (before + np.sign(product) * (np.abs(product) // (gap + 1))).astype(np.int16)
    return frames
