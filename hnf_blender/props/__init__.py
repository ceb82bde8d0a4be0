"""What the project adds to Blender's own data."""

from __future__ import annotations

from . import stroke


def register() -> None:
    stroke.register()


def unregister() -> None:
    stroke.unregister()
