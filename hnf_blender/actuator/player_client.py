"""Client of the player process: a `Player` and a `LivePlayer` that send commands and read reports.

Sounds go to the child process as WAV files; the window's timer reads its reports. No call waits, and no sample is
processed in Blender's main thread. `make_facts` turns the client's state into what the panel shows.
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
"""Time after a seek during which reported positions may still be old [s]."""
RESTART_HINT = "Play again to restart it."


@dataclass(frozen=True)
class LastStatus:
    """Latest status report and the monotonic time of its arrival [s]."""

    status: Status
    received_s: float


class PlayerClient:
    """Player that runs in a child process, started when needed and ended by `release` or by its own failure."""

    def __init__(self) -> None:
        self._process: PlayerProcess | None = None
        self._play_number = self._first_live_number = 0
        self._reset()

    def _reset(self, problem: str = "") -> None:
        """Forget the child process and its state; `problem` is why it ended, "" for none."""
        self._process = None
        self.problem = problem
        """Why nothing plays any more, one sentence; "" if playback just ended."""
        self.began: Began | None = None
        self.last_status: LastStatus | None = None
        self._sound: Sound | None = None
        self._output_spec: OutputSpec | None = None
        self._clear_playback()

    def _clear_playback(self) -> None:
        """Mark playback as ended, with no sound pending."""
        self._playing = self.is_live = self.is_paused = self._swapped = False
        self._pending: Sound | None = None
        self._seek_time = float("-inf")

    # ---- Player

    def play(self, sound: Sound) -> None:
        output_spec = make_output_spec(get_selected_output(), sound.profile)
        if self._is_opening(output_spec):
            self._pending = sound
        elif self._can_swap_to(sound, output_spec):
            self._swap(sound)
            self._send(Seek(sound.start_s))
            self._seek_time = time.monotonic()
            self.resume()
        else:
            self._start_playback(sound, output_spec)

    def change(self, sound: Sound) -> None:
        output_spec = make_output_spec(get_selected_output(), sound.profile)
        if self._is_opening(output_spec):
            self._pending = sound
        elif self._can_swap_to(sound, output_spec):
            self._swap(sound)
        else:
            self._start_playback(replace(sound, start_s=min(self.position_s, sound.duration_s)), output_spec)

    def stop(self) -> None:
        """Fade out and free the device."""
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
        latest, sound = self.current_status, self._sound
        if latest is None or sound is None:
            return 0.0
        now = time.monotonic()
        if now - self._seek_time < SEEK_SETTLE_S:
            position = sound.start_s + now - self._seek_time
        else:
            position = latest.status.position_s + (now - latest.received_s if latest.status.state == "playing" else 0.0)
        return position % sound.duration_s if sound.loop and sound.duration_s > 0.0 else min(position, sound.duration_s)

    def release(self) -> None:
        """Stop, and let the process exit; it is killed after a second if it does not."""
        process = self._process
        self._reset()
        if process is not None:
            process.close()

    # ---- live

    def live_begin(self, target: str, profile: ActuatorProfile, probe: str, material: MaterialFile) -> None:
        """Start a live session with `probe` on `material`. Raises HnfError if no process can be started."""
        self._clear_playback()
        self._output_spec, self._probe, self._first_live_number = (
            make_output_spec(target, profile),
            probe,
            self._play_number + 1,
        )
        self.live_material(material)
        self.is_live = True

    def live_material(self, material: MaterialFile) -> None:
        """Change the material under the pen."""
        if self._output_spec is None:
            raise UsageError("no live touch is running that could take this material.")
        path = self._new_file(".hnf")
        self._play_number += 1
        self._playing, self._sound, self.problem = True, None, ""
        command = LiveBegin(self._play_number, str(path), self._output_spec, probe=self._probe)
        self._send(command, partial(write_hnf, path, material))

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """Move the pen to `position_m` (x, y) [m] at `time_s` on the pen's clock [s], pressed with `force_n` [N]."""
        if self.is_live:
            self._send(Move(time_s, *position_m, force_n))

    def live_end(self) -> None:
        if self.is_live:
            self.stop()

    # ---- reports

    def tick(self) -> bool:
        """Process the reports of the child process since the last call; return True if there were any.

        Does nothing without a process.
        """
        process = self._process
        if process is None:
            return False
        messages, end = process.poll()
        for message in messages:
            if isinstance(message, str):
                self._fail(message)
            else:
                self._on_report(message)
        if end and self._process is process:
            self._reset(f"The player's process {end}. {RESTART_HINT}")
            process.close()
        return bool(messages or end)

    @property
    def current_status(self) -> LastStatus | None:
        """Latest status of the newest play, None before its first; a live session counts as one play."""
        latest, first_play = self.last_status, self._first_live_number if self.is_live else self._play_number
        return latest if latest is not None and latest.status.play >= first_play else None

    @property
    def is_running(self) -> bool:
        return self._process is not None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def folder(self) -> Path | None:
        """Folder of the played files; None without a process."""
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
        """Handle a status report of the newest play."""
        waiting, self._pending = self._pending, None
        if status.state == "ended":
            self._playing = self.is_live = False  # A swap may still be refused.
            self.problem = status.problem
        if waiting is not None and not status.problem:
            self.play(waiting)

    def _on_refused(self, report: Refused) -> None:
        if report.play == self._play_number:
            self._fail(report.why)
        elif report.play < 0 and self._swapped and self._sound is not None and self._output_spec is not None:
            # Playback ended before the swap reached it, so the swapped sound is started anew.
            self._start_playback(self._sound, self._output_spec)

    def _fail(self, why: str) -> None:
        self._clear_playback()
        self.problem = why

    # ---- commands

    def _can_swap_to(self, sound: Sound, where: OutputSpec) -> bool:
        """Return whether the playing sound can be replaced by `sound` without reopening the device `where`."""
        playing = self._sound
        is_same_format = (
            playing is not None
            and (playing.rate, playing.loop) == (sound.rate, sound.loop)
            and self._output_spec == where
        )
        return is_same_format and self.is_sounding

    def _is_opening(self, where: OutputSpec) -> bool:
        """Return whether the device `where` is being opened; the newest sound requested meanwhile waits for it."""
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
        """Return a path for the sound's WAV file and a function that writes it."""
        path = self._new_file(".wav")
        return path, partial(write_wav, path, Signal(sound.samples, sound.rate, seed=0))

    def _new_file(self, suffix: str) -> Path:
        """Return a new path in the process's folder, starting the process if needed.

        Raises DeviceError if it cannot be started, FileError if the folder cannot be made.
        """
        if self._process is None:
            self._process = PlayerProcess()
        return self._process.new_file(suffix)

    def _send(self, command: Command, before_send: Callable[[], None] | None = None) -> None:
        if self._process is not None:
            self._process.send(command, before_send)


