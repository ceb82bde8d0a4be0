"""Choice of the sound device and recovery from its failures, with a driver that fails on demand."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from hnf_blender.preview import sound_device
from hnf_blender.preview.timeline_playback import TAIL_S, PlayheadFollower, pad_with_silence
from hnf_core.actuators.profile import GENERIC
from hnf_core.errors import SceneError

TONE = np.ones((100, 1), dtype=np.float32)
OWN = "OpenAL"
"""Name of the device that the preferences choose."""


class Driver:
    """In place of Blender's `aud`. opened: names of the devices opened, None = the one that Blender has open."""

    error = RuntimeError

    def __init__(self) -> None:
        self.opened: list[str | None] = []
        self.broken: set[int] = set()
        self.blender_has_one = True
        self.Sound = SimpleNamespace(buffer=lambda samples, rate: (samples, rate))

    def Device(self, name: str | None = None) -> SimpleNamespace:  # as aud calls it  # noqa: N802
        if name is None and not self.blender_has_one:
            raise self.error("there is none")
        self.opened.append(name)
        number = len(self.opened)
        return SimpleNamespace(play=lambda _sound: self.play(number))

    def play(self, number: int) -> SimpleNamespace:
        if number in self.broken:
            raise self.error("Buffer generation failed")
        return SimpleNamespace(status=True, position=0.0, stop=lambda: None)


@pytest.fixture
def driver(monkeypatch) -> Driver:
    made = Driver()
    monkeypatch.setattr(sound_device, "import_aud", lambda: made)
    monkeypatch.setattr(sound_device, "get_device_name", lambda: OWN)
    return made


def test_one_device_is_opened_and_kept(driver) -> None:
    speakers = sound_device.Speakers()
    speakers.start(TONE, 1000.0)
    speakers.start(TONE, 1000.0)
    assert driver.opened == [OWN]
    assert speakers.is_playing


def test_a_lost_device_is_reopened_and_a_failing_one_raises(driver) -> None:
    speakers = sound_device.Speakers()
    speakers.start(TONE, 1000.0)
    driver.broken = {1}
    speakers.start(TONE, 1000.0)
    assert speakers.is_playing
    driver.broken = {1, 2, 3}
    with pytest.raises(SceneError, match="Buffer generation failed"):
        speakers.start(TONE, 1000.0)
    assert not speakers.is_playing
    driver.broken = set()
    speakers.start(TONE, 1000.0)
    assert driver.opened == [OWN] * 4


def test_another_choice_in_the_preferences_is_followed(driver, monkeypatch) -> None:
    speakers = sound_device.Speakers()
    speakers.start(TONE, 1000.0)
    monkeypatch.setattr(sound_device, "get_device_name", lambda: "Another")
    speakers.start(TONE, 1000.0)
    assert driver.opened == [OWN, "Another"]


def test_while_the_timeline_plays_it_is_blenders_own_device(driver) -> None:
    speakers = sound_device.Speakers()
    speakers.start(TONE, 1000.0)
    speakers.use_shared_device(True)
    assert not speakers.is_playing
    speakers.start(TONE, 1000.0)
    speakers.use_shared_device(False)
    speakers.start(TONE, 1000.0)
    assert driver.opened == [OWN, None, OWN]


def test_without_one_of_blenders_it_is_the_chosen_one(driver) -> None:
    driver.blender_has_one = False
    speakers = sound_device.Speakers()
    speakers.use_shared_device(True)
    speakers.start(TONE, 1000.0)
    assert driver.opened == [OWN]


def test_a_silent_device_choice_also_applies_to_the_timeline(driver, monkeypatch) -> None:
    monkeypatch.setattr(sound_device, "get_device_name", lambda: sound_device.NO_DEVICE)
    speakers = sound_device.Speakers()
    speakers.use_shared_device(True)
    speakers.start(TONE, 1000.0)
    assert driver.opened == [sound_device.NO_DEVICE]


def test_the_sound_waits_for_the_next_frame_and_begins_there() -> None:
    """Blender opens its device after it has told that the timeline plays."""
    scene, follower = bpy.context.scene, PlayheadFollower()
    scene.frame_set(3)
    follower.wait(scene)
    assert follower.is_playing(scene)
    scene.frame_set(5)
    follower.follow(scene)
    assert (follower.start_frame, follower.is_waiting) == (5.0, False)
    scene.frame_set(7)
    follower.follow(scene)
    assert follower.start_frame == 5.0
    scene.frame_set(2)
    follower.follow(scene)
    assert follower.start_frame == 2.0
    follower.stop()
    assert not follower.is_playing(scene)


def test_silence_lingers_after_a_sound() -> None:
    moment = sound_device.Sound(np.ones(100, dtype=np.float32), 1000.0, GENERIC)
    longer = pad_with_silence(moment)
    assert longer.duration_s == pytest.approx(moment.duration_s + TAIL_S)
    assert np.array_equal(longer.samples[:100], moment.samples)
    assert not longer.samples[100:].any()
