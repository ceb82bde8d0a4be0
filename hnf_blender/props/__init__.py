"""What the project adds to Blender's own data."""

from __future__ import annotations

from . import material, scene, stroke

GROUPS = (stroke, material, scene)


def register() -> None:
    for group in GROUPS:
        group.register()


def unregister() -> None:
    for group in reversed(GROUPS):
        group.unregister()
