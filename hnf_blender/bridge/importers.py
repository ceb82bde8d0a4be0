"""Scene files → the open Blender scene, or one clear line why not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from hnf_core.errors import FileError, SceneError
from hnf_core.scene.ply_header import read_ply_header
from hnf_core.scene.splats.read import check_splat_file

from .nerfstudio import open_nerfstudio_export
from .painted import show_vertex_colours
from .quiet import suppress_output

SCENE_SUFFIXES = (".blend", ".gltf", ".glb", ".obj", ".ply", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".json")
SPLAT_SUFFIXES = (".splat", ".ksplat", ".spz", ".sog")
# A curve may be a stroke, a light or camera is nothing to touch; an empty may stand for a collection of meshes.
TOUCHABLE_TYPES = ("MESH", "SURFACE", "META", "FONT", "CURVE", "CURVES", "EMPTY")
# ZStandard (3.0 and later) and gzip (before) are how Blender compresses.
BLEND_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")
USD_MAGIC = (b"#usda", b"PXR-USDC", b"PK\x03\x04")


def open_scene(
    path: Path,
    cache: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    *,
    write_cache: bool = True,
) -> Any:
    """Open a scene file and return its bpy Scene, which is then Blender's active one.

    A .blend is opened as it is (its user interface and its Python scripts are left alone); every other format is
    imported into an empty scene, never into the start-up one. cache: folder where the surfaces of reconstructions are
    kept, None = they are made every time; keep: False = those that are there are read, and none is written; progress:
    told what is done of one, and which share of it. Raises FileError where the file is missing, damaged, of an
    unsupported kind or refers to a missing part, and SceneError where it holds nothing to touch. What was open before
    stays open when the file is refused by its head, and when no surface can be made of its splats.
    """
    import bpy

    path = Path(path).absolute()
    suffix = path.suffix.lower()
    check_scene_file(path)
    if suffix == ".blend":
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
    if suffix == ".ply" and read_ply_header(path).is_splat:
        return _open_splats(path, cache, progress, write_cache)
    open_empty_scene()
    importer = _find_importer(suffix, path)
    _run_operator(path, lambda: importer(filepath=str(path)))
    scene = bpy.context.scene
    _check_import(scene, path)
    if suffix in {".ply", ".obj"}:
        for obj in scene.objects:
            show_vertex_colours(obj)
    return scene


def _open_splats(
    path: Path, cache: Path | None, progress: Callable[[str, float], None] | None, write_cache: bool
) -> Any:
    import bpy

    from .splat_reconstruction import read_reconstruction
    from .splat_scene import add_reconstruction

    made = read_reconstruction(path, cache, write_cache=write_cache, progress=progress)
    open_empty_scene()
    scene = bpy.context.scene
    add_reconstruction(scene, made)
    return scene


def open_empty_scene() -> None:
    """Replace what is open by a scene without any object; preferences and add-ons stay as they are."""
    import bpy

    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True, load_ui=False)


def check_scene_file(path: Path) -> None:
    """Refuse by name, size and first bytes whatever Blender would not open, before anything open is given up. Needs no
    Blender. Raises FileError and SceneError as open_scene does."""
    path = Path(path).absolute()
    where, suffix = str(path), path.suffix.lower()
    if not path.exists():
        raise FileError("there is no such file.", where=where, remedy="Check the path.")
    if not path.is_file():
        raise FileError("is not a file.", where=where, remedy="Give the scene file itself.")
    if suffix in SPLAT_SUFFIXES:
        raise _unreadable_splats_error(where)
    if suffix not in SCENE_SUFFIXES:
        raise FileError(
            f"a file of kind '{suffix}' is no scene."
            if suffix
            else "it has no ending that says what kind of scene it is.",
            where=where,
            remedy=f"Give a scene: {' '.join(SCENE_SUFFIXES)}.",
        )
    try:
        with path.open("rb") as stream:
            head = stream.read(64)
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=where, remedy="Check its rights."
        ) from error
    if not head:
        raise _damaged_file_error(path, "it is empty")
    if suffix == ".blend" and not head.startswith(BLEND_MAGIC):
        raise _damaged_file_error(path, "it does not begin like a .blend file")
    if suffix == ".glb" and not head.startswith(b"glTF"):
        raise _damaged_file_error(path, "it does not begin like a binary glTF file")
    if suffix == ".fbx" and not (head.startswith(b"Kaydara FBX Binary") or head.lstrip().startswith(b";")):
        raise _damaged_file_error(path, "it does not begin like an FBX file")
    if suffix.startswith(".usd") and not head.startswith(USD_MAGIC):
        raise _damaged_file_error(path, "it does not begin like a USD file")
    if suffix == ".gltf":
        _check_gltf(path)
    if suffix == ".ply":
        _check_ply(path)


def _check_ply(path: Path) -> None:
    header = read_ply_header(path)
    if header.is_splat:
        check_splat_file(path)
        return
    if header.count("face") == 0 and header.count("tristrips") == 0:
        raise SceneError(
            f"is a cloud of {header.count('vertex')} points without faces: there is no surface to touch.",
            where=str(path),
            remedy="Convert it to a mesh first (for example by Poisson reconstruction).",
        )


def _check_gltf(path: Path) -> None:
    """A .gltf is JSON that names its buffers; name the missing one instead of a traceback."""
    try:
        document = json.loads(path.read_bytes())
        buffers = [str(buffer.get("uri", "")) for buffer in document.get("buffers", [])]
    except (ValueError, AttributeError, TypeError, RecursionError) as error:
        raise _damaged_file_error(path, "it is not a glTF document") from error
    for uri in buffers:
        if uri and not uri.startswith("data:") and not (path.parent / unquote(uri)).is_file():
            raise FileError(
                f"its data file '{unquote(uri)}' is missing.", where=str(path), remedy="Put it next to the .gltf file."
            )


def _find_importer(suffix: str, path: Path) -> Callable[..., Any]:
    """The operator of this Blender version; a bundled importer that is switched off is switched on for this session."""
    import bpy

    if suffix == ".obj":
        return bpy.ops.wm.obj_import  # type: ignore[no-any-return]
    if suffix == ".ply":
        return bpy.ops.wm.ply_import  # type: ignore[no-any-return]
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
    import addon_utils

    if not addon_utils.check(module)[1] and addon_utils.enable(module, default_set=False) is None:
        raise FileError(
            f"Blender's importer '{module}' is not installed.",
            where=str(path),
            remedy="Enable it under Edit › Preferences › Add-ons, or convert the scene to .blend.",
        )


def _run_operator(path: Path, operator: Callable[[], Any]) -> None:
    try:
        with suppress_output():
            result = operator()
    except RuntimeError as error:
        raise FileError(
            f"Blender could not open it: {_extract_reason(str(error))}.", where=str(path), remedy="Export it again."
        ) from error
    if "FINISHED" not in result:
        raise FileError("Blender could not open it.", where=str(path), remedy="Export it again.")


def _check_import(scene: Any, path: Path) -> None:
    """Importers report success with nothing imported."""
    meshes = [obj for obj in scene.objects if obj.type == "MESH"]
    if any(len(obj.data.polygons) for obj in meshes):
        return
    if any(len(obj.data.vertices) for obj in meshes):
        what, remedy = "holds points or lines but no faces.", "Convert it to a mesh with faces first."
    elif len(scene.objects):
        what, remedy = "holds no mesh: there is no surface to touch.", "Export the meshes too."
    else:
        what, remedy = "nothing could be imported from it.", "The file is empty or damaged; export it again."
    raise SceneError(what, where=str(path), remedy=remedy)


def _extract_reason(message: str) -> str:
    """The reason in an operator's error text, which may be a whole Python traceback."""
    lines = [line.strip() for line in message.splitlines() if line.strip() and not line.startswith("Location:")]
    raised = [
        line for line in lines if re.match(r"[\w.]*(Error|Exception|Interrupt)\b", line) and "Error: Python" not in line
    ]
    reason = (raised[-1] if "Traceback" in message and raised else lines[0] if lines else "no reason given").strip()
    return re.sub(r"^Error:\s*", "", reason).rstrip(".")


def _unreadable_splats_error(where: str) -> SceneError:
    return SceneError(
        "is a Gaussian-splat scene of a kind that cannot be read.",
        where=where,
        remedy="Convert it to .ply with SuperSplat or splat-transform.",
    )


def _damaged_file_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")
