"""Image datablocks: their files, hashes of their pixels, unsaved paint, and the names of the textures of a material.

The names matter because what an artist called a texture often says which material it shows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PureWindowsPath
from typing import Any

from hnf_core.errors import SceneError
from hnf_core.files import content_hash
from hnf_core.progress import add_work
from hnf_core.scene.file_kind import FileKind, identify

from ... import compat
from .node_graph import iter_nodes

ANIMATED_SOURCES = frozenset({"SEQUENCE", "MOVIE"})
NUMBERED_NAME = re.compile(r"(.*?)(\d+)(\D*)", re.DOTALL)
"""Parts of a frame's file name without suffix: text before the last number, the number, text after it."""


def list_image_files(image: Any) -> list[Path]:
    """Return an image's files, one per UDIM tile; none if it is packed, painted or generated."""
    if image.packed_files or image.is_dirty or image.source not in {"FILE", "TILED", "SEQUENCE", "MOVIE"}:
        return []
    path = get_absolute_path(image.filepath, image.library)
    if image.source == "TILED":
        return [_get_tile_path(str(path), tile.number) for tile in image.tiles]
    return [path]


def get_absolute_path(text: str, library: Any) -> Path:
    """Return the absolute path of a file as Blender finds it, from a text that may be relative to a .blend.

    Backslashes separate folders on every system, as in what Windows programs wrote; Blender's own function for add-ons
    leaves them.
    """
    import bpy

    return Path(bpy.path.abspath(text, library=library).replace("\\", "/"))


def read_file_bytes(path: Path) -> bytes:
    """Return the content of a file that is to be hashed."""
    add_work("hashed_files", item=str(path))
    return path.read_bytes()


def fingerprint_file(path: Path) -> str:
    """Identify a file's version by path, size and modification time, without reading it, as movies are large."""
    status = path.stat()
    return f"{path}\0{status.st_size}\0{status.st_mtime_ns}"


def hash_image(
    image: Any, user: Any = None, frame: int = 1, read_file: Callable[[Path], bytes | str] = read_file_bytes
) -> str:
    """Hash an image's stored pixels: packed bytes, files (all tiles of a UDIM), or generator settings.

    Parameters
    ----------
    image : bpy.types.Image or None
        Image; None gives "".
    user : bpy.types.ImageUser, optional
        Image user of the node, which selects the frame of a sequence or movie.
    frame : int, default 1
        Scene frame.
    read_file : callable, optional
        Content of an external file that counts; the file's bytes by default.

    Returns
    -------
    str
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
    if image.is_dirty:  # painted but not saved: only the pixels in memory are current
        return content_hash(*settings, _read_pixels(image))
    if image.packed_files:
        return content_hash(*settings, *(bytes(packed.packed_file.data) for packed in image.packed_files))
    if image.source == "GENERATED":
        return content_hash(
            *settings, repr((image.generated_type, list(image.generated_color), list(image.size), image.is_float))
        )
    files = list_image_files(image)
    if image.source == "SEQUENCE" and user is not None:
        files = [get_frame_file(path, get_shown_frame(user, frame)) for path in files]
    return content_hash(*settings, *(read_file(path) for path in files if path.is_file()))


def get_shown_frame(user: Any, frame: int) -> int:
    """Return the number of a sequence's or movie's image that is shown at a scene frame, as Blender counts."""
    count = user.frame_duration
    if count == 0:
        return 0
    index = frame - user.frame_start + 1
    index = (index - 1) % count + 1 if user.use_cyclic else min(max(index, 0), count)
    return int(index + user.frame_offset)


def get_frame_file(path: Path, number: int) -> Path:
    """Return the file of image `number` in the sequence that `path` belongs to; `path` if its name has no number."""
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


JPEG_START, JPEG_TABLES, JPEG_SCAN = b"\xff\xd8", 0xDB, 0xDA
"""Start of a JPEG file, marker of its quantization tables, and marker after which there are none."""
JPEG_HEADER_BYTES = 2**18
"""Largest part of a JPEG file in which its tables are looked for: they come after at most a few embedded profiles."""


def get_rounding_step(image: Any) -> float:
    """Return the step to which an image's values are rounded, 1 being white; 0 for floating-point pixels.

    It is 1/255 with eight bits. A JPEG rounds the mean and the slope of each block of 8 × 8 pixels to coarser steps.
    """
    if image is None or image.is_float:
        return 0.0
    return max(1.0, parse_jpeg_step(_read_image_start(image))) / 255.0


def _read_image_start(image: Any) -> bytes:
    """Return the first bytes of an image's file or of its packed data; b"" if there is neither."""
    if image.packed_files:
        return bytes(image.packed_files[0].packed_file.data[:JPEG_HEADER_BYTES])
    for path in list_image_files(image)[:1]:
        try:
            with path.open("rb") as stream:
                return stream.read(JPEG_HEADER_BYTES)
        except OSError:
            return b""
    return b""


