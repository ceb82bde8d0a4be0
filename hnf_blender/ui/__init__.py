"""Panels, lists and overlays. They draw what is cached and compute nothing."""

from __future__ import annotations

import importlib
from types import ModuleType

MODULES = (
    "stroke_list",
    "scene_panel",
    "materials_panel",
    "strokes_panel",
    "export_panel",
    "diagnose_panel",
)
"""Sub-modules, each with a tuple CLASSES."""

_loaded: list[ModuleType] = []


def register() -> None:
    import bpy

    for name in MODULES:
        module = importlib.import_module(f".{name}", __package__)
        for each in module.CLASSES:
            bpy.utils.register_class(each)
        _loaded.append(module)


def unregister() -> None:
    import bpy

    while _loaded:
        for each in reversed(_loaded.pop().CLASSES):
            bpy.utils.unregister_class(each)
