"""The stroke tool of the 3-D view, the strokes shown in it, and the menus that lead to strokes. In a window only:
tools, keymaps and menus belong to one."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..rooms import rooms_off, rooms_on

PARTS = (".stroke_tool", ".menus", ".overlay")
"""Modules with register() and unregister(), in order."""

_registered: list[ModuleType] = []


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    rooms_on((importlib.import_module(name, __package__) for name in PARTS), _registered)


def unregister() -> None:
    rooms_off(_registered)
