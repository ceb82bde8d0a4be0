"""The device's side of docs/serial-protocol.md, on a sample clock of its own.

What it does to every message is what tools/firmware/hnf_device.c does; time passes by advance() only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatchmethod

import numpy as np

from ..limits import COUNTS
from ..protocol.frames import Decoder, Encoder
from ..protocol.messages import (
    FROM_HOST,
    LARGEST_PAYLOAD,
    VERSION,
    Bye,
    Caps,
    Code,
    Credit,
    Error,
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
from .playout import QUEUE_MS, Command, Format, Phase, Playout
from .transducer import GENERIC_TRANSDUCER, Transducer, drive_of, warmed

CREDIT_HZ = 1000
STATUS_HZ = 10
ERROR_HZ = 10
"""How often the same ERROR is told at most."""

QUIET_S = 0.02
"""Without a byte, and a frame that was begun is given up."""

Heard = Callable[[int, float, Counts], None]


@dataclass(frozen=True)
class Abilities:
    """What CAPS tells. version: that it speaks. hot_c: temperature at which it falls silent."""

    name: str = "virtual actuator"
    channels: int = 16
    lowest_hz: int = 1000
    highest_hz: int = 48_000
    peak: int = COUNTS
    version: int = VERSION
    hot_c: float = 120.0


class VirtualDevice:
    """receive() bytes of the host, advance() the sample clock, take() bytes for the host. One thread.

    clock: frames that have passed since it was switched on, at whatever rate. sounded: clock after the last frame that
    was no silence, 0 = none yet. sampled: clock when samples came last. rate_hz: of the stream, before one 8000.
    """

    def __init__(
        self,
        abilities: Abilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        heard: Heard = lambda clock, rate_hz, counts: None,
    ) -> None:
        """heard: gets every piece that is no silence: the clock at its first frame, the rate, (n, channels) counts."""
        self.abilities, self.transducer = abilities or Abilities(), transducer
        self.clock, self.sounded, self.sampled, self.rate_hz = 0, 0, 0, 8000
        self._heard = heard
        self._decoder, self._encoder, self._answer = Decoder(FROM_HOST), Encoder(), bytearray()
        self._mode, self._after = State.IDLE, State.IDLE
        self._playout = Playout(Format(1, 1, COUNTS, COUNTS, 1))
        self._playout.command = Command.OFF
        self._warm, self._squares, self._since = np.full(1, transducer.ambient_c), np.zeros(1), 0
        self._session = self._position = self._lost = self._crc_before = 0
        self._known = False  # whether the session is of a stream since the last HELLO
        self._last = np.zeros(1, dtype=np.int16)
        self._credited = self._told = self._fed = 0
        self._told_state, self._status_due = State.IDLE, False
        self._errors: dict[Code, int] = {}

    @property
    def state(self) -> State:
        if self._mode is not State.PLAYING:
            return self._mode
        if self._playout.command is not Command.RUN:
            return State.STOPPING
        return State.PLAYING if self._playout.phase is Phase.SOUNDING else State.WAITING

    @property
    def played(self) -> int:
        """Frames of the stream that have left the queue."""
        return self._playout.played

    @property
    def temperature_c(self) -> float:
        """Of the warmest coil."""
        return float(self._warm.max())

    @property
    def status(self) -> Status:
        damaged = self._decoder.crc_errors - self._crc_before
        tenths = min(int(10.0 * self.temperature_c), 32767)
        out = self._playout
        return Status(out.underruns, damaged, self._lost, out.limited, tenths, self.state)

    def receive(self, data: bytes) -> None:
        """Bytes of the host, as they come."""
        if data:
            self._fed = self.clock
        for message in self._decoder.feed(data):
            self._obey(message)

    def take(self) -> bytes:
        """What it has said since the last time."""
        said, self._answer = bytes(self._answer), bytearray()
        return said

    def unplugged(self) -> None:
        """The cable is out, or the port was closed, as far as a device can notice that."""
        if self._mode is not State.FAULT:
            self._stop(Command.DROP, State.IDLE)

    def advance(self, frames: int) -> Counts:
        """(frames, channels): the next that sound; what is due is said meanwhile."""
        pieces = [np.zeros((0, self._playout.form.channels), dtype=np.int16)]
        most = max(1, self.rate_hz // CREDIT_HZ)
        while frames > 0:
            count = min(frames, most)
            frames -= count
            pieces.append(self._sound(count))
            self._poll()
        return np.concatenate(pieces)

    def _sound(self, frames: int) -> Counts:
        counts = self._playout.advance(frames)
        if counts.any():
            self.sounded = self.clock + int(np.flatnonzero(counts.any(axis=1))[-1]) + 1
            self._squares += np.square(drive_of(counts)).sum(axis=0)
            self._heard(self.clock, self.rate_hz, counts)
        self.clock += frames
        return counts

    def _warm_up(self) -> None:
        """Coils are slow: the mean of what has sounded since the last time is enough."""
        frames = self.clock - self._since
        if frames:
            seconds, mean = frames / self.rate_hz, self._squares / frames
            self._warm = warmed(self.transducer, np.sqrt(mean), seconds, self._warm)
        self._since, self._squares = self.clock, np.zeros_like(self._warm)

    def _poll(self) -> None:
        out = self._playout
        if self.clock - self._fed > QUIET_S * self.rate_hz:
            for message in self._decoder.idle():
                # Held back behind a damaged length: too old to be played, and not too old to stop.
                if not isinstance(message, Samples):
                    self._obey(message)
        if self.clock - self._since >= self.rate_hz // STATUS_HZ:
            self._warm_up()
        if self.temperature_c >= self.abilities.hot_c and self._mode is State.PLAYING:
            self._complain(Code.HOT, "Too hot: let it cool.")
            self._stop(Command.DROP, State.FAULT)
        if self._mode is State.PLAYING:
            if out.command is not Command.RUN and out.phase is Phase.QUIET and not out.fill:
                out.command, self._mode = Command.OFF, self._after
                self._credit()
            elif self.clock - self._credited >= self.rate_hz // CREDIT_HZ:
                self._credit()
            self._status_due |= self.clock - self._told >= self.rate_hz // STATUS_HZ
        if self._status_due or self.state is not self._told_state:
            self._told, self._told_state, self._status_due = self.clock, self.state, False
            self._say(self.status)

    def _say(self, message: FromDevice) -> None:
        self._answer += self._encoder.encode(message)

    def _credit(self) -> None:
        self._credited, out = self.clock, self._playout
        self._say(Credit(self._session, out.played & 0xFFFFFFFF, out.form.queue, out.free, self.state))

    def _complain(self, code: Code, text: str) -> None:
        told = self._errors.get(code)
        if told is None or self.clock - told >= self.rate_hz // ERROR_HZ:
            self._errors[code] = self.clock
            self._say(Error(code, text))

    def _stop(self, command: Command, after: State) -> None:
        """Towards silence; mode `after` once it is reached."""
        if self._mode is not State.PLAYING:
            self._mode = after
            return
        # FAULT outranks IDLE, and that READY.
        if self._playout.command is Command.RUN or after is State.FAULT or self._after is State.READY:
            self._after = after
        if self._playout.command is not Command.DROP:
            self._playout.command = command

    @singledispatchmethod
    def _obey(self, message: FromHost) -> None:
        raise TypeError(f"a host does not send {message}")

    @_obey.register
    def _(self, hello: Hello) -> None:
        version = self.abilities.version
        if self._playout.phase is not Phase.QUIET:
            self._complain(Code.BUSY, "Somebody is playing: stop that first.")
            return
        if not hello.lowest <= version <= hello.highest:
            self._complain(Code.VERSION, f"I speak version {version} only: use a host program of that version.")
            return
        out, can = self._playout, self.abilities
        out.command, self._mode, self._known = Command.OFF, State.READY, False
        self._crc_before, self._lost = self._decoder.crc_errors, 0
        out.underruns = out.limited = 0
        self._errors.clear()
        queue, bits = queue_of(can.highest_hz), 16
        caps = Caps(
            version, can.channels, bits, can.lowest_hz, can.highest_hz, queue, can.peak, LARGEST_PAYLOAD, can.name
        )
        self._say(caps)
        self._status_due = True

    @_obey.register
    def _(self, start: Start) -> None:
        refusal = self._refusal(start)
        if refusal is not None:
            self._complain(*refusal)
            return
        queue = queue_of(start.rate_hz)
        before, form = self._playout, Format.of(start, min(start.queue or queue, queue))
        self._playout = Playout(form)
        self._playout.underruns, self._playout.limited = before.underruns, before.limited
        self._warm_up()
        if len(self._warm) != start.channels:
            self._warm = np.full(start.channels, self.temperature_c)
        self._squares = np.zeros(start.channels)
        self._last = np.zeros(start.channels, dtype=np.int16)
        self._session, self._position, self.rate_hz = start.session, 0, start.rate_hz
        self._mode, self._known = State.PLAYING, True
        self._credit()
        self._status_due = True

    def _refusal(self, start: Start) -> tuple[Code, str] | None:
        """Why START cannot be obeyed."""
        can, form = self.abilities, Format.of(start, 1)
        if self._playout.phase is not Phase.QUIET:
            return Code.BUSY, "Stop first."
        if self._mode in (State.IDLE, State.FAULT):
            return Code.STATE, "Say HELLO first."
        if self.temperature_c >= can.hot_c:
            return Code.HOT, "Too hot: let it cool."
        if not can.lowest_hz <= start.rate_hz <= can.highest_hz:
            return Code.RATE, "No such rate here: see CAPS."
        if not 1 <= start.channels <= can.channels:
            return Code.CHANNELS, "Not so many channels here: see CAPS."
        if not 1 <= start.peak <= can.peak:
            return Code.LIMITS, "The peak is 0 or above that of CAPS."
        if form.step > start.slew:
            return Code.LIMITS, "With so small a slew silence would take more than 4 ms."
        return None if start.flags == 0 else (Code.MALFORMED, "Flags are 0 in version 1.")

    @_obey.register
    def _(self, samples: Samples) -> None:
        out = self._playout
        if not self._known or samples.session != self._session:
            self._complain(Code.SESSION, "These samples belong to no stream of mine: another program has the port.")
            return
        if self._mode is not State.PLAYING or out.command is not Command.RUN:
            return
        if len(samples.data) % (2 * out.form.channels):
            self._complain(Code.MALFORMED, "Half a frame.")
            return
        counts = samples.counts(out.form.channels)
        gap = (samples.position - self._position) & 0xFFFFFFFF
        if gap >= 0x80000000:
            return
        if gap + len(counts) > out.free:
            self._complain(Code.OVERRUN, "More than the credit allows: these samples are dropped.")
            return
        ahead = counts[0] if len(counts) else np.zeros_like(self._last)
        whole = np.concatenate([bridge(self._last, ahead, gap), counts])
        if len(whole):
            self.sampled = self.clock
            out.push(whole)
            self._last = whole[-1]
        self._lost += gap
        self._position = (self._position + len(whole)) & 0xFFFFFFFF

    @_obey.register
    def _(self, stop: Stop) -> None:
        if self._mode is State.PLAYING:
            self._stop(Command.DRAIN if stop.drain else Command.DROP, State.READY)
        elif self._mode is State.READY:
            self._credit()

    @_obey.register
    def _(self, ping: Ping) -> None:
        self._say(Pong(ping.token))
        self._status_due = True

    @_obey.register
    def _(self, bye: Bye) -> None:
        self.unplugged()


def queue_of(rate_hz: int) -> int:
    """Frames that are owed at most."""
    return rate_hz * QUEUE_MS // 1000


def bridge(before: Counts, after: Counts, gap: int) -> Counts:
    """before, after: (channels,). gap lost frames between them, as a straight line: (gap, channels)."""
    product = (after.astype(np.int64) - before) * np.arange(1, gap + 1)[:, None]
    found: Counts = (before + np.sign(product) * (np.abs(product) // (gap + 1))).astype(np.int16)
    return found
