"""Operators: what buttons, keys and menus call."""

from __future__ import annotations

from typing import Any

from ..rooms import collect_classes, register_classes, unregister_classes

MODULES = (
    "materials",
    "bake",
    "diagnose",
    "drop",
    "splats",
    "real_length",
    "assets",
    "draw",
    "stroke_tool",
    "strokes",
    "force",
    "preview",
    "actuator",
    "live",
    "probe",
    "export",
    "outside_python",
    "learn",
)
"""Sub-modules, each with a tuple CLASSES."""

_registered_classes: list[Any] = []


def register() -> None:
    classes = collect_classes(__package__, MODULES)
    register_classes(classes)
    _registered_classes.extend(classes)


def unregister() -> None:
    unregister_classes(_registered_classes)
    _registered_classes.clear()
