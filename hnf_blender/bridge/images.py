"""Image datablocks and the files behind them."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def image_files(image: Any) -> list[Path]:
    """The files an image is read from, one per tile of a UDIM; none where it is packed, painted or generated."""
    import bpy

    if image.packed_files or image.is_dirty or image.source not in {"FILE", "TILED", "SEQUENCE", "MOVIE"}:
        return []
    path = bpy.path.abspath(image.filepath, library=image.library)
    if image.source == "TILED":
        return [_tile_path(path, tile.number) for tile in image.tiles]
    return [Path(path)]


def missing_image(image: Any) -> str | None:
    """Why an image datablock has no pixels ("PATH is missing"), or None where it has. Frames of a sequence are not
    looked for."""
    if image.source != "SEQUENCE":
        for path in image_files(image):
            if not path.is_file():
                return f"{path} is missing"
    if image.source in {"FILE", "GENERATED"} and 0 in tuple(image.size):
        return f"{image.filepath} cannot be read as a picture"
    return None


def _tile_path(path: str, number: int) -> Path:
    u, v = (number - 1001) % 10 + 1, (number - 1001) // 10 + 1
    return Path(path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{u}_v{v}"))
