"""The actuator panel: output choice, playback buttons, timeline, and simulated speakers."""

from __future__ import annotations

import time

import bpy
import numpy as np
import pytest
from builders import add_plane
from job_scene import small_scene
from panel_recorder import drawn
from player_builders import RATE_HZ, chosen, tone

import hnf_blender.ui
from hnf_blender import actuator, preview, translations
from hnf_blender.actuator import actuator_state, player_process
from hnf_blender.actuator.actuator_state import (
    ACTUATOR,
    SPEAKERS,
    VIRTUAL,
    ActuatorFacts,
    Output,
    Phase,
    find_output_title,
    get_selected_output,
    needs_offline_player,
    select_output,
)
from hnf_blender.actuator.player_client import PLAYER_CLIENT
from hnf_blender.actuator.skin_preview import estimate_skin
from hnf_blender.preview import controller
from hnf_blender.preview.controller import OutputRouter
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.timeline_playback import PlayheadFollower, make_sound_ahead
from hnf_blender.registration import collect_classes
from hnf_blender.ui.actuator_panel import PHASE_LABELS
from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.profile import GENERIC
from hnf_core.actuators.virtual_port import Recording
from hnf_core.errors import FileError
from hnf_core.signal import Signal

LIMIT_S = 40.0
UI = {each.__name__: each for each in collect_classes("hnf_blender.ui", hnf_blender.ui.MODULES)}


@pytest.fixture(scope="module")
def switched_on(operators):
    hnf_blender.ui.register()
    yield
    hnf_blender.ui.unregister()


@pytest.fixture
def virtual(switched_on):
    with chosen(VIRTUAL):
        yield
        folder = PLAYER_CLIENT.folder
        controller.PLAYER.release()
        PLAYER_CLIENT.release()
        PREVIEW.clear()
        assert folder is None or until(lambda: not folder.exists())


@pytest.fixture
def stroke(warm_bake, virtual):
    """A baked stroke whose signal is there."""
    PREVIEW.clear()
    small_scene()
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    obj = bpy.data.objects["Along"]
    controller.refresh(obj, bpy.context, wait=True)
    return obj


def until(so) -> bool:
    return until_for(LIMIT_S, so)


def until_for(seconds: float, so) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        actuator.tick(bpy.context)
        if so():
            return True
        time.sleep(0.005)
    return False


def panel() -> object:
    return drawn(UI["HNF_PT_actuator"])


def test_speakers_are_what_is_chosen_where_nothing_was(switched_on) -> None:
    assert get_selected_output() == SPEAKERS
    shown = panel()
    assert "Speakers (Blender)" in shown.words
    assert "limits do not apply" in shown.words.replace("\n", " ")
    assert "hnf.live_touch" in shown.operators  # on headphones
    with pytest.raises(RuntimeError, match="choose an actuator"):
        bpy.ops.hnf.actuator_test()


def test_the_choice_is_the_machines_not_the_files(virtual, tmp_path) -> None:
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.hnf.output_choose(target=SPEAKERS)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert get_selected_output() == SPEAKERS


def test_a_stroke_is_felt_on_the_virtual_actuator(stroke) -> None:
    assert bpy.ops.hnf.preview_play() == {"FINISHED"}
    assert PREVIEW.sounding == "Along"
    assert until(lambda: controller.PLAYER.is_sounding)
    shown = panel()
    assert "Playing" in shown.words
    assert "m/s²" in shown.words
    assert until(lambda: not controller.PLAYER.is_playing)
    assert ACTUATOR.facts.problem == ""
    assert PLAYER_CLIENT.current_status.status.peak > 0.0
    until(lambda: ACTUATOR.facts.phase is Phase.READY)
    assert "Device Released" in panel().words.replace("\n", " ")


