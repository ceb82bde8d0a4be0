"""The actuator player with the real process and the virtual device, and its messages for the artist."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from job_scene import is_gone
from player_builders import RATE_HZ, chosen, tone, until, until_for

from hnf_blender.actuator import player_process
from hnf_blender.actuator.actuator_state import VIRTUAL, Phase
from hnf_blender.actuator.player_client import RESTART_HINT, PlayerClient, get_phase, make_facts, make_output_spec
from hnf_blender.actuator.player_process import list_worker_commands
from hnf_blender.actuator.sound import SWEEP_LEVEL_SHARE, make_test_sweep
from hnf_blender.props import scene_settings
from hnf_blender.props.scene_settings import get_actuator_profile
from hnf_core.actuators.profile import GENERIC, PROFILES, ActuatorProfile, make_user_profile, write_profile
from hnf_core.errors import DeviceError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def link():
    """A link to the virtual actuator; nothing of it is left."""
    made = PlayerClient()
    with chosen(VIRTUAL):
        yield made
    pid, folder = made.pid, made.folder
    made.release()
    assert pid is None or is_gone(pid)
    assert folder is None or until(made, lambda: not folder.exists())


def test_a_stroke_is_played_to_its_end_and_the_level_is_told(link) -> None:
    assert get_phase(link) is Phase.OFF
    link.play(tone(0.8))
    assert link.is_playing
    assert get_phase(link) is Phase.OPENING
    assert until(link, lambda: link.is_sounding and link.current_status.status.level_m_s2 > 1.0)
    facts = make_facts(link, GENERIC)
    assert facts.phase is Phase.PLAYING
    assert facts.level_m_s2 == pytest.approx(2.0 / np.sqrt(2.0), rel=0.3)
    assert facts.share == pytest.approx(facts.level_m_s2 / 30.0)
    assert link.began.device in facts.lines[0]
    assert until(link, lambda: not link.is_playing)
    assert link.problem == ""
    assert link.current_status.status.underruns == 0 or link.current_status.status.played_s > 0.7
    assert get_phase(link) is Phase.READY


def test_the_place_goes_on_between_two_reports(link) -> None:
    link.play(tone(2.0))
    assert link.position_s == 0.0
    assert until(link, lambda: link.position_s > 0.3)
    told = link.current_status
    before, at = time.monotonic(), link.position_s
    time.sleep(0.02)
    later, after = link.position_s, time.monotonic()
    assert link.current_status is told
    assert 0.02 <= later - at <= after - before
    assert link.position_s <= 2.0


def test_stopped_it_is_silent_and_can_be_played_again(link) -> None:
    link.play(tone(5.0, loop=True))
    assert until(link, lambda: link.is_sounding)
    pid = link.pid
    link.stop()
    assert not link.is_playing
    assert until(link, lambda: link.current_status is not None and link.current_status.status.state == "ended")
    assert link.problem == ""
    link.play(tone(5.0))
    assert until(link, lambda: link.is_sounding)
    assert link.pid == pid


def test_a_swap_continues_without_reopening_the_device(link) -> None:
    link.play(tone(4.0, level=1.0))
    assert until(link, lambda: link.position_s > 0.4)
    began = link.began
    link.change(tone(4.0, level=4.0))
    assert until(link, lambda: link.current_status.status.level_m_s2 > 2.0)
    assert link.began is began
    assert link.position_s > 0.4
    assert link.current_status.status.play == began.play


def test_a_replay_restarts_on_the_open_device(link) -> None:
    link.play(tone(9.0))
    assert until(link, lambda: link.current_status is not None and link.current_status.status.position_s > 1.0)
    began, at = link.began, link.current_status.status.position_s
    link.play(tone(9.0))
    assert link.position_s < at
    assert until(link, lambda: 0.0 < link.current_status.status.position_s < at)
    assert link.began is began


def test_what_ends_in_the_moment_of_a_change_is_begun_anew(link) -> None:
    """As when the old sound has ended in the process, and Blender does not know yet."""
    link.play(tone(0.3))
    assert until(link, lambda: link.is_sounding)
    time.sleep(0.7)  # it ends; nobody listens
    assert link.is_playing
    link.change(tone(1.0, level=3.0))
    assert until(link, lambda: link.current_status is not None and link.current_status.status.level_m_s2 > 1.0)
    assert link.is_playing


def test_only_the_newest_request_plays_on_a_busy_device(link) -> None:
    for level in (1.0, 2.0, 3.0, 8.0):
        link.play(tone(2.0, level=level))
    assert until(link, lambda: link.current_status is not None and link.current_status.status.level_m_s2 > 4.0)
    assert link.current_status.status.play == link.began.play == 1
    link.play(tone(2.0))
    link.stop()
    assert until(link, lambda: link.current_status.status.state == "ended")
    time.sleep(0.2)
    link.tick()
    assert not link.is_playing


def test_stopped_in_the_moment_of_a_change_it_stays_silent(link) -> None:
    link.play(tone(0.3))
    assert until(link, lambda: link.is_sounding)
    time.sleep(0.7)  # it ends; nobody listens
    link.change(tone(1.0))
    link.stop()
    assert not until_for(link, 1.0, lambda: link.is_playing)
    assert link.problem == ""


def test_another_rate_loop_or_device_is_begun_anew(link) -> None:
    link.play(tone(3.0))
    assert until(link, lambda: link.position_s > 0.1)
    began = link.began
    link.change(dataclasses.replace(tone(3.0), loop=True))
    assert until(link, lambda: link.began is not began)
    assert link.began.play == began.play + 1
    assert until(link, lambda: link.is_sounding)


def test_a_loop_goes_on_over_its_end(link) -> None:
    link.play(tone(0.2, loop=True))
    assert until(link, lambda: link.is_sounding and link.current_status.status.played_s > 0.6)
    assert link.is_playing
    assert 0.0 <= link.position_s < 0.2


def test_a_killed_process_is_told_in_one_sentence_and_begun_anew(link) -> None:
    link.play(tone(5.0))
    assert until(link, lambda: link.is_sounding)
    folder = link.folder
    os.kill(link.pid, signal.SIGKILL)
    assert until(link, lambda: not link.is_running)
    assert not link.is_playing
    assert "was killed (signal 9)" in link.problem
    assert RESTART_HINT in link.problem
    assert make_facts(link, GENERIC).problem == link.problem
    assert until(link, lambda: not folder.exists())
    link.play(tone(5.0))
    assert link.problem == ""
    assert until(link, lambda: link.is_sounding)


def test_a_device_that_is_not_there_is_named(link) -> None:
    with chosen("serial:/dev/hnf-no-such-port"):
        link.play(tone(0.3))
        assert until(link, lambda: link.problem)
    assert "hnf-no-such-port" in link.problem
    assert not link.is_playing
    with chosen(VIRTUAL):
        link.play(tone(5.0))
        assert until(link, lambda: link.is_sounding)


def test_a_sound_that_cannot_be_written_is_told(link) -> None:
    broken = tone(0.3)
    broken.samples[5] = np.nan
    link.play(broken)
    assert until(link, lambda: link.problem)
    assert "not finite" in link.problem
    assert not link.is_playing


def test_a_python_that_cannot_is_followed_by_one_that_can(link, monkeypatch) -> None:
    monkeypatch.setattr(
        player_process,
        "list_worker_commands",
        lambda *_: ([sys.executable, "-c", "exit(4)"], *list_worker_commands(*_)),
    )
    link.play(tone(5.0))
    assert until(link, lambda: link.is_sounding)
    assert link.problem == ""


def test_what_cannot_be_started_is_said_and_leaves_nothing(link, monkeypatch) -> None:
    monkeypatch.setattr(player_process, "list_worker_commands", lambda *_: (["/no/such/python"],))
    with pytest.raises(DeviceError, match=r"/no/such/python.*could not be started"):
        link.play(tone(0.3))
    assert not link.is_playing
    assert not link.is_running
    assert link.folder is None


def test_released_while_it_plays_the_process_leaves_by_itself(link) -> None:
    link.play(tone(5.0, loop=True))
    assert until(link, lambda: link.is_sounding)
    pid, folder = link.pid, link.folder
    link.release()
    assert not link.is_running
    assert is_gone(pid)
    assert until(link, lambda: not folder.exists())


CRASHING = """
import os, sys, time
sys.path[:0] = [{root!r}, {tests!r}]
import bpy
from player_builders import tone, until
from hnf_blender.actuator.player_client import PlayerClient
from hnf_blender.actuator.actuator_state import ACTUATOR, VIRTUAL
ACTUATOR.selected = VIRTUAL
link = PlayerClient()
link.play(tone(60.0))
assert until(link, lambda: link.is_sounding)
print("PID", link.pid, flush=True)
time.sleep(60.0)
"""


def test_a_blender_that_crashes_leaves_no_player_behind() -> None:
    code = CRASHING.format(root=str(ROOT), tests=str(ROOT / "tests" / "blender"))
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        line = parent.stdout.readline()
        assert line.startswith("PID"), line
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    assert is_gone(int(line.split()[1]))


def test_the_limits_are_those_of_the_scenes_actuator() -> None:
    for name, profile in PROFILES.items():
        assert make_output_spec(VIRTUAL, profile).profile == name
    own = make_output_spec(VIRTUAL, make_user_profile(12.0, 40.0, 400.0))
    assert (own.profile, own.own) == ("own", (12.0, 40.0, 400.0))
    assert make_output_spec(VIRTUAL, make_user_profile(0.0, 40.0, 400.0)).own[0] == 0.0


def test_a_profile_file_is_read_again_before_playback(link, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(scene_settings, "CHECK_INTERVAL_S", 1e-6)
    scene, path = bpy.context.scene, tmp_path / "mine.json"
    scene.hnf.actuator = "file"
    assert "no profile is chosen" in get_actuator_profile(scene).source
    scene.hnf.actuator_file = str(path)
    unread = get_actuator_profile(scene)
    assert "cannot be read" in unread.source
    assert unread.peak_m_s2 is None
    link.play(dataclasses.replace(tone(0.3), profile=unread))
    assert until(link, lambda: link.problem)
    assert "mine.json" in link.problem
    write_profile(path, ActuatorProfile("mine", "Mine", "measured here", (30.0, 500.0), peak_m_s2=4.0))
    found = get_actuator_profile(scene)
    assert (found.title, found.peak_m_s2) == ("Mine", 4.0)
    assert make_output_spec(VIRTUAL, found).profile == str(path)
    link.play(dataclasses.replace(tone(0.3, level=2.0), profile=found))
    assert until(link, lambda: link.current_status is not None and not link.is_playing)
    assert link.problem == ""
    assert link.current_status.status.peak == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    "profile", [*PROFILES.values(), make_user_profile(0.0, 50.0, 50.0)], ids=lambda each: each.name
)
def test_the_test_is_soft_from_end_to_end(profile) -> None:
    sound = make_test_sweep(profile)
    assert sound.duration_s == 1.0
    assert np.abs(sound.samples).max() <= SWEEP_LEVEL_SHARE * profile.limits.full_scale_m_s2 + 1e-6
    assert np.abs(sound.samples).max() > 0.9 * SWEEP_LEVEL_SHARE * profile.limits.full_scale_m_s2
    assert abs(sound.samples[0]) < 1e-6
    assert abs(sound.samples[-1]) < 1e-3
    low, high = profile.range_hz
    energy = np.square(np.abs(np.fft.rfft(sound.samples)))
    frequency = np.fft.rfftfreq(len(sound.samples), 1.0 / RATE_HZ)
    inside = (frequency > 0.7 * low) & (frequency < 1.4 * high)
    assert energy[inside].sum() > 0.98 * energy.sum()


def test_blenders_own_python_is_the_lightest_way() -> None:
    ways = list_worker_commands("actuators.player", ())
    assert ways[0][0] == sys.executable
    assert bool(bpy.app.binary_path) == (len(ways) == 2)
