"""Open scene files of every supported format in Blender, or raise one clear error.

A .blend is opened as it is. Meshes, Gaussian splats and nerfstudio exports (geometry next to a transforms.json, which
also gives a camera per image) are imported into an empty scene. The relief of an OBJ is restored as the .mtl means it:
Blender makes a normal map of every `map_Bump`, tagged as a color, and drops `norm` and `disp`. In the format `map_Bump`
is a grey height, times `-bm` in the units of the file; many programs write a normal map there.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.errors import FileError, SceneError, make_damaged_error
from hnf_core.progress import ProgressCallback, ignore_progress
from hnf_core.scene.camera import Camera
from hnf_core.scene.file_kind import identify, read_head
from hnf_core.scene.gltf_document import check_gltf, describe_unread, is_splat_document, read_gltf_document
from hnf_core.scene.nerfstudio import OPENGL_CAMERA_AXES, NerfstudioFrame, read_model_transforms
from hnf_core.scene.ply import check_faces, read_ply_header
from hnf_core.scene.splats.splat_file import SPLAT_SUFFIXES, open_splat_file
from hnf_core.tables import is_number

from ..supervisor import announce_read
from .scene.stored_data import show_vertex_colours
from .scene.temp_scene import suppress_output
from .shader.images import is_grey, make_data_image

KEYWORDS = {
    "bump": "bump", "map_bump": "bump", "norm": "norm", "map_norm": "norm", "map_kn": "norm", "disp": "disp",
    "map_disp": "disp",
}  # fmt: skip
"""Statement of a .mtl file, in lower case → kind of relief."""
OPTION_COUNTS = {
    "-bm": 1, "-mm": 2, "-blendu": 1, "-blendv": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-texres": 1,
    "-type": 1,
}  # fmt: skip
"""Option of a texture statement → number of its values; -o, -s and -t have one to three."""


@dataclass(frozen=True)
class ReliefMap:
    """One texture statement of a .mtl file that gives a relief.

    Attributes
    ----------
    file : str
        Path of the picture, as written.
    multiplier : float
        -bm: height of white in units of the file (bump), or strength (norm).
    base, gain : float
        -mm: value v of the picture counts as base + gain · v.
    offset, scale : tuple of float
        -o and -s of the texture coordinates.
    """

    file: str
    multiplier: float = 1.0
    base: float = 0.0
    gain: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)


def parse_relief_map(text: str) -> ReliefMap | None:
    """Parse what follows the keyword of a texture statement; None if it names no file or an option has no number."""
    words, values = text.split(), {}
    while words and words[0] in {*OPTION_COUNTS, "-o", "-s", "-t"}:
        option = words.pop(0)
        count = OPTION_COUNTS.get(option, 3)
        numbers: list[str] = []
        while words and len(numbers) < count and (option in OPTION_COUNTS or is_number(words[0])):
            numbers.append(words.pop(0))
        values[option] = numbers
    if not words:
        return None
    try:
        base, gain = (float(each) for each in values.get("-mm", ("0", "1")))
        multiplier = float(values.get("-bm", ["1"])[0])
        offset, scale = (
            tuple([*(float(each) for each in values.get(name, ())), *default][:3])
            for name, default in (("-o", (0.0, 0.0, 0.0)), ("-s", (1.0, 1.0, 1.0)))
        )
    except (ValueError, IndexError):
        return None
    return ReliefMap(text[text.index(words[0]) :].strip(), multiplier, base, gain, offset, scale)


def parse_mtl(text: str) -> dict[str, dict[str, ReliefMap]]:
    """Return material name → kind of relief ("bump", "norm" or "disp") → its map, of the text of a .mtl file."""
    materials: dict[str, dict[str, ReliefMap]] = {}
    current: dict[str, ReliefMap] = {}
    for line in text.splitlines():
        keyword, _, rest = line.strip().partition(" ")
        if keyword == "newmtl":
            current = materials.setdefault(rest.strip(), {})
        elif keyword.lower() in KEYWORDS and (relief := parse_relief_map(rest.strip())) is not None:
            current[KEYWORDS[keyword.lower()]] = relief
    return materials


def restore_obj_relief(path: Path) -> None:
    """Give the materials that were imported from an .obj file the relief of its .mtl files.

    Raises FileError for a .mtl file that is something else.
    """
    import bpy

    for library in dict.fromkeys(_iter_libraries(path)):
        kind = identify(read_head(library))
        if kind is not None:
            raise FileError(f"is {kind.what}.", where=str(library), remedy=kind.remedy or "Export it again.")
        for name, reliefs in parse_mtl(library.read_text(encoding="utf-8", errors="replace")).items():
            material = bpy.data.materials.get(name)
            if material is not None and reliefs:
                _set_relief(material, reliefs, library.parent)


def _iter_libraries(path: Path) -> Iterator[Path]:
    """Yield the existing .mtl files that an .obj file names."""
    with path.open("rb") as stream:
        for line in stream:
            if line.startswith(b"mtllib"):
                library = path.parent / line[6:].decode("utf-8", "replace").strip()
                if library.is_file():
                    yield library


def _set_relief(material: Any, reliefs: dict[str, ReliefMap], folder: Path) -> None:
    tree = material.node_tree
    shader = next((node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"), None)
    if shader is None:
        return
    for node in _find_nodes_before(shader.inputs["Normal"]):  # Blender's reading
        tree.nodes.remove(node)
    if "norm" in reliefs:
        tree.links.new(_add_normal_map(tree, reliefs["norm"], folder), shader.inputs["Normal"])
    if "bump" in reliefs:
        _connect_bump(tree, shader, reliefs["bump"], folder)
    output = tree.get_output_node("CYCLES")
    if "disp" in reliefs and output is not None:
        relief = reliefs["disp"]
        node = tree.nodes.new("ShaderNodeDisplacement")
        node.inputs["Midlevel"].default_value = 0.0
        node.inputs["Scale"].default_value = relief.gain * relief.multiplier
        tree.links.new(_add_picture(tree, relief, folder).outputs["Color"], node.inputs["Height"])
        tree.links.new(node.outputs[0], output.inputs["Displacement"])


def _find_nodes_before(socket: Any) -> list[Any]:
    """Return the nodes that a socket depends on, each once."""
    nodes: dict[str, Any] = {}
    pending = [socket]
    while pending:
        for link in pending.pop().links:
            if link.from_node.name not in nodes:
                nodes[link.from_node.name] = link.from_node
                pending += link.from_node.inputs
    return list(nodes.values())


def _connect_bump(tree: Any, shader: Any, relief: ReliefMap, folder: Path) -> None:
    """Connect a `map_Bump`: a Bump node for a grey picture, a Normal Map node for one of normals."""
    picture = _add_picture(tree, relief, folder)
    if not is_grey(picture.image):
        tree.nodes.remove(picture)
        if not shader.inputs["Normal"].links:
            tree.links.new(_add_normal_map(tree, relief, folder), shader.inputs["Normal"])
        return
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value = relief.multiplier * relief.gain
    bump.inputs["Strength"].default_value = 1.0
    tree.links.new(picture.outputs["Color"], bump.inputs["Height"])
    for link in list(shader.inputs["Normal"].links):
        tree.links.new(link.from_socket, bump.inputs["Normal"])
    tree.links.new(bump.outputs[0], shader.inputs["Normal"])


def _add_normal_map(tree: Any, relief: ReliefMap, folder: Path) -> Any:
    node = tree.nodes.new("ShaderNodeNormalMap")
    node.inputs["Strength"].default_value = max(relief.multiplier, 0.0)
    tree.links.new(_add_picture(tree, relief, folder).outputs["Color"], node.inputs["Color"])
    return node.outputs[0]


def _add_picture(tree: Any, relief: ReliefMap, folder: Path) -> Any:
    """Add an Image Texture node with a picture read as data, at the statement's texture coordinates."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = make_data_image(folder / relief.file.replace("\\", "/"))
    if not np.allclose(relief.offset, 0.0) or not np.allclose(relief.scale, 1.0):
        mapping, uv = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
        mapping.inputs["Location"].default_value = relief.offset
        mapping.inputs["Scale"].default_value = relief.scale
        tree.links.new(uv.outputs["UV"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs[0], node.inputs["Vector"])
    return node


EXPORT_MESHES = ("mesh.obj", "poisson_mesh.ply", "tsdf_mesh.ply", "sdf_marching_cubes_mesh.ply")
EXPORT_SPLATS = "splat.ply"
EXPORT_POINTS = "point_cloud.ply"
"""File names that ns-export writes."""
CAMERA_COLLECTION = "Cameras"
SENSOR_MM = 36.0
"""Sensor width of the cameras [mm]."""
CLIP_RANGE = (1e-3, 1e4)
"""Near and far clipping distance of the cameras [Blender units]."""
CAMERA_SYMBOL_FRACTION = 0.05
"""Size of a camera's symbol in the viewport, as a fraction of the cameras' largest extent along an axis."""


def open_nerfstudio_export(path: Path, open_geometry: Callable[[Path], Any]) -> Any:
    """Open the geometry of a nerfstudio export in the export's frame (z up), and add its cameras.

    The geometry file and transforms.json are checked before the current scene is replaced.

    Parameters
    ----------
    path : Path
        The export's transforms.json.
    open_geometry : callable
        Opens a geometry file and returns its scene; its errors are passed on.

    Returns
    -------
    bpy.types.Scene

    Raises
    ------
    FileError
        If transforms.json cannot be used or there is no geometry next to it.
    """
    frames = read_model_transforms(path)
    geometry = find_geometry(path)
    scene = open_geometry(geometry)
    for obj in scene.objects:
        if obj.parent is None:  # undo the rotation that importers apply to files without an up axis
            obj.rotation_mode = "QUATERNION"
            obj.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    add_cameras(scene, frames)
    scene.view_layers[0].update()
    return scene


def find_geometry(path: Path) -> Path:
    """Return the geometry file in the folder of a nerfstudio transforms.json (`path`).

    In order of preference: a mesh with colors, splats, a mesh without colors, a point cloud (which is refused when it
    is opened). Raises FileError if there is none of these.
    """
    existing = [path.with_name(name) for name in (*EXPORT_MESHES, EXPORT_SPLATS, EXPORT_POINTS)]
    existing = [file for file in existing if file.is_file()]
    coloured = [file for file in existing if file.name in EXPORT_MESHES and has_colours(file)]
    splats = [file for file in existing if file.name == EXPORT_SPLATS]
    candidates = [*coloured, *splats, *existing]
    if not candidates:
        raise FileError(
            f"there is no geometry next to it (looked for {', '.join((*EXPORT_MESHES, EXPORT_SPLATS))}).",
            where=str(path),
            remedy="Export it with ns-export gaussian-splat or ns-export poisson into the same folder.",
        )
    return candidates[0]


def has_colours(mesh: Path) -> bool:
    """Return True if a mesh file has vertex colors or, for an .obj, a material with an image."""
    if mesh.suffix == ".ply":
        header = read_ply_header(mesh)
        return header.count("face") > 0 and {"red", "green", "blue"} <= set(header.names("vertex"))
    with mesh.open("rb") as stream:
        for line in stream:
            if line.startswith(b"mtllib "):
                return _has_texture(mesh, line.split(maxsplit=1)[1].decode("utf-8", "replace").strip())
            if line.startswith(b"v "):
                return len(line.split()) >= 7
    return False


def _has_texture(mesh: Path, name: str) -> bool:
    """Return True if the .mtl file `name`, inside the mesh's folder, refers to an image."""
    library = mesh.parent / name
    if not library.resolve().is_relative_to(mesh.parent.resolve()) or not library.is_file():
        return False
    return any(line.lstrip().startswith(b"map_Kd") for line in library.read_bytes().splitlines())


def add_cameras(scene: Any, frames: Sequence[NerfstudioFrame]) -> None:
    """Add one camera per nerfstudio frame (image with its pose), named after the image, in a collection of their own.

    The first becomes the scene's camera and sets the render size. A Blender scene renders all cameras at one size: the
    others show their own width, and more or less of their height if their images have another aspect ratio.
    """
    import bpy

    collection = bpy.data.collections.new(CAMERA_COLLECTION)
    scene.collection.children.link(collection)
    positions = np.array([frame.camera.pose[:3, 3] for frame in frames])
    symbol_size = CAMERA_SYMBOL_FRACTION * float(np.ptp(positions, axis=0).max())
    for frame in frames:
        camera = bpy.data.objects.new(frame.name, _make_camera_data(frame))
        camera.matrix_world = _make_camera_matrix(frame.camera)
        camera.data.display_size = symbol_size if symbol_size > 0.0 else CAMERA_SYMBOL_FRACTION
        collection.objects.link(camera)
        if scene.camera is None:
            scene.camera = camera
    first, render = frames[0].camera, scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = first.width, first.height, 100
    # Blender accepts no pixel aspect below 1.
    ratio = first.intrinsics[0, 0] / first.intrinsics[1, 1]
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0 / ratio, 1.0), max(ratio, 1.0)


