"""The actuator as a Player: told command by command to the process that plays, listened to by the window's timer.

Nothing here waits, and no sample passes through Blender's own thread.

What a Link was told → what the panel says of it.
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
    OutputSpec,
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
)
from hnf_core.actuators.profile import USER_PROFILE_NAME, ActuatorProfile
from hnf_core.errors import UsageError
from hnf_core.export.wav import write_wav
from hnf_core.material.hnf_file import MaterialFile, write_hnf
from hnf_core.signal import Signal

from ..translations import tr
from .actuator_state import ActuatorFacts, Phase, get_selected_output
from .player_process import PlayerProcess
from .sound import Sound

SEEK_SETTLE_S = 0.2
"""After a seek the positions that are told may still be those of before."""
RESTART_HINT = "Play again to restart it."


@dataclass(frozen=True)
class LastStatus:
    """What the process told last. at: when, monotonic seconds."""

    status: Status
    received_s: float


class PlayerClient:
    """A Player. One process at a time: begun when something is to be played, ended with release() or by its own
    fault."""

    def __init__(self) -> None:
        self._process: PlayerProcess | None = None
        self._play_number = self._first_live_number = 0
        self._reset()

    def _reset(self, problem: str = "") -> None:
        """As with no process."""
        self._process = None
        self.problem = problem
        """Why nothing plays any more, one sentence; "" = no reason but the end."""
        self.began: Began | None = None
        self.last_status: LastStatus | None = None
        self._sound: Sound | None = None
        self._output_spec: OutputSpec | None = None
        self._clear_playback()

    def _clear_playback(self) -> None:
        """Nothing plays, and nothing is to follow."""
        self._playing = self.is_live = self.is_paused = self._swapped = False
        self._pending: Sound | None = None
        self._seek_time = float("-inf")

    # ---- Player

    def play(self, sound: Sound) -> None:
        where = make_output_spec(get_selected_output(), sound.profile)
        if self._is_opening(where):
            self._pending = sound
        elif self._can_swap_to(sound, where):
            self._swap(sound)
            self._send(Seek(sound.start_s))
            self._seek_time = time.monotonic()
            self.resume()
        else:
            self._start_playback(sound, where)

    def change(self, sound: Sound) -> None:
        where = make_output_spec(get_selected_output(), sound.profile)
        if self._is_opening(where):
            self._pending = sound
        elif self._can_swap_to(sound, where):
            self._swap(sound)
        else:
            self._start_playback(replace(sound, start_s=min(self.position_s, sound.duration_s)), where)

    def stop(self) -> None:
        """Silence, softly; the device is free for others."""
        if self._playing or self.is_live:
            self._send(Stop())
        self._clear_playback()

    def pause(self) -> None:
        if self.is_sounding and not self.is_live:
            self._send(Pause())
            self.is_paused = True

    def resume(self) -> None:
        if self.is_paused:
            self._send(Resume())
        self.is_paused = False

    @property
    def is_playing(self) -> bool:
        return self._playing

    @property
    def is_sounding(self) -> bool:
        return self._playing and self.current_status is not None

    @property
    def position_s(self) -> float:
        heard, sound = self.current_status, self._sound
        if heard is None or sound is None:
            return 0.0
        now = time.monotonic()
        if now - self._seek_time < SEEK_SETTLE_S:
            place = sound.start_s + now - self._seek_time
        else:
            place = heard.status.position_s + (now - heard.received_s if heard.status.state == "playing" else 0.0)
        return place % sound.duration_s if sound.loop and sound.duration_s > 0.0 else min(place, sound.duration_s)

    def release(self) -> None:
        """Silence, and the process leaves; one that does not is killed a second later."""
        channel = self._process
        self._reset()
        if channel is not None:
            channel.close()

    # ---- live

    def live_begin(self, target: str, profile: ActuatorProfile, probe: str, material: MaterialFile) -> None:
        """A hand is about to touch. Raises HnfError where no process can be started."""
        self._clear_playback()
        self._output_spec, self._probe, self._first_live_number = (
            make_output_spec(target, profile),
            probe,
            self._play_number + 1,
        )
        self.live_material(material)
        self.is_live = True

    def live_material(self, material: MaterialFile) -> None:
        """See live.Feeler."""
        if self._output_spec is None:
            raise UsageError("no live touch is running that could take this material.")
        path = self._new_file(".hnf")
        self._play_number += 1
        self._playing, self._sound, self.problem = True, None, ""
        command = LiveBegin(self._play_number, str(path), self._output_spec, probe=self._probe)
        self._send(command, partial(write_hnf, path, material))

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """See live.Feeler."""
        if self.is_live:
            self._send(Move(time_s, *position_m, force_n))

    def live_end(self) -> None:
        if self.is_live:
            self.stop()

    # ---- what was told

    def tick(self) -> bool:
        """Take in what was said; True where there was something. Costs nothing while no process runs."""
        channel = self._process
        if channel is None:
            return False
        said, end = channel.poll()
        for each in said:
            if isinstance(each, str):
                self._fail(each)
            else:
                self._on_report(each)
        if end and self._process is channel:
            self._reset(f"The player's process {end}. {RESTART_HINT}")
            channel.close()
        return bool(said or end)

    @property
    def current_status(self) -> LastStatus | None:
        """What was told of the newest play, None where nothing was yet. Under one hand all materials are one play."""
        heard, first = self.last_status, self._first_live_number if self.is_live else self._play_number
        return heard if heard is not None and heard.status.play >= first else None

    @property
    def is_running(self) -> bool:
        return self._process is not None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def folder(self) -> Path | None:
        """Where what it plays lies; None where no process runs."""
        return None if self._process is None else self._process.folder

    def _on_report(self, report: Report) -> None:
        if isinstance(report, Ready) and report.version != VERSION:
            self._fail(f"the player speaks version {report.version}, this add-on {VERSION}. Install the add-on again.")
        elif isinstance(report, Began):
            self.began = report
        elif isinstance(report, Refused):
            self._on_refused(report)
        elif isinstance(report, Status):
            self.last_status = LastStatus(report, time.monotonic())
            if report.play == self._play_number:
                self._on_status(report)

    def _on_status(self, status: Status) -> None:
        """Of the newest play."""
        waiting, self._pending = self._pending, None
        if status.state == "ended":
            self._playing = self.is_live = False  # a swap may still be answered
            self.problem = status.problem
        if waiting is not None and not status.problem:
            self.play(waiting)

    def _on_refused(self, report: Refused) -> None:
        if report.play == self._play_number:
            self._fail(report.why)
        elif report.play < 0 and self._swapped and self._sound is not None and self._output_spec is not None:
            # It ended in the very moment when it was to go on as another sound: that one is begun.
            self._start_playback(self._sound, self._output_spec)

    def _fail(self, why: str) -> None:
        self._clear_playback()
        self.problem = why

    # ---- what is told

    def _can_swap_to(self, sound: Sound, where: OutputSpec) -> bool:
        """Can what plays be exchanged for sound without opening the device anew?"""
        now = self._sound
        same = now is not None and (now.rate, now.loop) == (sound.rate, sound.loop) and self._output_spec == where
        return same and self.is_sounding

    def _is_opening(self, where: OutputSpec) -> bool:
        """The device is being taken already: what is asked for meanwhile waits for it, the newest alone."""
        return self._playing and not self.is_live and self.current_status is None and self._output_spec == where

    def _start_playback(self, sound: Sound, where: OutputSpec) -> None:
        path, write = self._prepare_wav(sound)
        self._clear_playback()
        self._play_number += 1
        self._playing, self._sound, self._output_spec, self.problem = True, sound, where, ""
        self._send(Play(self._play_number, str(path), where, sound.loop, max(sound.start_s, 0.0)), write)

    def _swap(self, sound: Sound) -> None:
        path, write = self._prepare_wav(sound)
        self._sound, self._swapped = sound, True
        self._send(Swap(str(path)), write)

    def _prepare_wav(self, sound: Sound) -> tuple[Path, Callable[[], None]]:
        """Where it will lie, and what writes it there."""
        path = self._new_file(".wav")
        return path, partial(write_wav, path, Signal(sound.samples, sound.rate, seed=0))

    def _new_file(self, suffix: str) -> Path:
        """Of the process that runs, or is begun. Raises DeviceError where none can be started, FileError where the
        disk refuses."""
        if self._process is None:
            self._process = PlayerProcess()
        return self._process.new_file(suffix)

    def _send(self, command: Command, before_send: Callable[[], None] | None = None) -> None:
        if self._process is not None:
            self._process.send(command, before_send)


def make_output_spec(target: str, profile: ActuatorProfile) -> OutputSpec:
    """A target and the limits that hold there, as the process is told them."""
    if profile.name != USER_PROFILE_NAME:
        return OutputSpec(target, profile.name)
    low, high = profile.range_hz or (0.0, 0.0)
    return OutputSpec(target, USER_PROFILE_NAME, (profile.peak_m_s2 or 0.0, low, high))


PLAYER_CLIENT = PlayerClient()


def make_facts(client: PlayerClient, profile: ActuatorProfile) -> ActuatorFacts:
    """profile: whose limits the level is shown in."""
    phase = get_phase(client)
    heard = client.current_status
    if heard is None or phase is Phase.OFF:
        return ActuatorFacts(phase, problem=client.problem)
    status, limits = heard.status, profile.limits
    most = limits.full_scale_m_s2 * limits.peak
    level = status.level_m_s2 if phase in (Phase.PLAYING, Phase.LIVE) else 0.0
    return ActuatorFacts(phase, level, min(level / most, 1.0), describe_playback(client), client.problem)


def get_phase(client: PlayerClient) -> Phase:
    if not client.is_running:
        return Phase.OFF
    if not client.is_playing:
        return Phase.READY
    if client.current_status is None:
        return Phase.OPENING
    if client.is_live:
        return Phase.LIVE
    return Phase.PAUSED if client.is_paused else Phase.PLAYING


def describe_playback(client: PlayerClient) -> tuple[str, ...]:
    """What was told of the newest play, one thought a line; what is as it should be is not mentioned."""
    heard, began = client.current_status, client.began
    if heard is None:
        return ()
    status, lines = heard.status, []
    if began is not None and began.play == status.play:
        said = tr("{device}: {rate} Hz, delay up to {queue} ms")
        lines.append(said.format(device=began.device, rate=f"{began.rate_hz:g}", queue=f"{began.queue_ms:.0f}"))
    lines.append(tr("Highest so far: {share} of full scale").format(share=f"{status.peak:.0%}"))
    if status.temperature_c is not None:
        lines.append(tr("Coil at {temperature} °C").format(temperature=f"{status.temperature_c:.1f}"))
    if status.limited:
        lines.append(tr("{count} samples limited").format(count=status.limited))
    if status.nonfinite:
        lines.append(tr("{count} invalid samples (NaN) played as 0").format(count=status.nonfinite))
    if status.underruns:
        lines.append(tr("Samples came too late {count} times").format(count=status.underruns))
    if client.is_live and status.latency_p99_ms > 0.0:
        lines.append(tr("From the pen to the device: {latency} ms").format(latency=f"{status.latency_p99_ms:.0f}"))
    return tuple(lines)
