"""On the timeline a stroke sounds once, at one level; and the guide is done when something was heard."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from job_scene import small_scene
from stroke_builders import LINE, add_stroke, has_sound

from hnf_blender import preview
from hnf_blender.actuator.actuator_state import SPEAKERS, VIRTUAL
from hnf_blender.compat import sequencer_strips
from hnf_blender.preview import controller, export_stroke, sound_device, strips_and_speakers, timeline_playback
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.state import addon_settings
from hnf_core.errors import SceneError
from hnf_core.export.wav import encode_wav
from hnf_core.signal import Signal


@pytest.fixture
def stroke(monkeypatch):
    """A stroke with a signal, and what the timeline plays of it."""
    stroke = add_stroke(LINE)
    signal = Signal(np.ones(1000, dtype=np.float32), 10_000.0, seed=0)
    monkeypatch.setattr(PREVIEW, "get_shown", lambda _name: SimpleNamespace(signal=signal))
    monkeypatch.setattr(controller, "get_problem", lambda *_: "")
    addon_settings.finish_guide(False)
    yield stroke
    PREVIEW.clear()
    addon_settings.finish_guide(False)


@pytest.fixture
def sound(tmp_path):
    if not has_sound():
        pytest.skip("this Blender is built without sound")
    path = tmp_path / "stroke.wav"
    path.write_bytes(encode_wav(Signal(np.zeros(1000, dtype=np.float32), 10_000.0, seed=0), where="it"))
    return bpy.data.sounds.load(str(path))


def followed(scene) -> int:
    return len(timeline_playback.list_placed_signals(scene))


def add_strip(stroke, sound):
    scene = bpy.context.scene
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strip = sequencer_strips(editor).new_sound(name="S", filepath=sound.filepath, channel=1, frame_start=1)
    strips_and_speakers.mark_linked(strip, stroke, scene, "")
    return strip


def add_speaker(stroke, sound):
    speaker = strips_and_speakers.add_speaker(sound, "Speaker", (0, 0, 0), 1.0)
    strips_and_speakers.mark_linked(speaker, stroke, bpy.context.scene, "")
    return speaker


def test_a_strip_or_speaker_takes_the_place_of_following(stroke, sound) -> None:
    scene = bpy.context.scene
    assert followed(scene) == 1
    strip, speaker = add_strip(stroke, sound), add_speaker(stroke, sound)
    bpy.context.view_layer.update()
    strips_and_speakers.mute_others(stroke, scene, speaker)
    assert (strip.mute, speaker.data.muted, followed(scene)) == (True, False, 0)
    strips_and_speakers.mute_others(stroke, scene, strip)
    bpy.context.view_layer.update()
    assert followed(scene) == 1
    strip.mute = False
    assert followed(scene) == 0
    scene.use_audio = False  # muted as a whole
    assert followed(scene) == 1


def test_an_actuator_plays_it_all_the_same(stroke, sound, monkeypatch) -> None:
    from hnf_blender.actuator import actuator_state

    add_strip(stroke, sound)
    for target, count in ((SPEAKERS, 0), (VIRTUAL, 1)):
        monkeypatch.setattr(actuator_state, "get_selected_output", lambda _context=None, target=target: target)
        assert followed(bpy.context.scene) == count


@pytest.mark.parametrize(
    ("target", "has_library", "count"),
    [("audio", True, 0), ("audio", False, 0), ("audio:Amplifier", True, 1), ("audio:Amplifier", False, 0)],
)
def test_a_strip_is_not_heard_beside_the_same_output(stroke, sound, monkeypatch, target, has_library, count) -> None:
    """The system's usual output is Blender's; so is every sound output where Blender itself has to play on it."""
    from hnf_blender.actuator import actuator_state

    add_strip(stroke, sound)
    monkeypatch.setattr(actuator_state, "_is_sounddevice_installed", lambda: has_library)
    monkeypatch.setattr(actuator_state, "get_selected_output", lambda _context=None: target)
    assert followed(bpy.context.scene) == count


def test_a_speaker_is_as_loud_from_afar(stroke, sound) -> None:
    assert add_speaker(stroke, sound).data.attenuation == 0.0


def mix(folder) -> np.ndarray:
    """What Blender plays of the scene, (n, 2)."""
    path = folder / "mix.wav"
    bpy.context.view_layer.update()
    bpy.ops.sound.mixdown(filepath=str(path), container="WAV", codec="PCM", format="F32")
    return np.asarray(sound_device.import_aud().Sound(str(path)).data())


def heard(folder) -> bool:
    return bool(np.abs(mix(folder)).max() > 1e-4)


def in_meta(strip, muted: bool) -> None:
    editor = bpy.context.scene.sequence_editor
    meta = sequencer_strips(editor).new_meta(name="Meta", channel=4, frame_start=1)
    strip.move_to_meta(meta)
    meta.mute = muted


def in_collection(speaker, **settings) -> None:
    scene = bpy.context.scene
    aside = bpy.data.collections.new("Aside")
    scene.collection.children.link(aside)
    aside.objects.link(speaker)
    scene.collection.objects.unlink(speaker)
    for name, value in settings.items():
        setattr(aside if name == "hide_viewport" else bpy.context.view_layer.layer_collection.children["Aside"],
                "hide_viewport" if name == "eye" else name, value)  # fmt: skip


def mute_nla(speaker, what: str) -> None:
    track = speaker.animation_data.nla_tracks[0]
    (track if what == "track" else track.strips[0]).mute = True


STRIP_STATES = {
    "as added": lambda strip: None,
    "muted": lambda strip: setattr(strip, "mute", True),
    "channel muted": lambda strip: setattr(bpy.context.scene.sequence_editor.channels[strip.channel], "mute", True),
    "no volume": lambda strip: setattr(strip, "volume", 0.0),
    "in a meta strip": lambda strip: in_meta(strip, False),
    "in a muted meta strip": lambda strip: in_meta(strip, True),
    "sound off": lambda strip: setattr(bpy.context.scene, "use_audio", False),
}
SPEAKER_STATES = {
    "as added": lambda speaker: None,
    "muted": lambda speaker: setattr(speaker.data, "muted", True),
    "no volume": lambda speaker: setattr(speaker.data, "volume", 0.0),
    "beside a camera": lambda speaker: add_camera(),
    "hidden in viewports": lambda speaker: setattr(speaker, "hide_viewport", True),
    "hidden in renders": lambda speaker: setattr(speaker, "hide_render", True),
    "hidden by its eye": lambda speaker: speaker.hide_set(True),
    "in an excluded collection": lambda speaker: in_collection(speaker, exclude=True),
    "in a collection hidden in viewports": lambda speaker: in_collection(speaker, hide_viewport=True),
    "in a collection hidden by its eye": lambda speaker: in_collection(speaker, eye=True),
    "its NLA strip muted": lambda speaker: mute_nla(speaker, "strip"),
    "its NLA track muted": lambda speaker: mute_nla(speaker, "track"),
    "no sound in it": lambda speaker: setattr(speaker.data, "sound", None),
    "sound off": lambda speaker: setattr(bpy.context.scene, "use_audio", False),
}


@pytest.fixture
def tone(tmp_path):
    """A sound that is heard."""
    if not has_sound():
        pytest.skip("this Blender is built without sound")
    bpy.context.scene.frame_end = 10
    path = tmp_path / "tone.wav"
    path.write_bytes(encode_wav(Signal(TONE, 10_000.0, seed=0), where="it"))
    return bpy.data.sounds.load(str(path))


TONE = (0.02 * np.sin(2.0 * np.pi * 200.0 * np.arange(4000) / 10_000.0)).astype(np.float32)


def add_camera() -> None:
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location = (3.0, 2.0, 10.0)


@pytest.mark.parametrize("state", STRIP_STATES)
def test_a_stroke_is_followed_where_its_strip_is_not_heard(stroke, tone, tmp_path, state) -> None:
    """Blender's own mix is the judge: one of the two sounds, never both and never none."""
    STRIP_STATES[state](add_strip(stroke, tone))
    assert followed(bpy.context.scene) == (0 if heard(tmp_path) else 1)