def _make_camera_data(frame: NerfstudioFrame) -> Any:
    """Create Blender camera data with the frame's focal length and principal point."""
    import bpy

    camera, data = frame.camera, bpy.data.cameras.new(frame.name)
    focal_x, focal_y = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    data.type, data.sensor_fit, data.sensor_width = "PERSP", "HORIZONTAL", SENSOR_MM
    data.lens = focal_x / camera.width * SENSOR_MM
    data.shift_x = (camera.width / 2.0 - camera.intrinsics[0, 2]) / camera.width
    # Shifts are in image widths; a pixel's height is focal_x / focal_y times its width.
    data.shift_y = (camera.intrinsics[1, 2] - camera.height / 2.0) / camera.width * focal_x / focal_y
    data.clip_start, data.clip_end = CLIP_RANGE
    return data


def _make_camera_matrix(camera: Camera) -> Any:
    from mathutils import Matrix

    return Matrix((camera.pose @ OPENGL_CAMERA_AXES).tolist())


SCENE_SUFFIXES = (
    *(".blend", ".gltf", ".glb", ".obj", ".ply", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".stl", ".dae", ".json"),
    *SPLAT_SUFFIXES,
)
IMPORT_NOTES = "hnf_import_notes"
"""ID property of a scene: what could not be imported into it, one note a line."""
# A curve may be a stroke, and an empty may instance a collection of meshes; lights and cameras cannot be touched.
TOUCHABLE_TYPES = ("MESH", "SURFACE", "META", "FONT", "CURVE", "CURVES", "EMPTY")
# Blender compresses files with ZStandard (3.0 and later) or gzip (before).
BLEND_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")
STL_HEADER_BYTES, STL_FACE_BYTES = 84, 50
"""Sizes in a binary STL file: of its header, which ends with the number of faces, and of a face."""
USD_MAGIC = (b"#usda", b"PXR-USDC", b"PK\x03\x04")


