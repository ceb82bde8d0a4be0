"""What the project adds to Blender's own data."""

from __future__ import annotations

from types import ModuleType

from ..rooms import register_modules, unregister_modules
from . import material, scene, stroke

GROUPS = (stroke, material, scene)

_registered: list[ModuleType] = []


def register() -> None:
    register_modules(GROUPS, _registered)


def unregister() -> None:
    unregister_modules(_registered)
