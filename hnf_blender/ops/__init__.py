"""Operators of the buttons, keys and menus, one file per panel or task.

`context.py` has what they share; read `stroke_ops.py` first.
"""

from __future__ import annotations

from typing import Any

from ..registration import collect_classes, register_classes, unregister_classes

MODULES = (
    "material_ops",
    "bake_ops",
    "diagnose_ops",
    "import_ops",
    "draw_ops",
    "stroke_ops",
    "force_ops",
    "preview_ops",
    "scale_ops",
    "actuator_ops",
    "export_ops",
    "learn_ops",
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
