"""Stroke tool of the 3D view, overlay of strokes, and menu entries; registered only if Blender has a window.

Read `stroke_tool.py` first.
"""

from __future__ import annotations

import importlib
from types import ModuleType

from ..registration import register_modules, unregister_modules

MODULES = (".stroke_tool", ".overlay")
"""Modules with register() and unregister(), in order of registration."""

_registered: list[ModuleType] = []


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    register_modules((importlib.import_module(name, __package__) for name in MODULES), _registered)


def unregister() -> None:
    unregister_modules(_registered)