def open_scene(
    path: Path,
    cache: Path | None = None,
    progress: ProgressCallback = ignore_progress,
    *,
    write_cache: bool = True,
) -> Any:
    """Open a scene file and return its scene, which becomes Blender's active one.

    A .blend is opened without its user interface and its Python scripts; every other format is imported into an empty
    scene. The current scene is kept if the file's header is refused, or if no surface can be made of its splats.

    Parameters
    ----------
    path : Path
        Scene file.
    cache : Path, optional
        Folder of cached reconstructions; None reconstructs splats every time.
    progress : callable, optional
        Called before each stage of a reconstruction.
    write_cache : bool, default True
        If False, the cache is only read.

    Returns
    -------
    bpy.types.Scene

    Raises
    ------
    FileError
        If the file is missing, damaged, of an unsupported format, or refers to a missing file.
    SceneError
        If there is nothing to touch in it.
    """
    import bpy

    path = Path(path).absolute()
    suffix = check_scene_file(path)
    if suffix == ".blend":
        with announce_read(path):
            _run_operator(path, lambda: bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False))
        scene = bpy.context.scene
        if not any(obj.type in TOUCHABLE_TYPES for obj in scene.objects):
            raise SceneError(
                f"its scene '{scene.name}' holds no object to touch.",
                where=str(path),
                remedy="Save the file with the right scene active.",
            )
        return scene
    if suffix == ".json":
        return open_nerfstudio_export(
            path, lambda geometry: open_scene(geometry, cache, progress, write_cache=write_cache)
        )
    if is_splat_file(path, suffix):
        return _open_splats(path, cache, progress, write_cache)
    importer = _find_importer(suffix, path)
    with announce_read(path):
        if suffix.startswith(".usd"):
            check_usd_meshes(path)
        open_empty_scene()
        _run_operator(path, lambda: importer(filepath=str(path)))
    scene = bpy.context.scene
    _check_import(scene, path)
    if suffix in {".ply", ".obj"}:
        for obj in scene.objects:
            show_vertex_colours(obj)
    if suffix == ".obj":
        restore_obj_relief(path)
    if suffix in {".gltf", ".glb"} and (notes := describe_unread(read_gltf_document(path))):
        scene[IMPORT_NOTES] = "\n".join(notes)
    return scene


