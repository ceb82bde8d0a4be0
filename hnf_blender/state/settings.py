"""What the preferences say, wherever it is asked."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy

ADDON_PACKAGE = __package__.rpartition(".")[0]
"""The package that Blender keeps preferences for: the one that this room is in."""


class Settings(NamedTuple):
    """What holds where the add-on was not switched on through the preferences (tests, the command line).

    overlay: draw strokes in the 3-D view. default_probe: of new strokes. output: where strokes are played.
    external_python: the program that learns materials, "" = none.
    """

    overlay: bool = True
    default_probe: str = "pen"
    output: str = ""
    external_python: str = ""


DEFAULT_SETTINGS = Settings()


def get_settings(context: Any = None) -> Any:
    """The preferences, or DEFAULTS where Blender keeps none for this add-on; the names are the same."""
    addon = (context or bpy.context).preferences.addons.get(ADDON_PACKAGE)
    return DEFAULT_SETTINGS if addon is None or addon.preferences is None else addon.preferences