def test_a_looped_stroke_goes_on_as_a_and_as_now(stroke) -> None:
    bpy.context.scene.hnf.loop = True
    bpy.ops.hnf.preview_ab(action="KEEP")
    assert bpy.ops.hnf.preview_play() == {"FINISHED"}
    assert until(lambda: controller.PLAYER.is_sounding)
    began = PLAYER_CLIENT.began
    stroke.hnf_stroke.seed += 1
    controller.refresh(stroke, bpy.context, wait=True)
    bpy.ops.hnf.preview_ab(action="SWITCH")
    bpy.ops.hnf.preview_ab(action="SWITCH")
    assert until(lambda: PLAYER_CLIENT.current_status.status.played_s > 0.6)
    assert PLAYER_CLIENT.began is began
    assert PREVIEW.sounding == "Along"
    assert bpy.ops.hnf.preview_stop() == {"FINISHED"}
    assert not controller.PLAYER.is_playing
    assert until(lambda: ACTUATOR.facts.phase is Phase.READY)


def test_a_paused_stroke_is_silent_and_goes_on_where_it_was(stroke) -> None:
    player = controller.PLAYER
    bpy.context.scene.hnf.loop = True
    assert bpy.ops.hnf.preview_play() == {"FINISHED"}
    assert until(lambda: player.is_sounding and player.position_s > 0.05)
    assert bpy.ops.hnf.preview_pause() == {"FINISHED"}
    assert until(
        lambda: (
            PLAYER_CLIENT.current_status.status.state == "paused"
            and PLAYER_CLIENT.current_status.status.level_m_s2 < 1e-3
        )
    )
    assert "Paused" in panel().words
    held = player.position_s
    stroke.hnf_stroke.seed += 1
    controller.refresh(stroke, bpy.context, wait=True)
    controller.continue_playback("Along", bpy.context.scene)
    assert not until_for(0.3, lambda: PLAYER_CLIENT.current_status.status.level_m_s2 > 1e-3)
    assert player.is_playing
    assert player.is_paused
    assert player.position_s == pytest.approx(held, abs=0.02)
    assert bpy.ops.hnf.preview_pause() == {"FINISHED"}
    assert until(
        lambda: (
            PLAYER_CLIENT.current_status.status.state == "playing"
            and PLAYER_CLIENT.current_status.status.level_m_s2 > 1e-3
        )
    )
    assert not player.is_paused
    bpy.ops.hnf.preview_pause()
    assert bpy.ops.hnf.preview_play() == {"FINISHED"}  # from its start
    assert not player.is_paused
    assert until(lambda: PLAYER_CLIENT.current_status.status.state == "playing")
    assert bpy.ops.hnf.preview_stop() == {"FINISHED"}
    assert not bpy.ops.hnf.preview_pause.poll()


def test_the_test_button_plays_one_second(virtual) -> None:
    bpy.context.scene.hnf.actuator = "own"
    bpy.context.scene.hnf.own_peak_m_s2 = 20.0
    assert bpy.ops.hnf.actuator_test() == {"FINISHED"}
    assert until(lambda: PLAYER_CLIENT.current_status is not None and PLAYER_CLIENT.current_status.status.peak > 0.05)
    assert until(lambda: not PLAYER_CLIENT.is_playing)
    assert PLAYER_CLIENT.problem == ""
    assert PLAYER_CLIENT.current_status.status.peak == pytest.approx(0.1, abs=0.01)
    assert PLAYER_CLIENT.current_status.status.limited == 0


def test_choosing_another_output_silences_this_one(virtual) -> None:
    controller.PLAYER.play(tone(5.0, loop=True))
    assert until(lambda: PLAYER_CLIENT.is_sounding)
    assert bpy.ops.hnf.output_choose(target=VIRTUAL) == {"FINISHED"}
    assert PLAYER_CLIENT.is_playing  # the same one
    assert bpy.ops.hnf.output_choose(target=SPEAKERS) == {"FINISHED"}
    assert not PLAYER_CLIENT.is_running
    assert until(lambda: ACTUATOR.facts.phase is Phase.OFF)


def test_another_file_silences_it(virtual) -> None:
    controller.PLAYER.play(tone(5.0, loop=True))
    assert until(lambda: PLAYER_CLIENT.is_sounding)
    actuator.on_load_pre()
    assert not PLAYER_CLIENT.is_running
    preview.on_load_post()
    assert not controller.PLAYER.is_playing