def _open_splats(path: Path, cache: Path | None, progress: ProgressCallback, write_cache: bool) -> Any:
    """Import a splat file: its reconstructed surface and its splats."""
    import bpy

    from .splat_reconstruction import add_reconstruction, read_reconstruction

    reconstruction = read_reconstruction(path, cache, write_cache=write_cache, progress=progress)
    open_empty_scene()
    scene = bpy.context.scene
    add_reconstruction(scene, reconstruction)
    return scene


def open_empty_scene() -> None:
    """Replace the current file with a scene without objects; preferences and add-ons stay as they are."""
    import bpy

    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True, load_ui=False)


def check_scene_file(path: Path) -> str:
    """Return the ending of the kind of scene that a file is, or raise an error if Blender could not open it.

    Its first bytes count more than its name. This needs no Blender and changes nothing. Raises FileError if the file is
    missing, damaged or of an unsupported format, and SceneError if there is nothing to touch in it.
    """
    path = Path(path).absolute()
    where, suffix = str(path), path.suffix.lower()
    if not path.exists():
        raise FileError("there is no such file.", where=where, remedy="Check the path.")
    if not path.is_file():
        raise FileError("is not a file.", where=where, remedy="Give the scene file itself.")
    head = read_head(path)
    kind = identify(head)
    if kind is not None and not kind.suffix and (suffix in SCENE_SUFFIXES or kind.is_stand_in):
        raise FileError(f"is {kind.what}.", where=where, remedy=kind.remedy)
    if kind is not None and kind.suffix and _get_family(kind.suffix) != _get_family(suffix):
        if suffix.startswith(".usd") or kind.suffix.startswith(".usd"):  # Blender goes by the name
            raise FileError(f"is {kind.what}.", where=where, remedy=f"Rename it to {path.stem}{kind.suffix}.")
        suffix = kind.suffix
    if suffix not in SCENE_SUFFIXES:
        raise FileError(
            f"a file of kind '{suffix}' is no scene."
            if suffix
            else "it has no ending that says what kind of scene it is.",
            where=where,
            remedy=f"Give a scene: {' '.join(SCENE_SUFFIXES)}.",
        )
    if not head:
        raise make_damaged_error(path, "it is empty")
    starts = {
        ".blend": (BLEND_MAGIC, "a .blend file"),
        ".glb": ((b"glTF",), "a binary glTF file"),
        ".fbx": ((b"Kaydara FBX Binary", b";"), "an FBX file"),
    }
    starts |= {name: (USD_MAGIC, "a USD file") for name in SCENE_SUFFIXES if name.startswith(".usd")}
    if suffix in starts and not (head if suffix != ".fbx" else head.lstrip()).startswith(starts[suffix][0]):
        raise make_damaged_error(path, f"it does not begin like {starts[suffix][1]}")
    if is_splat_file(path, suffix):
        open_splat_file(path)
    elif suffix in {".gltf", ".glb"}:
        check_gltf(path)
    elif suffix == ".ply":
        _check_ply(path)
    elif suffix.startswith(".usd"):
        check_crate(path)
    if suffix == ".stl" and not _is_stl(path, head):
        raise make_damaged_error(path, "it is no STL file, neither text nor binary")
    return suffix