@pytest.mark.parametrize("state", SPEAKER_STATES)
def test_a_stroke_is_followed_where_its_speaker_is_not_heard(stroke, tone, tmp_path, state) -> None:
    speaker = add_speaker(stroke, tone)
    assert heard(tmp_path)
    SPEAKER_STATES[state](speaker)
    is_heard = heard(tmp_path)
    assert followed(bpy.context.scene) == (0 if is_heard else 1)


def test_a_speaker_that_gives_way_is_silent(stroke, tone, tmp_path) -> None:
    """Blender sounds a speaker on that is muted alone."""
    scene, speaker = bpy.context.scene, add_speaker(stroke, tone)
    assert heard(tmp_path)
    strips_and_speakers.mute_others(stroke, scene, None)
    assert (heard(tmp_path), followed(scene), speaker.data.muted) == (False, 1, True)


@pytest.mark.parametrize("gain_db", [-20.0, 0.0, 34.0])
def test_strip_speaker_and_preview_have_one_level(warm_bake, tmp_path, monkeypatch, gain_db) -> None:
    """As power over both ears, wherever the speaker stands; 34 dB are more than a speaker's volume can do."""
    if not has_sound():
        pytest.skip("this Blender is built without sound")
    PREVIEW.clear()
    small_scene()
    scene, obj = bpy.context.scene, bpy.data.objects["Along"]
    bpy.ops.hnf.bake()
    add_camera()
    bpy.context.view_layer.objects.active = obj
    scene.hnf.export_folder, scene.hnf.monitor_gain_db = str(tmp_path / "out"), gain_db
    loud = controller.refresh(obj, bpy.context, wait=True).signal
    faint = replace(loud, samples=np.float32(0.01) * loud.samples)  # nothing clips
    monkeypatch.setattr(export_stroke, "get_current_signal", lambda *_: faint)
    levels = []
    for add in (bpy.ops.hnf.add_to_sequencer, bpy.ops.hnf.add_speaker):
        bpy.context.view_layer.objects.active = obj
        assert add() == {"FINISHED"}
        levels.append(float(np.sum(np.square(mix(tmp_path), dtype=np.float64))))
    samples = faint.samples * sound_device.compute_monitor_gain(gain_db)
    rate = scene.render.ffmpeg.audio_mixrate
    levels.append(float(np.sum(np.square(samples, dtype=np.float64))) * rate / 10_000.0)
    assert levels == pytest.approx([levels[0]] * 3, rel=0.05)


