"""Image datablocks and the files behind them.

Textures that were painted and not saved: their pixels are in memory alone.

Names of the pictures that feed a shader: what an artist called a texture says what it shows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PureWindowsPath
from typing import Any

from hnf_core.errors import SceneError
from hnf_core.files import content_hash

from ... import compat
from .node_graph import iter_nodes

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


UNSAVED_IMAGE_REMEDY = "Save it (Image > Save in the Image Editor) or pack it (Image > Pack), and try again."


def check_images_saved(objects: Iterable[Any]) -> None:
    """Raises SceneError for the first texture on objects whose pixels a copy of the file would not hold."""
    for obj in objects:
        for slot in obj.material_slots:
            for node in iter_nodes(None if slot.material is None else slot.material.node_tree):
                image = getattr(node, "image", None)
                if image is not None and image.is_dirty:
                    raise SceneError(
                        f"its texture '{image.name}' was painted and is not saved, and a bake works on what is saved.",
                        where=f"object '{obj.name}', material '{slot.material.name}'",
                        remedy=UNSAVED_IMAGE_REMEDY,
                    )


def has_unsaved_paint(image: Any) -> bool:
    """Was it painted, and would a render read its file instead, and forget the painting?"""
    return bool(image.is_dirty) and image.source in {"FILE", "TILED"} and not image.packed_files


IMAGE_NODES = frozenset({"ShaderNodeTexImage"})
GROUP_NODE, GROUP_OUTPUT_NODE = "ShaderNodeGroup", "NodeGroupOutput"


def list_texture_names(material: Any) -> tuple[str, ...]:
    """Of every image that material's surface is computed from: the datablock's name, and its file's where that is
    another; each once, in the order of the nodes' names. () for no material, or one without nodes."""
    if material is None or not compat.use_nodes(material) or material.node_tree is None:
        return ()
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return ()
    images = {node.image.name_full: node.image for node in _iter_image_nodes(output, set()) if node.image is not None}
    return tuple(dict.fromkeys(name for key in sorted(images) for name in _iter_image_names(images[key])))


def _iter_image_names(image: Any) -> Iterator[str]:
    yield str(image.name)
    file = PureWindowsPath(image.filepath).name if image.filepath else ""  # splits at both kinds of slash
    if file and not image.name.startswith(file):
        yield file


def _iter_image_nodes(node: Any, visited: set[int]) -> Iterator[Any]:
    """Image nodes that node depends on, its own groups' insides included."""
    if node.as_pointer() in visited:
        return
    visited.add(node.as_pointer())
    if node.bl_idname in IMAGE_NODES and not node.mute:
        yield node
    if node.bl_idname == GROUP_NODE and node.node_tree is not None and not node.mute:
        for inner in node.node_tree.nodes:
            if inner.bl_idname == GROUP_OUTPUT_NODE:
                yield from _iter_image_nodes(inner, visited)
    for socket in node.inputs:
        for link in socket.links:
            if not link.is_muted and link.is_valid:
                yield from _iter_image_nodes(link.from_node, visited)