def is_splat_file(path: Path, suffix: str) -> bool:
    """Return True for a file of Gaussian splats; `suffix` is the ending of its kind."""
    if suffix == ".ply":
        return read_ply_header(path).is_splat
    return suffix in SPLAT_SUFFIXES or (suffix in {".gltf", ".glb"} and is_splat_document(read_gltf_document(path)))


def _is_stl(path: Path, head: bytes) -> bool:
    """Return True if a file is text that begins like an STL file, or as long as a binary one says it is."""
    if kind := identify(head):
        return kind.suffix == ".stl"
    if len(head) < STL_HEADER_BYTES:
        return False
    (count,) = struct.unpack("<I", head[STL_HEADER_BYTES - 4 : STL_HEADER_BYTES])
    return bool(path.stat().st_size >= STL_HEADER_BYTES + STL_FACE_BYTES * count)


def _get_family(suffix: str) -> str:
    """Return one name for endings of the same format."""
    return {".glb": ".gltf", ".usda": ".usd", ".usdc": ".usd"}.get(suffix, suffix)


def _check_ply(path: Path) -> None:
    """Raise SceneError if a .ply is a point cloud without splats, FileError if its faces are damaged."""
    header = read_ply_header(path)
    if header.count("face") == 0 and header.count("tristrips") == 0:
        raise SceneError(
            f"is a cloud of {header.count('vertex')} points without faces: there is no surface to touch.",
            where=str(path),
            remedy="Convert it to a mesh first (for example by Poisson reconstruction).",
        )
    check_faces(path, header)


