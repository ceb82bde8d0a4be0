"""Panels and lists of the Touch tab, one file per panel; they draw cached state and compute nothing.

Read `strokes_panel.py` first.
"""

from __future__ import annotations

from typing import Any

from ..registration import collect_classes, register_classes, unregister_classes
from . import strokes_panel

MODULES = (
    "scene_panel",
    "preview_panel",
    "strokes_panel",
    "materials_panel",
    "actuator_panel",
)
"""Sub-modules, each with a tuple CLASSES."""

_registered_classes: list[Any] = []


def register() -> None:
    classes = collect_classes(__package__, MODULES)
    register_classes(classes)
    _registered_classes.extend(classes)
    try:
        strokes_panel.register()
    except Exception:
        unregister()
        raise


def unregister() -> None:
    strokes_panel.unregister()
    unregister_classes(_registered_classes)
    _registered_classes.clear()
