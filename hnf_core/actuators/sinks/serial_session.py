"""The host's view of a serial device, derived from its messages alone: no port, thread or clock of its own.

`SerialSession` takes messages and their times [s] and gives the credit, the status and the first problem.
`ClockRateMonitor` checks the device's frame rate against the host's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ...errors import DeviceError
from ..serial_protocol import NO_TEMPERATURE, Caps, Credit, Error, ErrorCode, Message, State, Status
from ..sink import SinkStatus

RATE_TOLERANCE = 0.03
"""Relative error of the rate that is tolerated: an RC oscillator's worst. A wrong rate (44.1 for 48 kHz) is 8 % off."""

READ_JITTER_S = 0.1
SEGMENT_JITTER_S = 0.01
"""Longest delay of a message when a busy computer reads it [s]: in total (`READ_JITTER_S`), and extra per segment."""

MIN_OBSERVATION_S = 1.0
"""Shortest observation before a rate is judged [s]."""
MAX_OBSERVATION_S = 10.0
"""Observation after which counting starts anew [s]."""
CONFIRMATION_S = 0.5
"""Time for which the rate must be wrong before it is reported [s]."""


@dataclass
class ClockRateMonitor:
    """Estimator of a device's frame rate from the frames that it has played over time.

    Only segments without gaps count, in which the device always had frames to play.
    """

    rate_hz: float
    _segment_start: tuple[float, int] | None = None
    _last: tuple[float, int] = (0.0, 0)
    _seconds: float = 0.0
    _frames: int = 0
    _segments: int = 0
    _wrong_since: float | None = None

    def end_segment(self) -> None:
        """End a segment of uninterrupted playing, when the device had nothing to play."""
        if self._segment_start is not None:
            self._seconds += self._last[0] - self._segment_start[0]
            self._frames += self._last[1] - self._segment_start[1]
            self._segments += 1
            self._segment_start = None

    def update(self, now_s: float, played: int) -> float | None:
        """Add an observation: `played` frames at time `now_s` [s].

        Returns the measured rate [Hz] once it certainly differs from the nominal one, else None.
        """
        self._last = (now_s, played)
        self._segment_start = self._segment_start or self._last
        seconds = self._seconds + now_s - self._segment_start[0]
        if seconds > MAX_OBSERVATION_S:
            self._seconds, self._frames, self._segments = 0.0, 0, 0
            self._segment_start, self._wrong_since = self._last, None
            return None
        if seconds < MIN_OBSERVATION_S:
            return None
        measured = (self._frames + played - self._segment_start[1]) / seconds
        if (
            abs(measured / self.rate_hz - 1.0)
            <= RATE_TOLERANCE + (READ_JITTER_S + SEGMENT_JITTER_S * self._segments) / seconds
        ):
            self._wrong_since = None
            return None
        if self._wrong_since is None:
            self._wrong_since = now_s
        return measured if now_s - self._wrong_since >= CONFIRMATION_S else None


CREDIT_TIMEOUT_S = 0.25
"""Time without a CREDIT after which the device counts as gone [s]; it sends one every 2 ms while it plays."""

MAX_READ_GAP_S = 0.04
"""Longest duration of a read that nothing delays [s]."""

STUCK_TIMEOUT_S = 0.25
"""Longest time that a device may have frames and play none [s]."""

LOSS_WINDOW_S = 1.0
"""Period over which losses are counted [s]."""
MAX_LOSS_SHARE = 0.5
"""Fraction of the frames of `LOSS_WINDOW_S` that may get lost; beyond it the output no longer resembles the signal."""

HARMLESS_CODES = frozenset({ErrorCode.OVERRUN, ErrorCode.MALFORMED})
"""Errors of single messages damaged on the wire: counted, while the stream continues."""

RESTART_REMEDY = "Check its power and its cable, then start again."
"""Remedy for a device that no longer works."""

FOREIGN_HOST_CODES = frozenset({ErrorCode.BUSY, ErrorCode.SESSION})
"""Errors that reply to messages of another host."""


