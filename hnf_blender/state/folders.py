"""Where the add-on keeps what it can make again."""

from __future__ import annotations

from pathlib import Path

PACKAGE = __name__.rsplit(".", 2)[0]


def cache_folder() -> Path:
    """Close-ups of earlier bakes, named by content. Made where it is missing; survives upgrades of an extension."""
    import tempfile  # brings shutil and four packers along: 3 ms that switching on need not take

    import bpy

    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path="cache", create=True))
    data = bpy.utils.user_resource("DATAFILES", path="hnf/cache", create=True)
    folder = Path(data) if data else Path(tempfile.gettempdir()) / "hnf-cache"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
