"""Image datablocks and the files behind them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hnf_core.files import content_hash

ANIMATED_SOURCES = frozenset({"SEQUENCE", "MOVIE"})
NUMBERED_NAME = re.compile(r"(.*?)(\d+)(\D*)", re.DOTALL)
"""A frame's file name without its suffix: what stands before the last number, the number, and what follows."""


def list_image_files(image: Any) -> list[Path]:
    """The files an image is read from, one per tile of a UDIM; none where it is packed, painted or generated."""
    import bpy

    if image.packed_files or image.is_dirty or image.source not in {"FILE", "TILED", "SEQUENCE", "MOVIE"}:
        return []
    path = bpy.path.abspath(image.filepath, library=image.library)
    if image.source == "TILED":
        return [_get_tile_path(path, tile.number) for tile in image.tiles]
    return [Path(path)]


def read_file_bytes(path: Path) -> bytes:
    return path.read_bytes()


def fingerprint_file(path: Path) -> str:
    """What tells a file from what it was without reading it: a film or a texture may be of any size."""
    facts = path.stat()
    return f"{path}\0{facts.st_size}\0{facts.st_mtime_ns}"


def hash_image(
    image: Any, user: Any = None, frame: int = 1, read_file: Callable[[Path], bytes | str] = read_file_bytes
) -> str:
    """Hash of an image's pixels as stored: packed bytes, files (all tiles of a UDIM), or generated settings.

    user: the node's image user, which says which part of a sequence or movie is shown at scene frame `frame`.
    of_file: what of a file outside counts.
    """
    if image is None:
        return ""
    settings = [repr((image.colorspace_settings.name, image.alpha_mode, image.source))]
    if image.source == "TILED":
        settings.append(repr([tile.number for tile in image.tiles]))
    if image.source in ANIMATED_SOURCES and user is not None:
        settings.append(repr(get_shown_frame(user, frame)))
    if image.type == "MULTILAYER" and user is not None:
        settings.append(repr((user.multilayer_layer, user.multilayer_pass, user.multilayer_view)))
    if image.is_dirty:  # painted but not saved: the pixels in memory are the truth
        return content_hash(*settings, _read_pixels(image))
    if image.packed_files:
        return content_hash(*settings, *(bytes(each.packed_file.data) for each in image.packed_files))
    if image.source == "GENERATED":
        return content_hash(
            *settings, repr((image.generated_type, list(image.generated_color), list(image.size), image.is_float))
        )
    files = list_image_files(image)
    if image.source == "SEQUENCE" and user is not None:
        files = [get_frame_file(path, get_shown_frame(user, frame)) for path in files]
    return content_hash(*settings, *(read_file(path) for path in files if path.is_file()))


def get_shown_frame(user: Any, frame: int) -> int:
    """Number of the image of a sequence or movie that an image user shows at a scene frame, as Blender counts."""
    count = user.frame_duration
    if count == 0:
        return 0
    place = frame - user.frame_start + 1
    place = (place - 1) % count + 1 if user.use_cyclic else min(max(place, 0), count)
    return int(place + user.frame_offset)


def get_frame_file(path: Path, number: int) -> Path:
    """The file of that number in the sequence that path is one of; path where its name holds no number."""
    parts = NUMBERED_NAME.fullmatch(path.stem)
    if parts is None:
        return path
    before, digits, after = parts.groups()
    return path.with_name(f"{before}{max(number, 0):0{len(digits)}d}{after}{path.suffix}")


def _read_pixels(image: Any) -> bytes:
    import numpy as np

    pixels = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.tobytes()


def get_image_size(image: Any) -> tuple[int, int]:
    """(width, height) in texels. Of a sequence Blender knows it only while it shows a frame that is there: then the
    file that it was opened by tells, in a datablock of its own, which is left to the caller's Temporary."""
    import bpy

    if 0 in tuple(image.size) and image.source == "SEQUENCE":
        for path in list_image_files(image):
            if path.is_file():
                image = bpy.data.images.load(str(path))
    return int(image.size[0]), int(image.size[1])


def explain_missing_image(image: Any) -> str | None:
    """Why an image datablock has no pixels ("PATH is missing"), or None where it has. Frames of a sequence are not
    looked for."""
    if image.source != "SEQUENCE":
        for path in list_image_files(image):
            if not path.is_file():
                return f"{path} is missing"
    if image.source in {"FILE", "GENERATED"} and 0 in tuple(image.size):
        return f"{image.filepath} cannot be read as a picture"
    return None


def _get_tile_path(path: str, number: int) -> Path:
    u, v = (number - 1001) % 10 + 1, (number - 1001) // 10 + 1
    return Path(path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{u}_v{v}"))
