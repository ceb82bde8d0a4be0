"""The preview from a stored bake to an audible signal with the bytes of `hnf touch`."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import shutil
import threading
import time

import bpy
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from job_scene import small_scene
from stroke_builders import has_sound
from touch_scene import place_data, save_scene, set_keys

from hnf_blender import compat, preview
from hnf_blender.preview import controller, get_preview_facts, get_preview_icon, synthesis_thread
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.stroke_image import ImageStyle
from hnf_blender.preview.synthesis_thread import (
    Failure,
    RenderCache,
    SynthesisThread,
    read_current_bake,
    synthesise_preview,
)
from hnf_blender.preview.timeline_playback import PlayheadFollower, list_placed_signals
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY, SCHEMA, StrokeBake, load_bake, remove_bake, store_bake
from hnf_core.errors import FileError, StrokeError
from hnf_core.field.stroke import HeightProfile


@pytest.fixture
def stroke(warm_bake):
    """A baked stroke, in a scene that nothing was heard of yet."""
    PREVIEW.clear()
    controller.PLAYER.release()
    small_scene()
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    yield bpy.data.objects["Along"]
    controller.PLAYER.release()
    PREVIEW.clear()


def now(obj):
    return read_current_bake(obj, bpy.context.scene)


def samples_of(obj) -> bytes:
    return synthesise_preview(now(obj), ImageStyle(), RenderCache()).signal.samples.tobytes()


def export(tmp_path, **words) -> dict[str, bytes]:
    folder = tmp_path / "exported"
    shutil.rmtree(folder, ignore_errors=True)
    bpy.context.scene.hnf.export_folder = str(folder)
    assert bpy.ops.hnf.export(**words) == {"FINISHED"}
    return {path.name: path.read_bytes() for path in folder.glob("*.wav")}


def test_another_file_takes_nothing_that_was_still_being_heard(stroke) -> None:
    controller.refresh(stroke, bpy.context, wait=False)
    listener = PREVIEW.synthesis_thread
    assert listener is not None
    preview.on_load_post()
    assert PREVIEW.synthesis_thread is None
    listener._thread.join(timeout=30.0)
    assert not listener._thread.is_alive()
    assert controller.collect_results() == set()
    assert PREVIEW.results == {}


def test_saved_and_loaded_it_sounds_the_same(stroke, tmp_path) -> None:
    stored, heard = bytes(stroke[BAKE_PROPERTY]), samples_of(stroke)
    path = save_scene(tmp_path / "scene.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    again = bpy.data.objects["Along"]
    assert bytes(again[BAKE_PROPERTY]) == stored
    assert samples_of(again) == heard


def test_undo_gives_back_what_was_heard(stroke) -> None:
    bpy.ops.ed.undo_push(message="before")
    heard = samples_of(stroke)
    set_keys(stroke, "force", (3.0, 2.7))
    bpy.ops.ed.undo_push(message="pressed harder")
    assert samples_of(bpy.data.objects["Along"]) != heard
    bpy.ops.ed.undo()
    assert samples_of(bpy.data.objects["Along"]) == heard


def test_a_stroke_takes_little_room(stroke) -> None:
    assert len(stroke[BAKE_PROPERTY]) < 20_000  # 0.26 s


def test_pressing_where_nothing_was_baked_is_stale(stroke, tmp_path) -> None:
    bake = load_bake(stroke)
    assert bake is not None
    lifted = bake.stroke.action.force.copy()
    lifted[20:30] = 0.0
    up = bake.with_force(lifted)
    assert not up.stroke.action.contact[20:30].any()
    with pytest.raises(StrokeError, match=r"presses where the bake had no contact \(0.10 s"):
        up.with_force(bake.stroke.action.force)


@pytest.mark.parametrize("all_of_them", [False, True])
def test_a_stale_stroke_is_refused_by_name(stroke, tmp_path, all_of_them) -> None:
    stroke.location.x += 0.004
    bpy.context.view_layer.update()
    bpy.context.scene.hnf.export_folder = str(tmp_path / "exported")
    with pytest.raises(RuntimeError, match=r"'Along'.*bake"):
        bpy.ops.hnf.export(all=all_of_them)
    assert not (tmp_path / "exported").exists()
    with pytest.raises(RuntimeError, match=r"[Bb]ake"):
        bpy.ops.hnf.preview_play()


def test_one_stale_stroke_does_not_keep_the_others(stroke, tmp_path) -> None:
    other = stroke.copy()
    other.name = "Elsewhere"
    other.location.y += 0.01
    bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.update()
    assert len(export(tmp_path, all=True)) == 1


def test_a_relative_folder_needs_a_saved_file(stroke) -> None:
    bpy.context.scene.hnf.export_folder = "//touch"
    with pytest.raises(RuntimeError, match=r"not saved yet.*Save the file"):
        bpy.ops.hnf.export()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_bytes_are_said_to_be_damaged(whole, data) -> None:
    """Cut anywhere, or with a byte changed: a FileError with a remedy, or, where it did not matter, the same stroke."""
    if data.draw(st.booleans()):
        broken = whole[: data.draw(st.integers(0, len(whole) - 1))]
    else:
        at, flip = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(1, 255))
        broken = whole[:at] + bytes([whole[at] ^ flip]) + whole[at + 1 :]
    found = None
    with contextlib.suppress(FileError):
        found = StrokeBake.from_bytes(broken, where="stroke 'X'")
    if found is None:
        with pytest.raises(FileError, match=r"stroke 'X'.*Bake the stroke again"):
            StrokeBake.from_bytes(broken, where="stroke 'X'")
    else:
        assert found.to_bytes() == whole


@pytest.fixture(scope="module")
def whole(rendered_plate) -> bytes:
    from hnf_blender.jobs import bake_job

    bpy.ops.wm.read_factory_settings(use_empty=True)
    with pytest.MonkeyPatch.context() as patch:
        place_data(patch, rendered_plate.parents[1])
        small_scene()
        bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    return bytes(bpy.data.objects["Along"][BAKE_PROPERTY])


def test_a_bake_comes_back_as_it_was(whole) -> None:
    bake = StrokeBake.from_bytes(whole)
    assert bake.to_bytes() == whole
    speed = np.random.default_rng(1).random(len(bake.stroke.action.speed))  # float32 does not hold these
    action = dataclasses.replace(bake.stroke.action, speed=speed)
    stored = dataclasses.replace(bake, stroke=dataclasses.replace(bake.stroke, action=action)).to_bytes()
    assert np.array_equal(StrokeBake.from_bytes(stored).stroke.action.speed, speed)
    assert len(stored) > len(whole)


def test_another_version_is_named() -> None:
    packed = io.BytesIO()
    np.savez_compressed(packed, schema=np.array(SCHEMA + 1))
    with pytest.raises(FileError, match=rf"format {SCHEMA + 1}, this add-on reads {SCHEMA}"):
        StrokeBake.from_bytes(packed.getvalue())


def test_storing_and_removing() -> None:
    curve = bpy.data.objects.new("C", bpy.data.curves.new("C", "CURVE"))
    assert load_bake(curve) is None
    remove_bake(curve)
    curve[BAKE_PROPERTY] = "text"
    with pytest.raises(FileError, match=r"'C'.*not a bake"):
        load_bake(curve)


def test_a_changed_key_is_heard_in_part_and_equals_the_whole(stroke) -> None:
    kept = RenderCache()
    first = synthesise_preview(now(stroke), ImageStyle(), kept)
    set_keys(stroke, "force", (6.0, 0.3))
    second = synthesise_preview(now(stroke), ImageStyle(), kept)
    assert second.signal.samples.tobytes() == samples_of(stroke)
    assert second.signal.samples.tobytes() != first.signal.samples.tobytes()
    assert second.stamp != first.stamp


def test_background_synthesis_is_exact_and_the_newest_wins(stroke) -> None:
    listener = SynthesisThread()
    try:
        for force in (0.4, 0.6, 0.8):
            set_keys(stroke, "force", (3.0, force))
            listener.request(now(stroke), ImageStyle())
        found, until = {}, time.monotonic() + 60.0
        while (listener.is_busy or not found) and time.monotonic() < until:
            time.sleep(0.01)
            found |= listener.pop_results()
        found |= listener.pop_results()
    finally:
        listener.stop()
    assert found["Along"].stamp == now(stroke).stamp
    assert found["Along"].signal.samples.tobytes() == samples_of(stroke)


def test_a_waiting_operator_restarts_a_synthesis(stroke, monkeypatch) -> None:
    listener, wanted, begun, told = SynthesisThread(), now(stroke), threading.Event(), []
    synthesise = synthesis_thread.synthesise_preview

    def synthesise_until_told(current, style, cache, is_superseded):
        begun.set()
        if not told:
            until = time.monotonic() + 60.0
            while not is_superseded() and time.monotonic() < until:
                time.sleep(0.001)
            told.append(is_superseded())
        return synthesise(current, style, cache, is_superseded)

    monkeypatch.setattr(synthesis_thread, "synthesise_preview", synthesise_until_told)
    found, until = {}, time.monotonic() + 60.0
    try:
        listener.request(wanted, ImageStyle())
        assert begun.wait(60.0)
        with compat.override_context(scene=bpy.context.scene):
            assert told == [True]
            assert listener.pop_results() == {}
        while not found and time.monotonic() < until:
            time.sleep(0.01)
            found |= listener.pop_results()
    finally:
        listener.stop()
    assert found["Along"].signal.samples.tobytes() == samples_of(stroke)


def test_the_stroke_at_hand_does_not_wait_for_the_others(stroke) -> None:
    listener, wanted = SynthesisThread(), now(stroke)
    others = [
        dataclasses.replace(wanted, name=name, bake=dataclasses.replace(wanted.bake, path_key=name)) for name in "ABC"
    ]
    order, until = [], time.monotonic() + 60.0
    found = {}
    try:
        for other in others:
            listener.request(other, ImageStyle(), first=False)
        listener.request(wanted, ImageStyle())
        while len(found) < 4 and time.monotonic() < until:
            done = listener.pop_results()
            order += list(done)
            found |= done
            time.sleep(0.01)
    finally:
        listener.stop()
    assert order[0] == "Along"
    assert sorted(order) == ["A", "Along", "B", "C"]
    assert {heard.signal.samples.tobytes() for heard in found.values()} == {samples_of(stroke)}


def test_the_cache_counts_the_height_profile(stroke) -> None:
    cache = RenderCache()
    synthesise_preview(now(stroke), ImageStyle(), cache)
    (rendered,) = cache.items.values()
    height = np.zeros(1000)
    counted = [
        synthesis_thread._count_bytes(
            dataclasses.replace(rendered, stroke=dataclasses.replace(rendered.stroke, profile=profile))
        )
        for profile in (None, HeightProfile(1e-4, 0.0, height, 2e-4), HeightProfile(1e-4, 0.0, height, 2e-4, height))
    ]
    assert np.diff(counted).tolist() == [height.nbytes, height.nbytes]


class FinishedThread:
    """Synthesis thread whose outcomes are given."""

    is_busy = False

    def __init__(self, outcome):
        self._outcome = outcome

    def pop_results(self):
        return {"Along": self._outcome}

    def stop(self, *, wait=True):
        pass


def collect(outcome, requested):
    """Collect an outcome after `requested` was asked for."""
    if requested is not None:
        PREVIEW.requested["Along"] = requested
    PREVIEW.synthesis_thread = FinishedThread(outcome)
    try:
        return controller.collect_results()
    finally:
        PREVIEW.synthesis_thread = None


def test_a_failed_stroke_is_not_played(stroke) -> None:
    controller.refresh(stroke, bpy.context, wait=True)
    PREVIEW.play_when_ready = "Along"
    assert collect(Failure("newer", "It broke."), ("newer", ImageStyle())) == set()
    assert (PREVIEW.problems["Along"], PREVIEW.play_when_ready) == ("It broke.", "")


def test_only_the_newest_request_tells_of_a_problem(stroke) -> None:
    first = controller.refresh(stroke, bpy.context, wait=True)
    PREVIEW.play_when_ready = "Along"
    newer = ("newer", first.style)
    assert collect(Failure("older", "It broke."), newer) == set()
    assert (PREVIEW.problems, PREVIEW.play_when_ready) == ({}, "Along")
    assert collect(first, newer) == {"Along"}
    assert PREVIEW.requested["Along"] == newer
    assert controller.update_facts("Along", bpy.context.scene).busy
    assert collect(dataclasses.replace(first, stamp="newer"), newer) == {"Along"}
    assert not controller.update_facts("Along", bpy.context.scene).busy


def test_a_stored_signal_ends_its_problem(stroke) -> None:
    first = controller.refresh(stroke, bpy.context, wait=True)
    PREVIEW.problems["Along"] = "It broke."
    assert collect(first, (first.stamp, first.style)) == {"Along"}
    assert PREVIEW.problems == {}
    remove_bake(stroke)
    assert controller.refresh(stroke, bpy.context, wait=False) is None
    assert collect(first, None) == set()
    assert (PREVIEW.results, PREVIEW.problems) == ({}, {"Along": "Not baked yet."})


def test_playing_without_a_device_says_so(stroke) -> None:
    """Here there is none (or no `aud` at all): a message, no error; the signal was made all the same."""
    assert bpy.ops.hnf.preview_play() in ({"CANCELLED"}, {"FINISHED"})
    assert PREVIEW.results["Along"].signal.rms > 0.0
    assert bpy.ops.hnf.preview_stop() == {"FINISHED"}


def test_facts_are_there_to_be_shown(stroke) -> None:
    assert get_preview_facts(stroke) is None
    assert get_preview_icon(stroke) == 0
    heard = controller.refresh(stroke, bpy.context, wait=True)
    facts = controller.update_facts("Along", bpy.context.scene)
    assert get_preview_facts(stroke) is facts
    assert facts.duration_s == pytest.approx(heard.signal.duration_s)
    assert facts.peak_m_s2 == pytest.approx(float(np.abs(heard.signal.samples).max()))
    assert facts.problem == ""
    assert not facts.busy
    assert "m/s²" in facts.lines[0]
    bpy.context.scene.hnf.monitor_gain_db = 60.0
    assert any("clips by" in line for line in controller.update_facts("Along", bpy.context.scene).lines)
    bpy.context.scene.hnf.actuator = "eai-c-mf"  # nothing is known of its largest
    assert controller.update_facts("Along", bpy.context.scene).headroom_db is None


def test_a_custom_actuator_updates_levels_and_image_at_once(stroke) -> None:
    settings = bpy.context.scene.hnf
    settings.actuator = "own"
    plain = controller.refresh(stroke, bpy.context, wait=True)
    told = controller.update_facts("Along", bpy.context.scene)
    assert told.headroom_db is None
    for peak in (told.peak_m_s2 / 2.0, told.peak_m_s2 * 2.0):
        settings.own_peak_m_s2 = peak
        drawn = controller.refresh(stroke, bpy.context, wait=True)
        told = controller.update_facts("Along", bpy.context.scene)
        assert told.headroom_db == pytest.approx(20.0 * np.log10(peak / told.peak_m_s2), abs=1e-4)
        assert any("My Actuator" in line for line in told.lines)
        assert drawn.style.limit_m_s2 == pytest.approx(peak)
        assert not np.array_equal(drawn.image, plain.image)
    settings.own_lowest_hz, settings.own_highest_hz = 2000.0, 1000.0  # the wrong way round
    assert any("below 1000 Hz" in line for line in controller.update_facts("Along", bpy.context.scene).lines)


def test_a_and_now_are_compared_at_their_own_level(stroke) -> None:
    assert bpy.ops.hnf.preview_ab(action="SWITCH") == {"CANCELLED"}
    assert bpy.ops.hnf.preview_ab(action="KEEP") == {"FINISHED"}
    kept = PREVIEW.results["Along"]
    set_keys(stroke, "force", (3.0, 3.0))
    new = controller.refresh(stroke, bpy.context, wait=True)
    assert PREVIEW.get_shown("Along") is new
    assert new.signal.rms > kept.signal.rms
    bpy.ops.hnf.preview_ab(action="SWITCH")
    assert PREVIEW.get_shown("Along") is kept
    assert get_preview_facts(stroke).shows == "A"
    assert get_preview_facts(stroke).rms_m_s2 == pytest.approx(kept.signal.rms)
    bpy.ops.hnf.preview_ab(action="FORGET")
    assert PREVIEW.get_shown("Along") is new


@pytest.mark.skipif(not has_sound(), reason="this Blender is built without sound")
def test_the_sequencer_gets_one_strip_at_the_start(stroke, tmp_path) -> None:
    from hnf_blender.compat import sequencer_strips

    scene = bpy.context.scene
    scene.hnf.export_folder = str(tmp_path / "exported")
    for _ in range(2):
        assert bpy.ops.hnf.add_to_sequencer() == {"FINISHED"}
        (strip,) = sequencer_strips(scene.sequence_editor)
        assert (strip.name, strip.type, strip.frame_start) == ("Along", "SOUND", 1)
        assert strip.volume == pytest.approx(0.1)
    assert strip.frame_final_duration == pytest.approx(0.26 * 24, abs=4)


@pytest.mark.skipif(has_sound(), reason="this Blender has sound")
def test_without_audio_no_strip_is_added_and_the_wav_is_reported(stroke, tmp_path) -> None:
    bpy.context.scene.hnf.export_folder = str(tmp_path)
    with pytest.raises(RuntimeError, match=r"'Along'.*no sound strip.*along.wav"):
        bpy.ops.hnf.add_to_sequencer()
    assert (tmp_path / "along.wav").is_file()


def test_a_speaker_stands_where_the_stroke_begins(stroke) -> None:
    surface = bpy.data.objects["Plate"]
    for _ in range(2):
        bpy.context.view_layer.objects.active = stroke
        assert bpy.ops.hnf.add_speaker() == {"FINISHED"}
        (speaker,) = [obj for obj in bpy.context.scene.objects if obj.type == "SPEAKER"]
        stroke.name = "Renamed"
        refresh_status(bpy.context.scene)
    assert speaker.name == "Renamed speaker"
    bpy.context.view_layer.update()
    assert tuple(speaker.matrix_world.translation) == pytest.approx((-0.013, 0.0, 0.0), abs=1e-5)
    assert speaker.parent == surface
    assert speaker.data.sound.packed_file is not None
    assert speaker.animation_data.nla_tracks[0].strips[0].frame_start == 1.0


def test_a_stroke_that_is_not_baked_says_so(operators, tmp_path) -> None:
    small_scene()
    bpy.context.scene.hnf.export_folder = str(tmp_path)
    for button in (bpy.ops.hnf.preview_play, bpy.ops.hnf.add_to_sequencer, bpy.ops.hnf.add_speaker):
        with pytest.raises(RuntimeError, match="Not baked yet"):
            button()
    with pytest.raises(RuntimeError, match=r"'Along'.*[Bb]ake"):
        bpy.ops.hnf.export()


def test_store_bake_is_what_load_bake_reads(whole) -> None:
    curve = bpy.data.objects.new("C", bpy.data.curves.new("C", "CURVE"))
    bake = StrokeBake.from_bytes(whole)
    store_bake(curve, bake)
    assert load_bake(curve).to_bytes() == whole


def test_on_the_timeline_sounds_what_is_true_and_not_muted(stroke) -> None:
    scene = bpy.context.scene
    assert list_placed_signals(scene) == []
    heard = controller.refresh(stroke, bpy.context, wait=True)
    (placed,) = list_placed_signals(scene)
    assert (placed.start, placed.rate) == (1.0, 10_000.0)
    assert placed.samples is heard.signal.samples
    stroke.hnf_stroke.mute = True
    assert list_placed_signals(scene) == []
    stroke.hnf_stroke.mute = False
    stroke.location.x += 0.004
    bpy.context.view_layer.update()
    refresh_status(scene)
    assert list_placed_signals(scene) == []
    assert "ake" in controller.update_facts("Along", scene).problem


def test_the_timeline_plays_on_without_a_sound_device(stroke) -> None:
    controller.refresh(stroke, bpy.context, wait=True)
    follower = PlayheadFollower()
    follower.start(bpy.context.scene)
    assert follower.start_frame == float(bpy.context.scene.frame_current)
    follower.follow(bpy.context.scene)
    follower.stop()
    assert follower.start_frame is None
    bpy.context.scene.hnf.follow_timeline = False
    follower.start(bpy.context.scene)
    assert follower.start_frame is None


def test_the_room_is_left_as_it_was_found() -> None:
    """No handler and no timer without a window; nothing stays behind."""
    before = [len(getattr(bpy.app.handlers, name)) for name, _ in preview.HANDLERS]
    preview.register()
    preview.unregister()
    assert [len(getattr(bpy.app.handlers, name)) for name, _ in preview.HANDLERS] == before
    assert not bpy.app.timers.is_registered(preview.tick)
