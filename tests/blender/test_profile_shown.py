"""A measured actuator's profile in the panels: they show what a timer read, and ask no disk themselves."""

from __future__ import annotations

import os

import bpy
import pytest
from panel_recorder import drawn

import hnf_blender.ui
from hnf_blender.props import scene_settings
from hnf_blender.props.scene_settings import get_actuator_profile, get_shown_profile
from hnf_blender.ui.actuator_panel import HNF_PT_actuator
from hnf_blender.ui.preview_panel import HNF_PT_export
from hnf_core.actuators.profile import GENERIC, ActuatorProfile, write_profile


@pytest.fixture(autouse=True, scope="module")
def switched_on(operators):
    hnf_blender.ui.register()
    yield
    hnf_blender.ui.unregister()


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setattr(scene_settings, "CHECK_INTERVAL_S", 1e-6)
    path = tmp_path / "mine.json"
    write_profile(path, ActuatorProfile("mine", "Mine", "measured here", (30.0, 500.0), peak_m_s2=4.0))
    settings = bpy.context.scene.hnf
    settings.actuator, settings.actuator_file = "file", str(path)
    settings.export_format = "ahap"
    return bpy.context.scene


def words(monkeypatch) -> str:
    """What both panels say while every look at a file fails; where its lines break is the sidebar's affair."""
    with monkeypatch.context() as patch:
        for module, name in ((os, "stat"), (scene_settings, "_read_profile"), (scene_settings, "_read_mtime")):
            patch.setattr(module, name, lambda *_args, **_named: pytest.fail("a panel asked the disk"))
        return " ".join(f"{drawn(HNF_PT_actuator).words} {drawn(HNF_PT_export).words}".split())


def test_a_panel_shows_what_a_timer_read(scene, monkeypatch) -> None:
    assert "Not read yet" in words(monkeypatch)
    get_actuator_profile(scene)
    said = words(monkeypatch)
    assert "4" in said
    assert "Mine" in said
    assert "measured here" in said


def test_a_profile_that_is_gone_is_said_once_a_timer_saw_it(scene, monkeypatch) -> None:
    get_actuator_profile(scene)
    os.remove(scene.hnf.actuator_file)
    assert "Mine" in words(monkeypatch)
    get_actuator_profile(scene)
    assert "cannot be read" in words(monkeypatch)


def test_any_other_actuator_is_shown_as_it_is(scene) -> None:
    scene.hnf.actuator = GENERIC.name
    assert get_shown_profile(scene) == get_actuator_profile(scene) == GENERIC
