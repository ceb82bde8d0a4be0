"""Panels, lists and overlays. They draw what is cached and compute nothing."""

from __future__ import annotations

from typing import Any

from ..rooms import classes_of, switch_off, switch_on
from . import follow_selection

MODULES = (
    "stroke_list",
    "scene_panel",
    "materials_panel",
    "probe_panel",
    "strokes_panel",
    "preview_panel",
    "export_panel",
    "actuator_panel",
    "diagnose_panel",
)
"""Sub-modules, each with a tuple CLASSES."""

_on: list[Any] = []


def register() -> None:
    classes = classes_of(__package__, MODULES)
    switch_on(classes)
    _on.extend(classes)
    try:
        follow_selection.register()
    except Exception:
        unregister()
        raise


def unregister() -> None:
    follow_selection.unregister()
    switch_off(_on)
    _on.clear()