def test_an_address_of_her_own_is_checked(virtual) -> None:
    assert bpy.ops.hnf.output_other(target="osc:127.0.0.1:9000") == {"FINISHED"}
    assert get_selected_output() == "osc:127.0.0.1:9000"
    assert "osc:127.0.0.1:9000" in panel().words
    for wrong in ("osc:127.0.0.1", "nowhere", ""):
        assert bpy.ops.hnf.output_other(target=wrong) == {"CANCELLED"}
    assert get_selected_output() == "osc:127.0.0.1:9000"


def test_devices_are_looked_for_beside_blender(virtual) -> None:
    assert bpy.ops.hnf.actuator_find() == {"FINISHED"}
    assert ACTUATOR.is_scanning
    assert "Looking for devices" in panel().words
    assert until(lambda: not ACTUATOR.is_scanning)
    assert ACTUATOR.is_scanned
    assert not any("looked for" in line for line in ACTUATOR.scan_notes)


def test_what_was_found_can_be_chosen_and_told_apart(virtual) -> None:
    player_process.store_scan_result(
        '{"devices": [{"target": "serial:/dev/ttyACM0", "title": "Pico", "facts": "USB 2e8a:000a"},'
        ' {"target": "audio:Card", "title": "Card", "facts": "48000 Hz, 2 channels"}],'
        ' "without": ["python-osc"], "missing": ["the Python package \'python-osc\' is not installed."]}'
    )
    menu = drawn(UI["HNF_MT_output"])
    assert "Pico (/dev/ttyACM0)" in menu.words
    assert ("hnf.output_choose", "target", "audio:Card") in menu.given
    assert find_output_title("audio:Card") == "Card (48000 Hz, 2 channels)"
    assert "python-osc" in panel().words.replace("\n", " ")
    for damaged in ("", "{}", '{"devices": [{}], "without": [], "missing": []}', "[]"):
        with pytest.raises(FileError):
            player_process.store_scan_result(damaged)
    assert ACTUATOR.outputs == (
        Output("serial:/dev/ttyACM0", "Pico (/dev/ttyACM0)"),
        Output("audio:Card", "Card (48000 Hz, 2 channels)"),
    )


def test_without_sounddevice_a_sound_output_is_played_whole(virtual, monkeypatch) -> None:
    monkeypatch.setattr(actuator_state, "_is_sounddevice_installed", lambda: True)
    assert not needs_offline_player("audio")
    ACTUATOR.missing_packages = frozenset({"sounddevice"})
    select_output("audio:Card")
    assert needs_offline_player("audio:Card")
    assert not needs_offline_player(VIRTUAL)
    shown = panel()
    assert "Live Touch needs the Python package sounddevice" in shown.words.replace("\n", " ")
    assert "hnf.live_touch" not in shown.operators
    assert "hnf.actuator_test" in shown.operators
    with pytest.raises(RuntimeError, match="install sounddevice"):
        bpy.ops.hnf.live_touch()


def test_what_speakers_play_stops_where_an_actuator_begins(virtual, monkeypatch) -> None:
    outputs = OutputRouter()
    outputs.play(tone(5.0))
    assert outputs._playing is not outputs._speakers
    assert outputs.is_playing
    ACTUATOR.selected = SPEAKERS
    sounded = []
    monkeypatch.setattr(outputs._speakers, "start", lambda samples, rate, **_: sounded.append(samples))
    outputs.play(tone(0.1, gain_db=6.0))
    assert outputs._playing is outputs._speakers
    assert not PLAYER_CLIENT.is_playing
    assert np.abs(sounded[0]).max() == pytest.approx(0.2 * 10.0 ** (6.0 / 20.0), rel=0.01)
    outputs.release()


def test_the_timeline_is_felt_and_followed(stroke) -> None:
    scene, follower = bpy.context.scene, PlayheadFollower()
    scene.frame_end = 60
    follower.start(scene)
    assert until(lambda: PLAYER_CLIENT.is_sounding or not PLAYER_CLIENT.is_playing)
    follower.stop()
    assert not PLAYER_CLIENT.is_playing
    whole = len(PREVIEW.results["Along"].signal.samples) / 10_000.0
    assert make_sound_ahead(scene, 60.0).duration_s == pytest.approx(whole)
    scene.frame_set(59)
    assert make_sound_ahead(scene, 60.0) is None
    follower.start(scene)
    assert follower.start_frame == 59.0
    assert not PLAYER_CLIENT.is_playing


