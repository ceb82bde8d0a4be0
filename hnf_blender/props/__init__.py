"""What the project adds to Blender's own data."""

from __future__ import annotations

from types import ModuleType

from ..rooms import rooms_off, rooms_on
from . import material, scene, stroke

GROUPS = (stroke, material, scene)

_registered: list[ModuleType] = []


def register() -> None:
    rooms_on(GROUPS, _registered)


def unregister() -> None:
    rooms_off(_registered)
