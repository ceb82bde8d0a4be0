"""A part that cannot be switched on leaves nothing behind, and the add-on can be switched on again."""

from __future__ import annotations

import bpy
import pytest

import hnf_blender
from hnf_blender import props, tool
from hnf_blender.props import GROUPS, material_settings
from hnf_blender.ui import strokes_panel

OURS = {"Object": "hnf_stroke", "Material": "hnf_touch", "Scene": "hnf"}


def what_is_on():
    kinds = [name for name, prop in OURS.items() if hasattr(getattr(bpy.types, name), prop)]
    classes = [name for name in dir(bpy.types) if name.startswith(("HNF_", "Hnf"))]
    return kinds, classes


@pytest.fixture
def switched_off():
    """As before the add-on is switched on; the properties that the session needs come back after it."""
    props.unregister()
    assert what_is_on() == ([], [])
    yield
    hnf_blender.unregister()
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()


def refuse(*_args, **_words):
    raise RuntimeError("class refused")


@pytest.mark.parametrize("place", range(len(GROUPS)))
def test_a_refused_group_of_properties(switched_off, monkeypatch, place) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(GROUPS[place], "register", refuse)
        with pytest.raises(RuntimeError, match="class refused"):
            hnf_blender.register()
    assert what_is_on() == ([], [])
    hnf_blender.register()
    assert what_is_on()[0] == list(OURS)


def test_a_group_that_no_datablock_takes(switched_off, monkeypatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(material_settings, "OVERRIDABLE", {"NO_SUCH_OPTION"})
        with pytest.raises(ValueError, match="could not register"):
            props.register()
    assert what_is_on() == ([], [])
    props.register()


@pytest.mark.parametrize("room", [tool, strokes_panel])
def test_a_room_that_fails_after_panels_are_there(switched_off, monkeypatch, room) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(room, "register", refuse)
        with pytest.raises(RuntimeError, match="class refused"):
            hnf_blender.register()
    assert what_is_on() == ([], [])
    hnf_blender.register()


def test_a_part_of_the_tool_that_fails_takes_the_others_back(monkeypatch) -> None:
    class Part:
        def __init__(self, works):
            self.works, self.on = works, False

        def register(self):
            if not self.works:
                refuse()
            self.on = True

        def unregister(self):
            self.on = False

    from hnf_blender.registration import register_modules

    parts, done = [Part(True), Part(True), Part(False), Part(True)], []
    with pytest.raises(RuntimeError):
        register_modules(parts, done)
    assert [part.on for part in parts] == [False] * 4
    assert done == []
