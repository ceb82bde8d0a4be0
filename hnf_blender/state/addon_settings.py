"""Preferences of the add-on, with defaults where there are none, and the folders for caches and learned materials."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import bpy

ADDON_PACKAGE = __package__.rpartition(".")[0]
"""Name of the add-on's package, under which Blender stores its preferences."""


class Settings(NamedTuple):
    """Defaults used if the add-on was not enabled through the preferences (tests, command line).

    Attributes
    ----------
    overlay : bool
        Draw strokes in the 3D view.
    default_probe : str
        Probe of new strokes.
    output : str
        Target that strokes are played on.
    external_python : str
        Python interpreter that learns materials; "" for none.
    guide_done : bool
        The first steps were finished once.
    """

    overlay: bool = True
    default_probe: str = "pen"
    output: str = ""
    external_python: str = ""
    guide_done: bool = False


DEFAULT_SETTINGS = Settings()


def get_settings(context: Any = None) -> Any:
    """Return the add-on's preferences, or DEFAULT_SETTINGS, which has the same attributes."""
    addon = (context or bpy.context).preferences.addons.get(ADDON_PACKAGE)
    return DEFAULT_SETTINGS if addon is None or addon.preferences is None else addon.preferences


_session = {"guide_done": False}
"""Values of a session without preferences."""


def is_guide_done(context: Any = None) -> bool:
    """Return whether the first steps were finished, in this session or an earlier one."""
    return bool(_session["guide_done"] or get_settings(context).guide_done)


def finish_guide(done: bool = True) -> None:
    """Note that the first steps are finished (a stroke was heard), so that no later session shows them."""
    settings = get_settings()
    _session["guide_done"] = done
    if not isinstance(settings, Settings) and settings.guide_done != done:
        settings.guide_done = done
        bpy.context.preferences.is_dirty = True


def get_cache_folder() -> Path:
    """Return the folder of cached close-ups, created if missing; it survives upgrades of an extension."""
    return _make_data_folder("cache")


def get_learned_folder() -> Path:
    """Return the folder of learned materials and unfinished training; created if missing."""
    return _make_data_folder("learned")


def _make_data_folder(name: str) -> Path:
    import tempfile  # Imports shutil and compressors, 3 ms that enabling the add-on should not take.

    import bpy

    if ADDON_PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON_PACKAGE, path=name, create=True))
    data = bpy.utils.user_resource("DATAFILES", path=f"hnf/{name}", create=True)
    folder = Path(data) if data else Path(tempfile.gettempdir()) / f"hnf-{name}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
