"""What the preferences say, wherever it is asked.

Where the add-on keeps what it can make again, and what it learned.
"""

from __future__ import annotations

from pathlib import Path
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


def get_cache_folder() -> Path:
    """Close-ups of earlier bakes, named by content. Made where it is missing; survives upgrades of an extension."""
    return _make_data_folder("cache")


def get_learned_folder() -> Path:
    """Learned materials, and what an unfinished lesson goes on from; likewise."""
    return _make_data_folder("learned")


def _make_data_folder(name: str) -> Path:
    import tempfile  # brings shutil and four packers along: 3 ms that switching on need not take

    import bpy

    if ADDON_PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON_PACKAGE, path=name, create=True))
    data = bpy.utils.user_resource("DATAFILES", path=f"hnf/{name}", create=True)
    folder = Path(data) if data else Path(tempfile.gettempdir()) / f"hnf-{name}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
