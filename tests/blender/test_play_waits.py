"""A pending Play starts when its signal is ready, whatever signals come first."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import pytest

from hnf_blender import preview
from hnf_blender.preview import controller
from hnf_blender.preview.preview_state import PREVIEW


@pytest.fixture
def begun(monkeypatch):
    """What was played anew or went on, in order."""
    done = []
    for name in ("play", "continue_playback"):
        monkeypatch.setattr(controller, name, lambda stroke, _scene, name=name: done.append((name, stroke)))
    monkeypatch.setattr(controller, "update_facts", lambda *_: None)
    PREVIEW.clear()
    yield done
    PREVIEW.clear()


def hear(*names):
    preview._update_playback(SimpleNamespace(scene=bpy.context.scene), set(names), timeline_plays=False)


def test_playback_continues_and_a_pending_play_starts_when_ready(begun):
    PREVIEW.sounding, PREVIEW.play_when_ready = "Sounds", "Waits"
    hear("Sounds")
    assert begun == [("continue_playback", "Sounds")]
    assert PREVIEW.play_when_ready == "Waits"
    hear("Other")
    hear("Waits")
    assert begun == [("continue_playback", "Sounds"), ("play", "Waits")]
    assert PREVIEW.play_when_ready == ""


def test_both_at_once_play_what_was_asked_for_last(begun):
    PREVIEW.sounding, PREVIEW.play_when_ready = "Sounds", "Waits"
    hear("Sounds", "Waits")
    assert begun == [("play", "Waits")]


def test_with_nothing_waited_for_a_signal_is_only_heard(begun):
    hear("Other")
    assert begun == []
