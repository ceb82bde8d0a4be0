"""Haptic Neural Fields as a Blender add-on: strokes drawn over a scene become vibration signals.

Importing this package needs no bpy, because the command line and the tests of the core load it outside Blender too.
`bridge` reads and writes Blender data, `touch` computes signals from it, and `ops`, `ui` and `tool` are what a person
uses. Read `touch/session.py` first.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from .registration import register_modules, unregister_modules

SUBMODULES = ("translations", "props", "prefs", "handlers", "jobs", "actuator", "preview", "ops", "tool", "ui")
"""Sub-modules with register() and unregister(), in order of registration. Each may use the ones before it, and handlers
run in this order for one change."""

_commands: list[Any] = []
_registered: list[ModuleType] = []


def register() -> None:
    """Register the add-on; called by Blender when it is switched on.

    If a part cannot be loaded, a panel that shows the error is registered instead. In background mode the error is
    raised.
    """
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
    """Run `blender --command hnf …`.

    The command line is imported here, so that starting Blender does not load it.
    """
    from .cli import main

    return main(argv)


def unregister() -> None:
    """Unregister everything; called by Blender when the add-on is switched off."""
    import bpy

    from . import error_panel

    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    unregister_modules(_registered)
    error_panel.unregister()