def parse_jpeg_step(data: bytes) -> float:
    """Return the step [codes] to which a JPEG rounds the grey of a block of 8 × 8 pixels; 0 for anything else.

    It is the step of the block's mean, an eighth of the first entry of the quantization table (ITU-T T.81), and that of
    a ramp across the block.
    """
    position = 2
    while data[:2] == JPEG_START and position + 4 <= len(data) and data[position] == 0xFF:
        marker, length = data[position + 1], int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == JPEG_SCAN:
            break
        if marker == JPEG_TABLES:
            precision = data[position + 4] >> 4 if position + 4 < len(data) else 0
            size = 2 if precision else 1
            start = position + 5
            table = [int.from_bytes(data[start + size * i : start + size * (i + 1)], "big") for i in range(3)]
            return table[0] / 8.0 + max(table[1:]) / 4.0
        position += 2 + length
    return 0.0


def get_image_size(image: Any) -> tuple[int, int]:
    """Return an image's (width, height) in texels.

    Blender does not know the size of a sequence while it shows a missing frame; the sequence's first file is then
    loaded as another datablock, which the caller's TemporaryScene removes.
    """
    import bpy

    if 0 in tuple(image.size) and image.source == "SEQUENCE":
        for path in list_image_files(image):
            if path.is_file():
                image = bpy.data.images.load(str(path))
    return int(image.size[0]), int(image.size[1])


GREY_DIFFERENCE = 2.5 / 255.0
"""Difference of color channels up to which a picture is grey, or a channel constant."""


def is_grey(image: Any) -> bool:
    """Return True if a picture has no colors; False for one without pixels."""
    import numpy as np

    if 0 in tuple(image.size):
        return False
    pixels = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(pixels)
    colours = pixels.reshape(-1, image.channels)[:, :3]
    return bool(image.channels < 3 or np.ptp(colours, axis=1).max(initial=0.0) <= GREY_DIFFERENCE)


def make_data_image(path: Path) -> Any:
    """Return a new image of a file whose values are data, not colors; also of a file that is missing."""
    import bpy

    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError:
        image = bpy.data.images.new(path.name, 1, 1)
        image.source, image.filepath = "FILE", str(path)
    image.colorspace_settings.name = "Non-Color"
    return image


def decode_image(data: bytes, where: str) -> Any:
    """Decode the bytes of a picture (WebP, PNG …) to an array of uint8, (H, W, 4), the first row on top.

    Blender decodes it, which tells of a damaged one by zeros alone, opacity too: such a picture raises ValueError, with
    `where` in it.
    """
    import bpy
    import numpy as np

    from ..scene.temp_scene import suppress_output

    image = bpy.data.images.new("splats", 1, 1)
    try:
        with suppress_output():
            image.pack(data=data, data_len=len(data))
            image.source, image.alpha_mode = "FILE", "CHANNEL_PACKED"
            image.colorspace_settings.name = "Non-Color"
            width, height = image.size
            pixels = np.zeros(len(image.pixels), dtype=np.float32)
            image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    if not pixels.any() or len(pixels) != 4 * width * height:
        raise ValueError(f"a picture of {where} cannot be decoded")
    return np.rint(255.0 * pixels).astype(np.uint8).reshape(height, width, 4)[::-1]


