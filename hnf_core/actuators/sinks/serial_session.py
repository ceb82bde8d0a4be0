"""What the host knows of a device, from its messages alone: no port, no thread, no clock of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ...errors import DeviceError
from ..protocol.messages import NO_TEMPERATURE, Caps, Code, Credit, Error, Message, State, Status
from ..sink import SinkStatus
from .rate_watch import RateWatch

ANSWER_S = 0.25
"""A device that plays sends a CREDIT every 2 ms; after so long without one it is not there any more."""

AWAKE_S = 0.04
"""Longest that a read takes where nothing holds it up."""

STUCK_S = 0.25
"""Longest that a device may have frames and play none."""

NOISE_S = 1.0
NOISE = 0.5
"""Share of the frames of so long that may get lost; with more, what is felt is no longer what was sent."""

HARMLESS = frozenset({Code.OVERRUN, Code.MALFORMED})
"""Errors of single messages, damaged on the wire: counted, the stream goes on."""

RESTART = "Check its power and its cable, then start again."

SOMEBODY_ELSE = frozenset({Code.BUSY, Code.SESSION})
"""Answers to what we did not send."""


@dataclass
class Session:
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
    earlier: int = 0
    greetings: int = 0
    damaged: int = 0
    errors: int = 0
    _watch: RateWatch = field(default_factory=lambda: RateWatch(1.0))
    _lost: tuple[float, int, int] = (0.0, 0, 0)
    _looked_s: float = 0.0
    _unheard_s: float = 0.0
    _unmoved_s: float = 0.0

    def begin(self, number: int, rate_hz: int, now_s: float) -> None:
        """A START with this session number is sent."""
        self.number, self.credit, self.refusal, self.sent = number, None, None, 0
        self.earlier, self.played = self.earlier + self.played, 0
        self._watch = RateWatch(rate_hz)
        self._looked_s, self._unheard_s, self._unmoved_s = now_s, 0.0, 0.0
        self._lost = (now_s, 0 if self.status is None else self.status.lost, 0)

    def end(self) -> None:
        """A STOP is sent: whatever comes is history."""
        self.number = self.credit = None

    @property
    def room(self) -> int:
        """Frames that may be sent now."""
        return max(0, self.credit.room(self.sent)) if self.credit is not None else 0

    @property
    def owed(self) -> int:
        """Frames that were sent and, as far as is known, not played yet."""
        return self.sent - self.played

    @property
    def rests(self) -> bool:
        """The device has ended the stream."""
        return self.credit is not None and self.credit.state in (State.IDLE, State.READY)

    def refused(self, code: Code) -> bool:
        return self.refusal is not None and self.refusal.code == code

    @property
    def refusal_text(self) -> str:
        return self.refusal.text if self.refusal is not None else ""

    def hear(self, messages: Sequence[Message], now_s: float) -> None:
        """messages: that came together; their age is known of the last only."""
        credits = [found for found in messages if isinstance(found, Credit)]
        for message in messages:
            if isinstance(message, Status):
                self.status = message
                self._noisy(message.lost, now_s)
            elif isinstance(message, Error):
                self._refused(message)
            elif isinstance(message, Caps):
                self.greetings -= 1
                if self.number is not None and self.greetings < 0:
                    self.fail("the device has restarted, or another program speaks to it too.", RESTART)
                self.caps = message
        if self.number is not None and credits:
            self._credited(credits, now_s)

    def look(self, now_s: float) -> None:
        """Called by who reads, after each read. What a computer that was busy elsewhere did not read in the meantime
        is no silence of the device's: only time in which it was awake counts."""
        awake_s, self._looked_s = min(now_s - self._looked_s, AWAKE_S), now_s
        if self.credit is None:
            return
        self._unheard_s += awake_s
        self._unmoved_s = self._unmoved_s + awake_s if self.owed > 0 else 0.0
        if self._unheard_s > ANSWER_S:
            self.fail("the device does not answer any more.", RESTART)
        elif self._unmoved_s > STUCK_S:
            self.fail("the device takes no more samples.", RESTART)

    def fail(self, what: str, remedy: str) -> None:
        """The first problem is the one that is told."""
        self.problem = self.problem or DeviceError(what, where=self.port, remedy=remedy)

    def told(self) -> SinkStatus:
        played, errors, problem = self.earlier + self.played, self.errors + self.damaged, str(self.problem or "")
        device = self.status
        if device is None:
            return SinkStatus(played, 0, errors, None, problem)
        warm = None if device.temperature == NO_TEMPERATURE else device.temperature / 10.0
        damaged = device.crc_errors + device.lost + errors
        return SinkStatus(played, device.underruns, damaged, warm, problem, device.limited)

    def _credited(self, credits: Sequence[Credit], now_s: float) -> None:
        mine = [found for found in credits if found.session == self.number]
        if not mine:
            # Those of the session before are still on their way when ours has just begun.
            if self.credit is not None:
                self.fail("the device plays for another program.", "Close the other program, then start again.")
            return
        self._unheard_s, last = 0.0, mine[-1]
        played = self.played + ((last.played - self.played) & 0xFFFFFFFF)
        if played - self.played < 0x80000000:
            if played > self.played:
                self._unmoved_s = 0.0
            self.played = played
        self.credit = last
        if self.owed < 0:
            self.fail(
                f"the device says that it has played {-self.owed} frames that it never got.", "Update its firmware."
            )
        if any(found.state is not State.PLAYING for found in mine):
            self._watch.gap()
        elif (rate := self._watch.note(now_s, self.played)) is not None:
            self.fail(
                f"the device says {self._watch.rate_hz:g} Hz and plays at {rate:.0f} Hz.",
                f"Correct the sample clock in its firmware, or ask for {rate:.0f} Hz.",
            )
        if last.state is State.FAULT:
            self.fail(self._words(), RESTART)

    def _noisy(self, lost: int, now_s: float) -> None:
        since_s, before, played = self._lost
        if self.number is None or now_s - since_s < NOISE_S:
            return
        if lost - before > NOISE * max(1, self.played - played):
            self.fail(
                "most of what is sent is damaged on the way.", "Use a shorter or shielded cable, or a lower rate."
            )
        self._lost = (now_s, lost, self.played)

    def _refused(self, message: Error) -> None:
        self.refusal = message
        if self.number is None or (self.credit is None and message.code == Code.BUSY):
            return
        if self.credit is None or message.code not in HARMLESS | SOMEBODY_ELSE:
            self.fail(self._words(), RESTART)
        elif message.code in SOMEBODY_ELSE:
            self.fail("another program speaks to the device too.", "Close the other program, then start again.")
        else:
            self.errors += 1

    def _words(self) -> str:
        said = self.refusal
        if said is None:
            return "the device has stopped because of a fault."
        return f"the device refuses: {said.text or f'error {said.code}.'}"