def test_without_a_device_the_timeline_plays_on_and_it_is_told(stroke, monkeypatch) -> None:
    def fail(_sound) -> None:
        raise SceneError("there is no sound device.")

    scene, follower = bpy.context.scene, timeline_playback.PlayheadFollower()
    monkeypatch.setattr(controller.PLAYER, "play", fail)
    scene.frame_set(int(stroke.hnf_stroke.start))
    follower.start(scene)
    assert "no sound device" in PREVIEW.sound_problem
    assert not addon_settings.is_guide_done()
    monkeypatch.setattr(controller.PLAYER, "play", lambda _sound: None)
    follower.start(scene)
    assert PREVIEW.sound_problem == ""


def test_a_signal_holds_though_no_device_plays_it(stroke, monkeypatch) -> None:
    """Otherwise the timeline would leave the stroke out from then on."""

    def fail(_sound) -> None:
        raise SceneError("there is no sound device.")

    monkeypatch.setattr(controller.PLAYER, "play", fail)
    monkeypatch.setattr(controller, "update_facts", lambda *_: None)
    PREVIEW.play_when_ready = stroke.name
    preview._update_playback(SimpleNamespace(scene=bpy.context.scene), {stroke.name}, timeline_plays=False)
    assert PREVIEW.problems == {}
    assert "no sound device" in PREVIEW.sound_problem


def test_the_guide_is_done_when_something_was_heard(stroke, monkeypatch) -> None:
    def fail(_sound) -> None:
        raise SceneError("there is no sound device.")

    monkeypatch.setattr(controller.PLAYER, "play", fail)
    with pytest.raises(SceneError):
        controller.play(stroke.name, bpy.context.scene)
    assert not addon_settings.is_guide_done()
    assert "no sound device" in PREVIEW.sound_problem
    monkeypatch.setattr(controller.PLAYER, "play", lambda _sound: None)
    controller.play(stroke.name, bpy.context.scene)
    assert addon_settings.is_guide_done()
    assert PREVIEW.sound_problem == ""
