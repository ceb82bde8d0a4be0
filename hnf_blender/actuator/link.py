"""The actuator as a Player: told line by line to the process that plays, listened to by the window's timer.

Nothing here waits: files are written, lines sent and read by threads of their own. No sample passes through Blender's
own thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hnf_core.actuators.player_messages import (
    VERSION,
    Began,
    Command,
    LiveBegin,
    Move,
    Play,
    Quit,
    Ready,
    Refused,
    Report,
    Seek,
    Status,
    Stop,
    Swap,
    Where,
    decode_report,
    encode,
)
from hnf_core.actuators.profile import OWN, ActuatorProfile
from hnf_core.errors import UsageError
from hnf_core.export.wav import write_wav
from hnf_core.material.hnf_file import MaterialFile, write_hnf
from hnf_core.signal import Signal

from ..jobs.folder import new_folder, remove_folder
from .process import Process, commands
from .sound import Sound
from .worker import UNFIT

PLAYER = "actuators.player"
KEPT_FILES = 32
"""WAVs that may still be read; older ones are removed."""
SETTLE_S = 0.2
"""After a seek the positions that are told may still be those of before."""
AGAIN = "Play again to start it anew."


@dataclass(frozen=True)
class Heard:
    """What the process told last. at: when, monotonic seconds."""

    status: Status
    at: float


class Link:
    """One process at a time; begun when something is to be played, ended with release() or by its own fault."""

    def __init__(self) -> None:
        self.problem = ""
        """Why nothing plays any more, one sentence; "" = no reason but the end."""
        self.began: Began | None = None
        self.heard: Heard | None = None
        self.is_live = False
        self._process: Process | None = None
        self._ways: list[list[str]] = []
        self._folder: Path | None = None
        self._files: list[Path] = []
        self._unanswered: list[tuple[str, Callable[[], None] | None]] = []
        self._number = self._live_from = self._written = 0
        self._playing = False
        self._sound: Sound | None = None
        self._where: Where | None = None
        self._probe = "pen"
        self._sought_at = float("-inf")
        self._swapped = False

    # ---- Player

    def play(self, sound: Sound) -> None:
        from .choice import chosen_output

        where = where_of(chosen_output(), sound.profile)
        if self._goes_on_as(sound, where):
            self._swap(sound)
            self._tell(Seek(sound.start_s))
            self._sought_at = time.monotonic()
        else:
            self._begin(sound, where)

    def change(self, sound: Sound) -> None:
        from .choice import chosen_output

        where = where_of(chosen_output(), sound.profile)
        if self._goes_on_as(sound, where):
            self._swap(sound)
        else:
            self._begin(replace(sound, start_s=min(self.position_s, sound.duration_s)), where)

    def stop(self) -> None:
        """Silence, softly; the device is free for others."""
        if self._process is not None and (self._playing or self.is_live):
            self._tell(Stop())
        self._playing = self.is_live = False

    @property
    def is_playing(self) -> bool:
        return self._playing

    @property
    def is_sounding(self) -> bool:
        return self._playing and self.newest is not None

    @property
    def position_s(self) -> float:
        heard = self.newest
        if heard is None or self._sound is None:
            return 0.0
        now, whole = time.monotonic(), self._sound.duration_s
        if now - self._sought_at < SETTLE_S:
            place = self._sound.start_s + now - self._sought_at
        else:
            place = heard.status.position_s + (now - heard.at if heard.status.state == "playing" else 0.0)
        return place % whole if self._sound.loop and whole > 0.0 else min(place, whole)

    def release(self) -> None:
        """Silence, and the process leaves; one that does not is killed a second later."""
        process, folder = self._process, self._folder
        self._lose("")
        if process is not None:
            process.send(encode(Quit()))
            process.close(then=partial(remove_folder, folder) if folder is not None else lambda: None)

    # ---- live

    def live_begin(self, target: str, profile: ActuatorProfile, probe: str, material: MaterialFile) -> None:
        """A hand is about to touch. Raises HnfError where no process can be started."""
        self._where, self._probe, self.is_live = where_of(target, profile), probe, True
        self._live_from = self._number + 1
        try:
            self.live_material(material)
        except BaseException:
            self.is_live = False
            raise

    def live_material(self, material: MaterialFile) -> None:
        """From now on this is touched."""
        if self._where is None:
            raise UsageError("there is no live touch that this material could be felt in.")
        self._start()
        path = self._new_file(".hnf")
        self._number += 1
        self._playing, self._sound, self.problem = True, None, ""
        command = LiveBegin(self._number, str(path), self._where, probe=self._probe)
        self._tell(command, partial(write_hnf, path, material))

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """See live.Feeler."""
        if self.is_live and self._process is not None:
            self._tell(Move(time_s, *position_m, force_n))

    def live_end(self) -> None:
        if self.is_live:
            self.stop()

    # ---- what the window's timer calls

    def tick(self) -> bool:
        """Take in what was said; True where there was something. Costs nothing while no process runs."""
        process = self._process
        if process is None:
            return False
        code = process.exit_code()  # before its lines are read: what it said last is among them
        for trouble in process.troubles():
            self._fail(trouble)
        told = [self._hear(line) for line in process.lines()]
        if code is not None and self._process is process:
            self._ended(process, code)
            return True
        return any(told)

    @property
    def is_running(self) -> bool:
        return self._process is not None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def folder(self) -> Path | None:
        """Where what it plays lies; None where no process runs."""
        return self._folder

    # ---- inside

    def _goes_on_as(self, sound: Sound, where: Where) -> bool:
        """Can what plays be exchanged for sound without opening the device anew?"""
        now = self._sound
        same = now is not None and (now.rate, now.loop) == (sound.rate, sound.loop) and self._where == where
        return same and self._playing and self.newest is not None

    def _begin(self, sound: Sound, where: Where) -> None:
        self._start()
        path, first = self._wav(sound)
        self._number += 1
        self._playing, self._sound, self._where, self.problem, self.is_live = True, sound, where, "", False
        self._swapped, self._sought_at = False, float("-inf")
        self._tell(Play(self._number, str(path), where, sound.loop, max(sound.start_s, 0.0)), first)

    def _swap(self, sound: Sound) -> None:
        path, first = self._wav(sound)
        self._sound, self._swapped = sound, True
        self._tell(Swap(str(path)), first)

    @property
    def newest(self) -> Heard | None:
        """What was told of the newest play, None where nothing was yet. Under one hand all materials are one play."""
        heard, first = self.heard, self._live_from if self.is_live else self._number
        return heard if heard is not None and heard.status.play >= first else None

    def _start(self) -> None:
        """Raises DeviceError where no process can be started, FileError where the disk refuses."""
        if self._process is not None:
            return
        self._ways = list(commands(PLAYER, ()))
        self._folder = new_folder()
        self._unanswered.clear()
        try:
            self._process = Process(self._ways.pop(0))
        except BaseException:
            remove_folder(self._folder)
            self._folder = None
            raise

    def _tell(self, command: Command, first: Callable[[], None] | None = None) -> None:
        if self._process is None:
            return
        line = encode(command)
        self._unanswered.append((line, first))
        self._process.send(line, first)

    def _wav(self, sound: Sound) -> tuple[Path, Callable[[], None]]:
        """Where it will lie, and what writes it there."""
        path = self._new_file(".wav")
        return path, partial(write_wav, path, Signal(sound.samples, sound.rate, seed=0))

    def _new_file(self, suffix: str) -> Path:
        if self._folder is None:
            raise UsageError("no player runs that could read a file.")
        self._written += 1
        self._files.append(self._folder / f"{self._written}{suffix}")
        while len(self._files) > KEPT_FILES:
            self._files.pop(0).unlink(missing_ok=True)
        return self._files[-1]

    def _hear(self, line: str) -> bool:
        """A line of the process; False where it is none of its messages (a driver's, Blender's)."""
        if not line.startswith("{"):
            return False
        try:
            report = decode_report(line)
        except UsageError as error:
            self._fail(str(error))
            return True
        self._unanswered.clear()
        self._take(report)
        return True

    def _take(self, report: Report) -> None:
        if isinstance(report, Ready) and report.version != VERSION:
            self._fail(f"the player speaks version {report.version}, this add-on {VERSION}. Install the add-on again.")
        elif isinstance(report, Began):
            self.began = report
        elif isinstance(report, Refused):
            self._refused(report)
        elif isinstance(report, Status):
            self.heard = Heard(report, time.monotonic())
            if report.play == self._number and report.state == "ended":
                self._playing = self.is_live = False
                self.problem = report.problem

    def _refused(self, report: Refused) -> None:
        if report.play == self._number:
            self._fail(report.why)
        elif report.play < 0 and self._swapped and not self._playing and self._sound is not None and self._where:
            # It ended in the very moment when it was to go on as another sound: that one is begun.
            self._begin(self._sound, self._where)

    def _fail(self, why: str) -> None:
        self._playing = self.is_live = False
        self.problem = why

    def _ended(self, process: Process, code: int) -> None:
        """The process is gone, and nobody told it to leave."""
        if code == UNFIT and self._ways:
            self._process = Process(self._ways.pop(0))
            for line, first in self._unanswered:
                self._process.send(line, first)
            return
        said = f" ({process.last_line})" if process.last_line else ""
        how = f"was killed (signal {-code})" if code < 0 else f"ended with code {code}"
        folder = self._folder
        self._lose(f"The player's process {how}{said}. {AGAIN}")
        if folder is not None:
            remove_folder(folder)

    def _lose(self, why: str) -> None:
        self._process = self._folder = self._sound = self._where = None
        self.heard = self.began = None
        self._playing = self.is_live = False
        self._files.clear()
        self._unanswered.clear()
        self.problem = why


def where_of(target: str, profile: ActuatorProfile) -> Where:
    """A target and the limits that hold there, as the process is told them."""
    if profile.name != OWN:
        return Where(target, profile.name)
    low, high = profile.range_hz or (0.0, 0.0)
    return Where(target, OWN, (profile.peak_m_s2 or 0.0, low, high))


LINK = Link()
