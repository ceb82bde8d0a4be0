"""The stroke tool of the 3-D view, the line it draws, and the menus that lead to strokes. In a window only: tools,
keymaps and menus belong to one."""

from __future__ import annotations

import importlib
from types import ModuleType

PARTS = (".stroke_tool", ".menus", "..ui.overlay")
"""Modules with register() and unregister(), in order."""

_registered: list[ModuleType] = []


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    for name in PARTS:
        part = importlib.import_module(name, __package__)
        part.register()
        _registered.append(part)


def unregister() -> None:
    while _registered:
        _registered.pop().unregister()