CRATE_MAGIC = b"PXR-USDC"
CRATE_HEADER = struct.Struct("<8s8xq")
"""Magic, version and place of the table of contents."""
CRATE_COUNT = struct.Struct("<Q")
CRATE_SECTION = struct.Struct("<16sqq")
"""Name, start and size of a section."""
COUNTED_SECTIONS = ("TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS")
"""Sections that begin with the number of their entries."""
MAX_ENTRIES_PER_BYTE = 1024
"""Entries take two bits at least, and their compression (LZ4) makes 255 bytes of one at most."""


def check_crate(path: Path) -> None:
    """Raise FileError if a binary USD file's table of contents promises more than the file has; others pass.

    A table of 300 million sections in a file of 6 kB costs 9 GB and half a minute before the library finds out.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(CRATE_HEADER.size)
        if not head.startswith(CRATE_MAGIC):
            return
        start = CRATE_HEADER.unpack(head)[1] if len(head) == CRATE_HEADER.size else -1
        if not CRATE_HEADER.size <= start <= size - CRATE_COUNT.size:
            raise make_damaged_error(path, "its table of contents lies outside of it")
        stream.seek(start)
        (count,) = CRATE_COUNT.unpack(stream.read(CRATE_COUNT.size))
        if count > (size - start - CRATE_COUNT.size) // CRATE_SECTION.size:
            raise make_damaged_error(path, f"its table of contents wants {count} sections, and has no place for them")
        for name, at, length in list(CRATE_SECTION.iter_unpack(stream.read(count * CRATE_SECTION.size))):
            section = name.rstrip(b"\0").decode("ascii", "replace")
            if min(at, length) < 0 or at + length > size:
                raise make_damaged_error(path, f"its section '{section}' lies outside of it")
            if section not in COUNTED_SECTIONS:
                continue
            stream.seek(at)
            entries = int.from_bytes(stream.read(min(length, CRATE_COUNT.size)), "little")
            if entries > MAX_ENTRIES_PER_BYTE * length:
                raise make_damaged_error(path, f"its section '{section}' of {length} bytes wants {entries} entries")


def check_usd_meshes(path: Path) -> None:
    """Raise FileError if a USD file cannot be parsed, or a face of it is cut off or names a point that is not there.

    Blender's importer trusts all of it, and its process ends. Blender brings the library that this needs from 4.4 on;
    before, nothing is checked.
    """
    import bpy

    if not hasattr(bpy.utils, "expose_bundled_modules"):
        return
    bpy.utils.expose_bundled_modules()
    from pxr import Sdf, Tf, Usd, UsdGeom

    with suppress_output():
        try:
            layer = Sdf.Layer.Find(str(path))
            if layer is None:
                layer = Sdf.Layer.FindOrOpen(str(path))
            else:  # someone still holds what the file was before
                layer.Reload(True)
        except Tf.ErrorException as error:
            raise make_damaged_error(path, "it cannot be parsed") from error
        try:
            stage = Usd.Stage.Open(layer)
        except Tf.ErrorException:  # a file that it refers to cannot be parsed, which costs only what is in that
            return
        try:
            prims = [*stage.Traverse(), *(prim for each in stage.GetPrototypes() for prim in Usd.PrimRange(each))]
            for mesh in [UsdGeom.Mesh(prim) for prim in prims if prim.IsA(UsdGeom.Mesh)]:
                _check_usd_mesh(path, mesh, Usd.TimeCode.EarliestTime())
        except Tf.ErrorException as error:
            raise make_damaged_error(path, "a value in it cannot be read") from error


def _check_usd_mesh(path: Path, mesh: Any, earliest: Any) -> None:
    """Check one mesh at each of its time samples, since Blender reads an animated one anew at every frame."""
    counts, corners, points = attributes = (
        mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr(), mesh.GetPointsAttr(),
    )  # fmt: skip
    times = sorted({time for each in attributes for time in each.GetTimeSamples()}) or [earliest]
    is_fixed = not (counts.ValueMightBeTimeVarying() or corners.ValueMightBeTimeVarying())
    for time in times:
        name = f"'{mesh.GetPrim().GetName()}'" + (f" at frame {time:g}" if len(times) > 1 else "")
        if time is times[0] or not is_fixed:
            sizes, ends = (np.asarray([] if (found := each.Get(time)) is None else found) for each in (counts, corners))
            wanted, first, last = int(sizes.sum(dtype=np.int64)), ends.min(initial=0), ends.max(initial=-1)
            if sizes.min(initial=0) < 0 or wanted != len(ends):
                raise make_damaged_error(
                    path, f"the faces of mesh {name} want {wanted} corners, and {len(ends)} are there"
                )
        there = 0 if (found := points.Get(time)) is None else len(found)
        if first < 0 or (there and last >= there):  # without any points Blender makes a mesh without any
            raise make_damaged_error(path, f"a face of mesh {name} names a point that is not among its {there}")


def _find_importer(suffix: str, path: Path) -> Callable[..., Any]:
    """Return this Blender version's import operator; a disabled bundled importer is enabled for the session."""
    import bpy

    if suffix == ".obj":
        return bpy.ops.wm.obj_import  # type: ignore[no-any-return]
    if suffix == ".ply":
        return bpy.ops.wm.ply_import  # type: ignore[no-any-return]
    if suffix == ".stl":
        return bpy.ops.wm.stl_import  # type: ignore[no-any-return]
    if suffix == ".dae":
        if "collada_import" not in dir(bpy.ops.wm):  # gone in 5.0
            raise FileError(
                "is a COLLADA file, which Blender reads up to version 4.5.",
                where=str(path),
                remedy="Open it in Blender 4.5 and save a .blend, or export it as glTF.",
            )
        return bpy.ops.wm.collada_import  # type: ignore[no-any-return]
    if suffix.startswith(".usd"):
        return bpy.ops.wm.usd_import  # type: ignore[no-any-return]
    if suffix == ".fbx":
        if "fbx_import" in dir(bpy.ops.wm):  # from 4.5 on
            return bpy.ops.wm.fbx_import  # type: ignore[no-any-return]
        _enable_addon("io_scene_fbx", path)
        return bpy.ops.import_scene.fbx  # type: ignore[no-any-return]
    _enable_addon("io_scene_gltf2", path)
    return bpy.ops.import_scene.gltf  # type: ignore[no-any-return]


