"""The stroke tool of the 3-D view, the line it draws, and the menus that lead to strokes. In a window only: tools,
keymaps and menus belong to one."""

from __future__ import annotations

from types import ModuleType

_registered: list[ModuleType] = []


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    from ..ui import overlay
    from . import menus, stroke_tool

    for part in (stroke_tool, menus, overlay):
        part.register()
        _registered.append(part)


def unregister() -> None:
    while _registered:
        _registered.pop().unregister()
