"""Where the add-on keeps what it can make again, and what it learned."""

from __future__ import annotations

from pathlib import Path

PACKAGE = __name__.rsplit(".", 2)[0]


def get_cache_folder() -> Path:
    """Close-ups of earlier bakes, named by content. Made where it is missing; survives upgrades of an extension."""
    return _make_data_folder("cache")


def get_learned_folder() -> Path:
    """Learned materials, and what an unfinished lesson goes on from; likewise."""
    return _make_data_folder("learned")


def _make_data_folder(name: str) -> Path:
    import tempfile  # brings shutil and four packers along: 3 ms that switching on need not take

    import bpy

    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path=name, create=True))
    data = bpy.utils.user_resource("DATAFILES", path=f"hnf/{name}", create=True)
    folder = Path(data) if data else Path(tempfile.gettempdir()) / f"hnf-{name}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