@dataclass
class SerialSession:
    """State of the connection to a device; a fault that ends the stream becomes `problem`, and the first one stays.

    Attributes
    ----------
    port : str
        Port, for messages.
    caps : Caps or None
        Capabilities, once received.
    refusal : Error or None
        Last ERROR.
    credit : Credit or None
        Last CREDIT of this session.
    status : Status or None
        Last STATUS.
    problem : DeviceError or None
        First fault.
    number : int or None
        Number of the session; None without one.
    sent : int
        Frames sent since START.
    played : int
        Frames played since START.
    played_before : int
        Frames played in earlier sessions.
    unanswered_hellos : int
        HELLOs without a reply.
    damaged : int
        Frames that arrived damaged at the host.
    errors : int
        Single messages that the device refused.
    """

    port: str
    caps: Caps | None = None
    refusal: Error | None = None
    credit: Credit | None = None
    status: Status | None = None
    problem: DeviceError | None = None
    number: int | None = None
    sent: int = 0
    played: int = 0
    played_before: int = 0
    unanswered_hellos: int = 0
    damaged: int = 0
    errors: int = 0
    _rate_monitor: ClockRateMonitor = field(default_factory=lambda: ClockRateMonitor(1.0))
    _lost: tuple[float, int, int] = (0.0, 0, 0)
    _last_check_s: float = 0.0
    _silence_s: float = 0.0
    _stuck_s: float = 0.0

    def begin(self, number: int, rate_hz: int, now_s: float) -> None:
        """Begin a session: a START with this number is being sent."""
        self.number, self.credit, self.refusal, self.sent = number, None, None, 0
        self.played_before, self.played = self.played_before + self.played, 0
        self._rate_monitor = ClockRateMonitor(rate_hz)
        self._last_check_s, self._silence_s, self._stuck_s = now_s, 0.0, 0.0
        self._lost = (now_s, 0 if self.status is None else self.status.lost, 0)

    def end(self) -> None:
        """End the session: a STOP is being sent, and later messages are ignored."""
        self.number = self.credit = None

    @property
    def sendable_frames(self) -> int:
        """Number of frames that may be sent now."""
        return max(0, self.credit.compute_sendable_frames(self.sent)) if self.credit is not None else 0

    @property
    def pending_frames(self) -> int:
        """Number of frames sent and, as far as known, not yet played."""
        return self.sent - self.played

    @property
    def is_resting(self) -> bool:
        """True if the device is silent after the end of the stream."""
        return self.credit is not None and self.credit.state in (State.IDLE, State.READY)

    def is_refused_with(self, code: ErrorCode) -> bool:
        return self.refusal is not None and self.refusal.code == code

    @property
    def refusal_text(self) -> str:
        return self.refusal.text if self.refusal is not None else ""

    def handle_messages(self, messages: Sequence[Message], now_s: float) -> None:
        """Process messages that were read together at `now_s` [s]; only the last one's age is known."""
        credits = [credit for credit in messages if isinstance(credit, Credit)]
        for message in messages:
            if isinstance(message, Status):
                self.status = message
                self._check_losses(message.lost, now_s)
            elif isinstance(message, Error):
                self._handle_error(message)
            elif isinstance(message, Caps):
                self.unanswered_hellos -= 1
                if self.number is not None and self.unanswered_hellos < 0:
                    self.fail("the device has restarted, or another program speaks to it too.", RESTART_REMEDY)
                self.caps = message
        if self.number is not None and credits:
            self._handle_credits(credits, now_s)

    def check_timeouts(self, now_s: float) -> None:
        """Check after each read whether the device has been silent or stuck for too long.

        Only time in which this process ran counts: messages that a busy computer has not read in the meantime do not
        mean that the device is silent.
        """
        awake_s, self._last_check_s = min(now_s - self._last_check_s, MAX_READ_GAP_S), now_s
        if self.credit is None:
            return
        self._silence_s += awake_s
        self._stuck_s = self._stuck_s + awake_s if self.pending_frames > 0 else 0.0
        if self._silence_s > CREDIT_TIMEOUT_S:
            self.fail("the device does not answer any more.", RESTART_REMEDY)
        elif self._stuck_s > STUCK_TIMEOUT_S:
            self.fail("the device takes no more samples.", RESTART_REMEDY)

    def fail(self, what: str, remedy: str) -> None:
        """Record a fault that ends the stream; the first one stays."""
        self.problem = self.problem or DeviceError(what, where=self.port, remedy=remedy)

    def to_sink_status(self) -> SinkStatus:
        played, errors, problem = self.played_before + self.played, self.errors + self.damaged, str(self.problem or "")
        device = self.status
        if device is None:
            return SinkStatus(played, 0, errors, None, problem)
        temperature_c = None if device.temperature == NO_TEMPERATURE else device.temperature / 10.0
        damaged = device.crc_errors + device.lost + errors
        return SinkStatus(played, device.underruns, damaged, temperature_c, problem, device.limited)

    def _handle_credits(self, credits: Sequence[Credit], now_s: float) -> None:
        own_credits = [credit for credit in credits if credit.session == self.number]
        if not own_credits:
            # Credits of the previous session may still arrive when a new one has just begun.
            if self.credit is not None:
                self.fail("the device plays for another program.", "Close the other program, then start again.")
            return
        self._silence_s, last = 0.0, own_credits[-1]
        played = self.played + ((last.played - self.played) & 0xFFFFFFFF)
        if played - self.played < 0x80000000:
            if played > self.played:
                self._stuck_s = 0.0
            self.played = played
        self.credit = last
        if self.pending_frames < 0:
            self.fail(
                f"the device says that it has played {-self.pending_frames} frames that it never got.",
                "Update its firmware.",
            )
        if any(credit.state is not State.PLAYING for credit in own_credits):
            self._rate_monitor.end_segment()
        elif (rate := self._rate_monitor.update(now_s, self.played)) is not None:
            self.fail(
                f"the device says {self._rate_monitor.rate_hz:g} Hz and plays at {rate:.0f} Hz.",
                f"Correct the sample clock in its firmware, or ask for {rate:.0f} Hz.",
            )
        if last.state is State.FAULT:
            self.fail(self._describe_refusal(), RESTART_REMEDY)

    def _check_losses(self, lost: int, now_s: float) -> None:
        since_s, lost_before, played_before = self._lost
        if self.number is None or now_s - since_s < LOSS_WINDOW_S:
            return
        if lost - lost_before > MAX_LOSS_SHARE * max(1, self.played - played_before):
            self.fail(
                "most of what is sent is damaged on the way.", "Use a shorter or shielded cable, or a lower rate."
            )
        self._lost = (now_s, lost, self.played)

    def _handle_error(self, message: Error) -> None:
        self.refusal = message
        if self.number is None or (self.credit is None and message.code == ErrorCode.BUSY):
            return
        if self.credit is None or message.code not in HARMLESS_CODES | FOREIGN_HOST_CODES:
            self.fail(self._describe_refusal(), RESTART_REMEDY)
        elif message.code in FOREIGN_HOST_CODES:
            self.fail("another program speaks to the device too.", "Close the other program, then start again.")
        else:
            self.errors += 1

    def _describe_refusal(self) -> str:
        refusal = self.refusal
        if refusal is None:
            return "the device has stopped because of a fault."
        return f"the device refuses: {refusal.text or f'error {refusal.code}.'}"