def make_output_spec(target: str, profile: ActuatorProfile) -> OutputSpec:
    """Return a target and an actuator profile in the form that the player process takes."""
    if profile.name != USER_PROFILE_NAME:
        return OutputSpec(target, profile.name)
    low, high = profile.range_hz or (0.0, 0.0)
    return OutputSpec(target, USER_PROFILE_NAME, (profile.peak_m_s2 or 0.0, low, high))


PLAYER_CLIENT = PlayerClient()


def make_facts(client: PlayerClient, profile: ActuatorProfile) -> ActuatorFacts:
    """Return what the panel shows of the player; the level is a fraction of what `profile` allows."""
    phase = get_phase(client)
    latest = client.current_status
    if latest is None or phase is Phase.OFF:
        return ActuatorFacts(phase, problem=client.problem)
    status, limits = latest.status, profile.limits
    max_level = limits.full_scale_m_s2 * limits.peak
    level = status.level_m_s2 if phase in (Phase.PLAYING, Phase.LIVE) else 0.0
    return ActuatorFacts(phase, level, min(level / max_level, 1.0), describe_playback(client), client.problem)


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
    """Return lines of text about the playback; only notable values, such as underruns, are mentioned."""
    latest, began = client.current_status, client.began
    if latest is None:
        return ()
    status, lines = latest.status, []
    if began is not None and began.play == status.play:
        template = tr("{device}: {rate} Hz, delay up to {queue} ms")
        lines.append(template.format(device=began.device, rate=f"{began.rate_hz:g}", queue=f"{began.queue_ms:.0f}"))
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