def _enable_addon(module: str, path: Path) -> None:
    """Enable a bundled importer for this session."""
    import addon_utils

    if not addon_utils.check(module)[1] and addon_utils.enable(module, default_set=False) is None:
        raise FileError(
            f"Blender's importer '{module}' is not installed.",
            where=str(path),
            remedy="Enable it under Edit › Preferences › Add-ons, or convert the scene to .blend.",
        )


def _run_operator(path: Path, operator: Callable[[], Any]) -> None:
    """Run an import operator silently; raise FileError if it fails, in words for a person even if it broke down."""
    try:
        with suppress_output():
            result = operator()
    except Exception as error:  # importers in Python fail in any way on a file whose parts do not fit together
        reason = _extract_reason(str(error)) if isinstance(error, RuntimeError) else ""
        if not reason:
            raise FileError(
                f"is damaged: parts of it do not fit together, and Blender's importer of {path.suffix.lower()} files "
                "gave up on it.",
                where=str(path),
                remedy="Export it again, or open it in the program that made it and save it as glTF or OBJ.",
            ) from error
        raise FileError(f"Blender could not open it: {reason}.", where=str(path), remedy="Export it again.") from error
    if "FINISHED" not in result:
        raise FileError("Blender could not open it.", where=str(path), remedy="Export it again.")


