"""Operators: what buttons, keys and menus call."""

from __future__ import annotations

from typing import Any

from ..rooms import classes_of, switch_off, switch_on

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

_on: list[Any] = []


def register() -> None:
    classes = classes_of(__package__, MODULES)
    switch_on(classes)
    _on.extend(classes)


def unregister() -> None:
    switch_off(_on)
    _on.clear()
