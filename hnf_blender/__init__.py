"""Haptic Neural Fields in Blender.

Importing this package needs no bpy: the command line and the tests of the core load it outside Blender too.
"""

from __future__ import annotations

from typing import Any

_commands: list[Any] = []


def register() -> None:
    """Called by Blender when the add-on is switched on: stroke properties, and `blender -b --command hnf`."""
    import bpy

    from . import props
    from .cli import main

    props.register()
    _commands.append(bpy.utils.register_cli_command("hnf", main))


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
    import bpy

    from . import props

    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    props.unregister()
