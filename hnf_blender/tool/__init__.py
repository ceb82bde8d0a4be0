"""The stroke tool of the 3-D view, the strokes shown in it, and the menus that lead to strokes. In a window only:
tools, keymaps and menus belong to one."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..registration import register_modules, unregister_modules

MODULES = (".stroke_tool", ".menus", ".overlay")
"""Modules with register() and unregister(), in order."""

_registered: list[ModuleType] = []


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    register_modules((importlib.import_module(name, __package__) for name in MODULES), _registered)


def unregister() -> None:
    unregister_modules(_registered)
