"""Operators: what buttons, keys and menus call."""

from __future__ import annotations

import importlib
from types import ModuleType

MODULES = ("materials", "diagnose", "drop", "assets")
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