def _check_import(scene: Any, path: Path) -> None:
    """Raise SceneError if nothing touchable was imported, since importers report success even then."""
    meshes = [obj for obj in scene.objects if obj.type == "MESH"]
    if any(len(obj.data.polygons) for obj in meshes):
        return
    if any(len(obj.data.vertices) for obj in meshes):
        problem, remedy = "holds points or lines but no faces.", "Convert it to a mesh with faces first."
    elif len(scene.objects):
        problem, remedy = "holds no mesh: there is no surface to touch.", "Export the meshes too."
    else:
        problem = "nothing could be imported from it."
        remedy = (
            "It is empty, or holds materials or changes to another file alone: open the file that shows the object."
        )
    raise SceneError(problem, where=str(path), remedy=remedy)


def _extract_reason(message: str) -> str:
    """Return the reason from an operator's error text; "" if it is a Python traceback or the text of an exception."""
    lines = [line.strip() for line in message.splitlines() if line.strip() and not line.startswith("Location:")]
    if not lines:
        return "it gives no reason"
    reason = re.sub(r"^Error:\s*", "", lines[0]).rstrip(".")
    broke_down = "Traceback" in message or re.match(r"Python\b|[\w.]*(Error|Exception|Interrupt)\b", reason)
    return "" if broke_down else reason
