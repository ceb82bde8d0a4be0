"""A hand from outside: lines of text or OSC messages of a game engine, a tablet or a stylus, for a live touch.

    X Y FORCE [MATERIAL]                                 a place [m] and a force [N]; 0 N lifts
    {"x": X, "y": Y, "force": F, "material": I}          the same as JSON
    {"speed": V, "force": F, "angle": A, "material": I}  a slide [m/s] towards A [rad] that goes on until the next line

    /hnf/touch X Y FORCE [MATERIAL]      /hnf/slide SPEED FORCE [ANGLE [MATERIAL]]      /hnf/lift

Times are those of arrival. MATERIAL counts from 0.
"""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from ..errors import DeviceError, UsageError
from ..field.stroke import LIMITS
from .live_source import LiveSource
from .runtime import import_optional

TOUCH_ADDRESS, SLIDE_ADDRESS, LIFT_ADDRESS = "/hnf/touch", "/hnf/slide", "/hnf/lift"
SLIDE_STEP_S = 0.005
"""Interval at which a slide is continued [s]."""
LOCAL_HOST = "127.0.0.1"
"""Host at which OSC is received unless one is given: only programs of this machine are heard."""
INPUT_FORMS = "osc:PORT, osc:HOST:PORT or - (standard input)"
"""The forms of an input, for messages."""


@dataclass(frozen=True)
class Touch:
    """Hand at a place. x_m, y_m: [m] on the surface. force_n: [N], 0 = lifted. material: its index."""

    x_m: float
    y_m: float
    force_n: float
    material: int = 0


@dataclass(frozen=True)
class Slide:
    """Hand that slides on. speed_m_s: [m/s]. force_n: [N], 0 = lifted. angle_rad: direction. material: its index."""

    speed_m_s: float
    force_n: float
    angle_rad: float = 0.0
    material: int = 0


HandMessage = Touch | Slide


def parse_input(text: str) -> tuple[str, int] | None:
    """Parse `--input`: host and port of OSC, None for standard input; raise UsageError for anything else."""
    if text == "-":
        return None
    match = re.fullmatch(r"osc:(?:(?P<host>[^:]+):)?(?P<port>\d{1,5})", text)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise UsageError(f"--input {text} is no input.", remedy=f"Give {INPUT_FORMS}.")
    return match["host"] or LOCAL_HOST, int(match["port"])


def parse_line(line: str) -> HandMessage | None:
    """Parse a line of text; None for an empty line or a comment (#).

    Raises ValueError, with what is wrong, for a line that says nothing of a hand.
    """
    line = line.partition("#")[0].strip()
    if not line:
        return None
    if line.startswith("{"):
        try:
            record = json.loads(line)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError("it is no JSON object") from error
        needed = ("speed", "force") if "speed" in record else ("x", "y", "force")
        missing = [name for name in needed if name not in record]
        if missing:
            raise ValueError(f"{missing[0]!r} is missing")
        if "speed" in record:
            return _make_slide([record.get(name, 0) for name in (*needed, "angle", "material")])
        return _make_touch([record["x"], record["y"], record["force"], record.get("material", 0)])
    words = [word for word in re.split(r"[\s,;]+", line) if word]
    return _make_touch(words)


def parse_osc(address: str, values: Iterable[Any]) -> HandMessage:
    """Parse an OSC message. Raises ValueError, with what is wrong, for one that says nothing of a hand."""
    if address == TOUCH_ADDRESS:
        return _make_touch(list(values))
    if address == SLIDE_ADDRESS:
        return _make_slide(list(values))
    if address == LIFT_ADDRESS:
        return Slide(0.0, 0.0)
    raise ValueError(f"the address is none of {TOUCH_ADDRESS}, {SLIDE_ADDRESS} and {LIFT_ADDRESS}")


def _make_touch(values: list[Any]) -> Touch:
    if not 3 <= len(values) <= 4:
        raise ValueError("it is not x, y, force and perhaps a material")
    x, y, force = map(_to_number, values[:3])
    return Touch(x, y, force, _to_index(values[3]) if len(values) > 3 else 0)


def _make_slide(values: list[Any]) -> Slide:
    if not 2 <= len(values) <= 4:
        raise ValueError("it is not speed, force and perhaps an angle and a material")
    speed, force, *angle = map(_to_number, values[:3])
    return Slide(speed, force, angle[0] if angle else 0.0, _to_index(values[3]) if len(values) > 3 else 0)


def _to_number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{value!r:.40} is no number") from error
    if isinstance(value, bool) or not math.isfinite(number):
        raise ValueError(f"{value!r:.40} is no number")
    return number


