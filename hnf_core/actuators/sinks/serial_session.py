"""What the host knows of a device, from its messages alone: no port, no thread, no clock of its own.

Whether a device plays as fast as it says, by the host's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ...errors import DeviceError
from ..serial_protocol import NO_TEMPERATURE, Caps, Credit, Error, ErrorCode, Message, State, Status
from ..sink import SinkStatus

RATE_TOLERANCE = 0.03
"""Share of the rate: an RC oscillator's worst. What has another rate by mistake (44.1 for 48 kHz) is 8 % off."""

READ_JITTER_S = 0.1
SEGMENT_JITTER_S = 0.01
"""By which what a device tells may be old when a busy machine reads it: in all, and for each piece more."""

MIN_OBSERVATION_S = 1.0
MAX_OBSERVATION_S = 10.0
CONFIRMATION_S = 0.5
"""How long it must look wrong."""


@dataclass
class ClockRateMonitor:
    """Told frames played and when, and of every gap in which there was nothing to play: what counts are the pieces
    between."""

    rate_hz: float
    _segment_start: tuple[float, int] | None = None
    _last: tuple[float, int] = (0.0, 0)
    _seconds: float = 0.0
    _frames: int = 0
    _segments: int = 0
    _wrong_since: float | None = None

    def end_segment(self) -> None:
        """It has had nothing to play."""
        if self._segment_start is not None:
            self._seconds += self._last[0] - self._segment_start[0]
            self._frames += self._last[1] - self._segment_start[1]
            self._segments += 1
            self._segment_start = None

    def update(self, now_s: float, played: int) -> float | None:
        """The rate it really has, once that is sure to be another; otherwise None."""
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
"""A device that plays sends a CREDIT every 2 ms; after so long without one it is not there any more."""

MAX_READ_GAP_S = 0.04
"""Longest that a read takes where nothing holds it up."""

STUCK_TIMEOUT_S = 0.25
"""Longest that a device may have frames and play none."""

LOSS_WINDOW_S = 1.0
MAX_LOSS_SHARE = 0.5
"""Share of the frames of so long that may get lost; with more, what is felt is no longer what was sent."""

HARMLESS_CODES = frozenset({ErrorCode.OVERRUN, ErrorCode.MALFORMED})
"""Errors of single messages, damaged on the wire: counted, the stream goes on."""

RESTART_REMEDY = "Check its power and its cable, then start again."

FOREIGN_HOST_CODES = frozenset({ErrorCode.BUSY, ErrorCode.SESSION})
"""Answers to what we did not send."""


@dataclass
class SerialSession:
    """hear() takes messages, fail-safe: what ends the stream becomes problem, and stays the first one.

    caps: once told. credit: the last of this session. sent: frames since START. earlier: frames played in sessions
    before. greetings: HELLOs that are not answered yet. damaged: frames that came damaged; errors: single frames that
    the device refused.
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
        """A START with this session number is sent."""
        self.number, self.credit, self.refusal, self.sent = number, None, None, 0
        self.played_before, self.played = self.played_before + self.played, 0
        self._rate_monitor = ClockRateMonitor(rate_hz)
        self._last_check_s, self._silence_s, self._stuck_s = now_s, 0.0, 0.0
        self._lost = (now_s, 0 if self.status is None else self.status.lost, 0)

    def end(self) -> None:
        """A STOP is sent: whatever comes is history."""
        self.number = self.credit = None

    @property
    def sendable_frames(self) -> int:
        """Frames that may be sent now."""
        return max(0, self.credit.compute_sendable_frames(self.sent)) if self.credit is not None else 0

    @property
    def pending_frames(self) -> int:
        """Frames that were sent and, as far as is known, not played yet."""
        return self.sent - self.played

    @property
    def is_resting(self) -> bool:
        """The device has ended the stream."""
        return self.credit is not None and self.credit.state in (State.IDLE, State.READY)

    def is_refused_with(self, code: ErrorCode) -> bool:
        return self.refusal is not None and self.refusal.code == code

    @property
    def refusal_text(self) -> str:
        return self.refusal.text if self.refusal is not None else ""

    def handle_messages(self, messages: Sequence[Message], now_s: float) -> None:
        """messages: that came together; their age is known of the last only."""
        credits = [found for found in messages if isinstance(found, Credit)]
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
        """Called by who reads, after each read. What a computer that was busy elsewhere did not read in the meantime
        is no silence of the device's: only time in which it was awake counts."""
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
        """The first problem is the one that is told."""
        self.problem = self.problem or DeviceError(what, where=self.port, remedy=remedy)

    def to_sink_status(self) -> SinkStatus:
        played, errors, problem = self.played_before + self.played, self.errors + self.damaged, str(self.problem or "")
        device = self.status
        if device is None:
            return SinkStatus(played, 0, errors, None, problem)
        warm = None if device.temperature == NO_TEMPERATURE else device.temperature / 10.0
        damaged = device.crc_errors + device.lost + errors
        return SinkStatus(played, device.underruns, damaged, warm, problem, device.limited)

    def _handle_credits(self, credits: Sequence[Credit], now_s: float) -> None:
        mine = [found for found in credits if found.session == self.number]
        if not mine:
            # Those of the session before are still on their way when ours has just begun.
            if self.credit is not None:
                self.fail("the device plays for another program.", "Close the other program, then start again.")
            return
        self._silence_s, last = 0.0, mine[-1]
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
        if any(found.state is not State.PLAYING for found in mine):
            self._rate_monitor.end_segment()
        elif (rate := self._rate_monitor.update(now_s, self.played)) is not None:
            self.fail(
                f"the device says {self._rate_monitor.rate_hz:g} Hz and plays at {rate:.0f} Hz.",
                f"Correct the sample clock in its firmware, or ask for {rate:.0f} Hz.",
            )
        if last.state is State.FAULT:
            self.fail(self._describe_refusal(), RESTART_REMEDY)

    def _check_losses(self, lost: int, now_s: float) -> None:
        since_s, before, played = self._lost
        if self.number is None or now_s - since_s < LOSS_WINDOW_S:
            return
        if lost - before > MAX_LOSS_SHARE * max(1, self.played - played):
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
        said = self.refusal
        if said is None:
            return "the device has stopped because of a fault."
        return f"the device refuses: {said.text or f'error {said.code}.'}"