def test_dragging_the_playhead_is_felt_on_an_actuator_alone(stroke) -> None:
    scene, follower = bpy.context.scene, PlayheadFollower()
    plays = []
    for frame in (3, 4, 5, 3):  # faster than a device is taken
        scene.frame_set(frame)
        follower.scrub(scene)
        assert PLAYER_CLIENT.is_playing
    assert until(lambda: PLAYER_CLIENT.current_status is not None and PLAYER_CLIENT.current_status.status.peak > 0.0)
    for frame in (4, 5, 6):
        scene.frame_set(frame)
        follower.scrub(scene)
        waited = time.monotonic() + 0.1
        until(lambda end=waited: time.monotonic() > end)
        plays.append(PLAYER_CLIENT.current_status.status.play)
    assert len(set(plays)) == 1  # one stream, kept open a while
    assert plays[0] <= PLAYER_CLIENT.began.play
    assert until(lambda: not PLAYER_CLIENT.is_playing)
    assert PLAYER_CLIENT.problem == ""
    for state in (SPEAKERS, VIRTUAL):
        ACTUATOR.selected = state
        scene.hnf.follow_timeline = state == SPEAKERS
        follower.scrub(scene)
        assert not PLAYER_CLIENT.is_playing


def test_skin_estimates_equal_the_virtual_device_recording() -> None:
    sound = tone(0.4, level=60.0)  # twice what the generic voice coil bears
    limiter = Limiter(GENERIC.limits, RATE_HZ, 1)
    counts = np.concatenate([limiter.process(sound.samples[:, None]), limiter.flush()])
    recording = Recording()
    recording.record(0, RATE_HZ, counts)
    found = estimate_skin(Signal(sound.samples, RATE_HZ, seed=0), GENERIC)
    moved = recording.motion.acceleration[:, 0]
    assert found.rms == pytest.approx(float(np.sqrt(np.mean(np.square(moved)))), rel=0.01)
    assert found.peak == pytest.approx(float(np.abs(moved).max()), rel=1e-6)
    assert found.limited_samples == limiter.limited > 0
    assert found.max_temperature_c > 25.0
    assert estimate_skin(Signal(np.zeros(0, np.float32), RATE_HZ, seed=0), GENERIC).rms == 0.0


def test_the_panel_shows_skin_levels_on_the_virtual_actuator(stroke) -> None:
    heard = PREVIEW.results["Along"]

    def told(signal=heard.signal) -> bool:
        actuator.tick(bpy.context, heard.stamp, signal)
        return bool(ACTUATOR.skin_lines)

    assert until(told)
    assert "At the skin" in panel().words
    strong = [line for line in ACTUATOR.skin_lines if "would be limited" in line]
    bpy.context.scene.hnf.actuator, bpy.context.scene.hnf.own_peak_m_s2 = "own", 0.05
    assert until(lambda: told() and [line for line in ACTUATOR.skin_lines if "would be limited" in line] != strong)
    assert not told(None)
    assert "At the skin" not in panel().words


def test_the_panel_says_what_goes_on_and_what_went_wrong(virtual) -> None:
    add_plane()
    for phase, (_, words) in PHASE_LABELS.items():
        ACTUATOR.facts = ActuatorFacts(phase, 1.5, 0.4, ("Coil at 31.0 °C",), "The port was unplugged.")
        shown = panel()
        assert words in shown.words
        assert "Coil at 31.0 °C" in shown.words
        assert "Actuator Does Not Play" in shown.words
        assert "The port was unplugged." not in shown.words  # once, in the details beside Play
        assert ("1.5 m/s²" in shown.words) is (phase in (Phase.PLAYING, Phase.LIVE))
        assert words in translations.read_translations("de_DE")
    assert {"hnf.actuator_test", "hnf.preview_stop", "hnf.live_touch"} <= set(shown.operators)
    assert {"live_pen_n", "live_mouse_n"} <= set(shown.props)