def _to_index(value: Any) -> int:
    number = _to_number(value)
    if number != int(number) or number < 0:
        raise ValueError(f"{value!r:.40} is no number of a material")
    return int(number)


class HandInput:
    """Feeds messages from outside to a live touch.

    Parameters
    ----------
    source : LiveSource
        The live touch.
    on_problem : callable
        Gets the text of the first message that is refused, with what is wrong with it.
    clock : callable
        Returns seconds, as the source's clock.

    Attributes
    ----------
    messages, refused : int
        Number of messages that were taken, and of those that say nothing of a hand.
    """

    def __init__(
        self, source: LiveSource, on_problem: Callable[[str], None], clock: Callable[[], float] = perf_counter
    ) -> None:
        self._source, self._on_problem, self._clock = source, on_problem, clock
        self._lock = threading.Lock()
        self._slide: Slide | None = None
        self._place, self._time = (0.0, 0.0), 0.0
        self.messages = self.refused = 0

    def take(self, message: HandMessage) -> bool:
        """Take a message that arrives now; return False if no hand is there, or no such material."""
        with self._lock:
            self._advance()
            slide = message if isinstance(message, Slide) else None
            place = (message.x_m, message.y_m) if isinstance(message, Touch) else self._place
            is_fast = slide is not None and abs(slide.speed_m_s) > LIMITS["speed [m/s]"][1]
            if is_fast or not self._source.move(self._clock(), place, message.force_n, message.material):
                return False
            self.messages += 1
            self._place = place
            self._slide = slide if message.force_n > 0.0 else None
            return True

    def advance(self) -> None:
        """Continue a slide to the present; call it every SLIDE_STEP_S."""
        with self._lock:
            self._advance()

    def lift(self) -> None:
        """Lift the hand, since nothing more comes; that is no message."""
        with self._lock:
            self._advance()
            self._slide = None
            self._source.move(self._clock(), self._place, 0.0)

    def take_line(self, line: str) -> None:
        """Take a line of text; one that says nothing of a hand is counted, the first is told."""
        self._take_parsed(lambda: parse_line(line), line.strip())

    def take_osc(self, address: str, *values: Any) -> None:
        """Take an OSC message; one that says nothing of a hand is counted, the first is told."""
        self._take_parsed(lambda: parse_osc(address, values), " ".join(map(str, (address, *values))))

    def _advance(self) -> None:
        now, slide = self._clock(), self._slide
        if slide is not None:
            way = slide.speed_m_s * (now - self._time)
            place = (self._place[0] + way * math.cos(slide.angle_rad), self._place[1] + way * math.sin(slide.angle_rad))
            if self._source.move(now, place, slide.force_n, slide.material):
                self._place = place
            else:  # It has slid beyond all surfaces, and stands at their end.
                self._slide = None
        self._time = now

    def _take_parsed(self, parse: Callable[[], HandMessage | None], text: str) -> None:
        try:
            message = parse()
            if message is not None and not self.take(message):
                raise ValueError("place, speed or force is none of a hand, or there is no such material")
        except ValueError as error:
            self.refused += 1
            if self.refused == 1:
                self._on_problem(f"{text[:80]!r} was left out: {error}. Later ones are counted.")


@contextmanager
def receive_osc(hand: HandInput, host: str, port: int) -> Iterator[int]:
    """Feed OSC messages (UDP) to a hand within this context, whose value is the port; port 0 takes a free one.

    Raises DeviceError if the port cannot be had.
    """
    server, dispatcher = import_optional("pythonosc.osc_server"), import_optional("pythonosc.dispatcher").Dispatcher()
    dispatcher.set_default_handler(hand.take_osc)
    try:
        receiver = server.BlockingOSCUDPServer((host, port), dispatcher)
    except OSError as error:
        raise DeviceError(
            f"OSC cannot be received at {host}:{port}: {error.strerror or error}.", remedy="Give another port."
        ) from error
    thread = threading.Thread(target=receiver.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield receiver.server_address[1]
    finally:
        receiver.shutdown()
        receiver.server_close()
        thread.join()


@contextmanager
def read_lines(hand: HandInput, lines: Iterable[str], on_end: Callable[[], None]) -> Iterator[None]:
    """Feed lines of text to a hand within this context; on_end is called after the last, when the hand is lifted."""

    def read() -> None:
        try:
            for line in lines:
                hand.take_line(line)
        finally:
            hand.lift()
            on_end()

    threading.Thread(target=read, daemon=True).start()
    yield