COPIED_FROM = "hnf_copied_from"
"""ID property of a temporary copy of an image: the name of the original."""


def copy_as_data(image: Any) -> Any:
    """Return a copy of an image whose values are read as data; None if it has pixels in memory alone."""
    if image.is_dirty or (image.source == "GENERATED" and not image.packed_files):
        return None
    copy = image.copy()
    copy.colorspace_settings.name = "Non-Color"
    copy[COPIED_FROM] = image.name
    return copy


def explain_missing_image(image: Any) -> str | None:
    """Explain why an image has no pixels ("PATH is missing"), or return None if it has.

    Frames of a sequence are not checked.
    """
    if image.source != "SEQUENCE":
        for path in list_image_files(image):
            if not path.is_file():
                return f"{path} is missing"
    if image.source in {"FILE", "GENERATED"} and 0 in tuple(image.size):
        kind = _identify_unreadable(image)
        what = "cannot be read as a picture" if kind is None else f"is {kind.what}, which cannot be read as a picture"
        return f"{image.filepath} {what}"
    return None


def get_missing_remedy(image: Any) -> str:
    """Return what to do about an image without pixels."""
    kind = _identify_unreadable(image)
    if kind is None:
        return "Bring the file back, or find it with File > External Data > Find Missing Files."
    return kind.remedy


def _identify_unreadable(image: Any) -> FileKind | None:
    """Return what the file of an image is, if it is of a kind that Blender does not read as a picture."""
    kind = identify(_read_image_start(image))
    return None if kind is None or kind.suffix or "picture" in kind.what else kind


def _get_tile_path(path: str, number: int) -> Path:
    """Return the path of UDIM tile `number`, given a path with a tile placeholder."""
    u, v = (number - 1001) % 10 + 1, (number - 1001) // 10 + 1
    return Path(path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{u}_v{v}"))


UNSAVED_IMAGE_REMEDY = "Save it (Image > Save in the Image Editor) or pack it (Image > Pack), and try again."


def check_images_saved(objects: Iterable[Any]) -> None:
    """Raise SceneError for the first texture with unsaved paint, which a copy of the file would lack."""
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
    """Return True if an image was painted and not saved, so that a render would read its old file."""
    return bool(image.is_dirty) and image.source in {"FILE", "TILED"} and not image.packed_files


IMAGE_NODES = frozenset({"ShaderNodeTexImage"})
GROUP_NODE, GROUP_OUTPUT_NODE = "ShaderNodeGroup", "NodeGroupOutput"


def list_texture_names(material: Any) -> tuple[str, ...]:
    """Return the names of all images that a material's surface depends on, and of their files if different.

    Each name occurs once, in the order of the images' names. () for None and for a material without nodes.
    """
    if material is None or not compat.use_nodes(material) or material.node_tree is None:
        return ()
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return ()
    images = {node.image.name_full: node.image for node in _iter_image_nodes(output, set()) if node.image is not None}
    return tuple(dict.fromkeys(name for key in sorted(images) for name in _iter_image_names(images[key])))


def _iter_image_names(image: Any) -> Iterator[str]:
    """Yield an image's name, and its file's name if that is different."""
    yield str(image.name)
    file = PureWindowsPath(image.filepath).name if image.filepath else ""  # splits at both kinds of slash
    if file and not image.name.startswith(file):
        yield file


def _iter_image_nodes(node: Any, visited: set[int]) -> Iterator[Any]:
    """Yield the image nodes that a node depends on, those inside node groups included; `visited` nodes are skipped."""
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
        for link in socket.links if socket.is_linked else ():
            if not link.is_muted and link.is_valid:
                yield from _iter_image_nodes(link.from_node, visited)
