"""Haptic Neural Fields in Blender.

Importing this package needs no bpy: the command line and the tests of the core load it outside Blender too.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from .registration import register_modules, unregister_modules

SUBMODULES = ("translations", "props", "prefs", "handlers", "jobs", "actuator", "preview", "ops", "tool", "ui")
"""Sub-modules with register() and unregister(), in order; each may use those before it. What handlers note, later ones
hear of in the same change."""

_commands: list[Any] = []
_registered: list[ModuleType] = []


def register() -> None:
    """Called by Blender when the add-on is switched on. Where a part cannot be loaded, a panel says why instead."""
    import bpy

    from . import error_panel

    try:
        register_modules((importlib.import_module(f".{name}", __package__) for name in SUBMODULES), _registered)
        _commands.append(bpy.utils.register_cli_command("hnf", _command))
    except Exception as error:
        unregister()
        if bpy.app.background:
            raise
        error_panel.register(error)


def _command(argv: list[str]) -> int:
    """`blender --command hnf …`: the command line is loaded when it is called, not with every Blender."""
    from .cli import main

    return main(argv)


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
    import bpy

    from . import error_panel

    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    unregister_modules(_registered)
    error_panel.unregister()
