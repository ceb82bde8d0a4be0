"""The actuator as a Player: told command by command to the process that plays, listened to by the window's timer.

Nothing here waits, and no sample passes through Blender's own thread.
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
    Pause,
    Play,
    Ready,
    Refused,
    Report,
    Resume,
    Seek,
    Status,
    Stop,
    Swap,
    Where,
)
from hnf_core.actuators.profile import OWN, ActuatorProfile
from hnf_core.errors import UsageError
from hnf_core.export.wav import write_wav
from hnf_core.material.hnf_file import MaterialFile, write_hnf
from hnf_core.signal import Signal

from .channel import Channel
from .choice import chosen_output
from .sound import Sound

SETTLE_S = 0.2
"""After a seek the positions that are told may still be those of before."""
AGAIN = "Play again to restart it."


@dataclass(frozen=True)
class Heard:
    """What the process told last. at: when, monotonic seconds."""

    status: Status
    at: float


class Link:
    """A Player. One process at a time: begun when something is to be played, ended with release() or by its own
    fault."""

    def __init__(self) -> None:
        self._channel: Channel | None = None
        self._number = self._live_from = 0
        self._forget()

    def _forget(self, problem: str = "") -> None:
        """As with no process."""
        self._channel = None
        self.problem = problem
        """Why nothing plays any more, one sentence; "" = no reason but the end."""
        self.began: Began | None = None
        self.heard: Heard | None = None
        self._sound: Sound | None = None
        self._where: Where | None = None
        self._rest()

    def _rest(self) -> None:
        """Nothing plays, and nothing is to follow."""
        self._playing = self.is_live = self.is_paused = self._swapped = False
        self._next: Sound | None = None
        self._sought_at = float("-inf")

    # ---- Player

    def play(self, sound: Sound) -> None:
        where = where_of(chosen_output(), sound.profile)
        if self._is_opening(where):
            self._next = sound
        elif self._goes_on_as(sound, where):
            self._swap(sound)
            self._tell(Seek(sound.start_s))
            self._sought_at = time.monotonic()
            self.resume()
        else:
            self._begin(sound, where)

    def change(self, sound: Sound) -> None:
        where = where_of(chosen_output(), sound.profile)
        if self._is_opening(where):
            self._next = sound
        elif self._goes_on_as(sound, where):
            self._swap(sound)
        else:
            self._begin(replace(sound, start_s=min(self.position_s, sound.duration_s)), where)

    def stop(self) -> None:
        """Silence, softly; the device is free for others."""
        if self._playing or self.is_live:
            self._tell(Stop())
        self._rest()

    def pause(self) -> None:
        if self.is_sounding and not self.is_live:
            self._tell(Pause())
            self.is_paused = True

    def resume(self) -> None:
        if self.is_paused:
            self._tell(Resume())
        self.is_paused = False

    @property
    def is_playing(self) -> bool:
        return self._playing

    @property
    def is_sounding(self) -> bool:
        return self._playing and self.newest is not None

    @property
    def position_s(self) -> float:
        heard, sound = self.newest, self._sound
        if heard is None or sound is None:
            return 0.0
        now = time.monotonic()
        if now - self._sought_at < SETTLE_S:
            place = sound.start_s + now - self._sought_at
        else:
            place = heard.status.position_s + (now - heard.at if heard.status.state == "playing" else 0.0)
        return place % sound.duration_s if sound.loop and sound.duration_s > 0.0 else min(place, sound.duration_s)

    def release(self) -> None:
        """Silence, and the process leaves; one that does not is killed a second later."""
        channel = self._channel
        self._forget()
        if channel is not None:
            channel.close()

    # ---- live

    def live_begin(self, target: str, profile: ActuatorProfile, probe: str, material: MaterialFile) -> None:
        """A hand is about to touch. Raises HnfError where no process can be started."""
        self._rest()
        self._where, self._probe, self._live_from = where_of(target, profile), probe, self._number + 1
        self.live_material(material)
        self.is_live = True

    def live_material(self, material: MaterialFile) -> None:
        """See live.Feeler."""
        if self._where is None:
            raise UsageError("no live touch is running that could take this material.")
        path = self._file(".hnf")
        self._number += 1
        self._playing, self._sound, self.problem = True, None, ""
        command = LiveBegin(self._number, str(path), self._where, probe=self._probe)
        self._tell(command, partial(write_hnf, path, material))

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """See live.Feeler."""
        if self.is_live:
            self._tell(Move(time_s, *position_m, force_n))

    def live_end(self) -> None:
        if self.is_live:
            self.stop()

    # ---- what was told

    def tick(self) -> bool:
        """Take in what was said; True where there was something. Costs nothing while no process runs."""
        channel = self._channel
        if channel is None:
            return False
        said, end = channel.take()
        for each in said:
            if isinstance(each, str):
                self._fail(each)
            else:
                self._take(each)
        if end and self._channel is channel:
            self._forget(f"The player's process {end}. {AGAIN}")
            channel.close()
        return bool(said or end)

    @property
    def newest(self) -> Heard | None:
        """What was told of the newest play, None where nothing was yet. Under one hand all materials are one play."""
        heard, first = self.heard, self._live_from if self.is_live else self._number
        return heard if heard is not None and heard.status.play >= first else None

    @property
    def is_running(self) -> bool:
        return self._channel is not None

    @property
    def pid(self) -> int | None:
        return None if self._channel is None else self._channel.pid

    @property
    def folder(self) -> Path | None:
        """Where what it plays lies; None where no process runs."""
        return None if self._channel is None else self._channel.folder

    def _take(self, report: Report) -> None:
        if isinstance(report, Ready) and report.version != VERSION:
            self._fail(f"the player speaks version {report.version}, this add-on {VERSION}. Install the add-on again.")
        elif isinstance(report, Began):
            self.began = report
        elif isinstance(report, Refused):
            self._refused(report)
        elif isinstance(report, Status):
            self.heard = Heard(report, time.monotonic())
            if report.play == self._number:
                self._told(report)

    def _told(self, status: Status) -> None:
        """Of the newest play."""
        waiting, self._next = self._next, None
        if status.state == "ended":
            self._playing = self.is_live = False  # a swap may still be answered
            self.problem = status.problem
        if waiting is not None and not status.problem:
            self.play(waiting)

    def _refused(self, report: Refused) -> None:
        if report.play == self._number:
            self._fail(report.why)
        elif report.play < 0 and self._swapped and self._sound is not None and self._where is not None:
            # It ended in the very moment when it was to go on as another sound: that one is begun.
            self._begin(self._sound, self._where)

    def _fail(self, why: str) -> None:
        self._rest()
        self.problem = why

    # ---- what is told

    def _goes_on_as(self, sound: Sound, where: Where) -> bool:
        """Can what plays be exchanged for sound without opening the device anew?"""
        now = self._sound
        same = now is not None and (now.rate, now.loop) == (sound.rate, sound.loop) and self._where == where
        return same and self.is_sounding

    def _is_opening(self, where: Where) -> bool:
        """The device is being taken already: what is asked for meanwhile waits for it, the newest alone."""
        return self._playing and not self.is_live and self.newest is None and self._where == where

    def _begin(self, sound: Sound, where: Where) -> None:
        path, write = self._wav(sound)
        self._rest()
        self._number += 1
        self._playing, self._sound, self._where, self.problem = True, sound, where, ""
        self._tell(Play(self._number, str(path), where, sound.loop, max(sound.start_s, 0.0)), write)

    def _swap(self, sound: Sound) -> None:
        path, write = self._wav(sound)
        self._sound, self._swapped = sound, True
        self._tell(Swap(str(path)), write)

    def _wav(self, sound: Sound) -> tuple[Path, Callable[[], None]]:
        """Where it will lie, and what writes it there."""
        path = self._file(".wav")
        return path, partial(write_wav, path, Signal(sound.samples, sound.rate, seed=0))

    def _file(self, suffix: str) -> Path:
        """Of the process that runs, or is begun. Raises DeviceError where none can be started, FileError where the
        disk refuses."""
        if self._channel is None:
            self._channel = Channel()
        return self._channel.new_file(suffix)

    def _tell(self, command: Command, first: Callable[[], None] | None = None) -> None:
        if self._channel is not None:
            self._channel.tell(command, first)


def where_of(target: str, profile: ActuatorProfile) -> Where:
    """A target and the limits that hold there, as the process is told them."""
    if profile.name != OWN:
        return Where(target, profile.name)
    low, high = profile.range_hz or (0.0, 0.0)
    return Where(target, OWN, (profile.peak_m_s2 or 0.0, low, high))


LINK = Link()
