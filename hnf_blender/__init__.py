"""Haptic Neural Fields in Blender.

Importing this package needs no bpy: the command line and the tests of the core load it outside Blender too.
"""

from __future__ import annotations


def register() -> None:
    """Called by Blender when the add-on is switched on."""


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
