"""On the timeline a stroke sounds once, at one level; and the guide is done when something was heard."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from stroke_builders import LINE, add_stroke, has_sound

from hnf_blender.actuator.actuator_state import SPEAKERS, VIRTUAL
from hnf_blender.compat import sequencer_strips
from hnf_blender.preview import controller, strips_and_speakers, timeline_playback
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
    strips_and_speakers.mute_others(stroke, scene, speaker)
    assert (strip.mute, speaker.data.muted, followed(scene)) == (True, False, 0)
    speaker.data.muted = True
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


def test_a_speaker_is_as_loud_from_afar(stroke, sound) -> None:
    assert add_speaker(stroke, sound).data.attenuation == 0.0


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
