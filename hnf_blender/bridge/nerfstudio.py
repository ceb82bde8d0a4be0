"""A nerfstudio export → a scene: the geometry beside transforms.json, and a camera for every picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.errors import FileError
from hnf_core.scene.camera import Camera
from hnf_core.scene.nerfstudio import OPENGL_CAMERA_AXES, NerfstudioFrame, read_model_transforms
from hnf_core.scene.ply_header import read_ply_header

EXPORT_MESHES = ("mesh.obj", "poisson_mesh.ply", "tsdf_mesh.ply", "sdf_marching_cubes_mesh.ply")
EXPORT_SPLATS = "splat.ply"
EXPORT_POINTS = "point_cloud.ply"
"""What ns-export calls its files."""
CAMERA_COLLECTION = "Cameras"
SENSOR_MM = 36.0
CLIP_RANGE = (1e-3, 1e4)
CAMERA_SYMBOL_FRACTION = 0.05
"""Size of a camera's symbol in the viewport, of the distance between the two cameras farthest apart along an axis."""


def open_nerfstudio_export(path: Path, open_geometry: Callable[[Path], Any]) -> Any:
    """The scene of an export: its geometry, opened by open_geometry, in the export's own frame (z up), and its cameras.

    Raises FileError where transforms.json cannot be used or no geometry stands beside it, and what open_geometry
    raises. Nothing that is open is given up before both files are read.
    """
    frames = read_model_transforms(path)
    geometry = find_geometry(path)
    scene = open_geometry(geometry)
    for obj in scene.objects:
        if obj.parent is None:  # importers turn what does not say which way is up
            obj.rotation_mode = "QUATERNION"
            obj.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    add_cameras(scene, frames)
    scene.view_layers[0].update()
    return scene


def find_geometry(path: Path) -> Path:
    """What to touch of the export around transforms.json: a mesh with colours, else splats, else a bare mesh, else the
    cloud of points, which is refused when it is opened. Raises FileError where there is nothing of these."""
    there = [path.with_name(name) for name in (*EXPORT_MESHES, EXPORT_SPLATS, EXPORT_POINTS)]
    there = [file for file in there if file.is_file()]
    coloured = [file for file in there if file.name in EXPORT_MESHES and has_colours(file)]
    splats = [file for file in there if file.name == EXPORT_SPLATS]
    found = [*coloured, *splats, *there]
    if not found:
        raise FileError(
            f"there is no geometry next to it (looked for {', '.join((*EXPORT_MESHES, EXPORT_SPLATS))}).",
            where=str(path),
            remedy="Export it with ns-export gaussian-splat or ns-export poisson into the same folder.",
        )
    return found[0]


def has_colours(mesh: Path) -> bool:
    """Does a mesh file say what colour it is: on its points or, an .obj, by a material with a picture?"""
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
    library = mesh.parent / name
    if not library.resolve().is_relative_to(mesh.parent.resolve()) or not library.is_file():
        return False
    return any(line.lstrip().startswith(b"map_Kd") for line in library.read_bytes().splitlines())


def add_cameras(scene: Any, frames: Sequence[NerfstudioFrame]) -> None:
    """A camera a frame, named after its picture, in a collection of their own; the first is the scene's, with its size.

    A scene renders all cameras at one size: the others show their own width, and more or less of their height where
    their pictures have another shape.
    """
    import bpy

    collection = bpy.data.collections.new(CAMERA_COLLECTION)
    scene.collection.children.link(collection)
    places = np.array([frame.camera.pose[:3, 3] for frame in frames])
    symbol = CAMERA_SYMBOL_FRACTION * float(np.ptp(places, axis=0).max())
    for frame in frames:
        camera = bpy.data.objects.new(frame.name, _make_camera_data(frame))
        camera.matrix_world = _make_camera_matrix(frame.camera)
        camera.data.display_size = symbol if symbol > 0.0 else CAMERA_SYMBOL_FRACTION
        collection.objects.link(camera)
        if scene.camera is None:
            scene.camera = camera
    first, render = frames[0].camera, scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = first.width, first.height, 100
    # Blender takes no aspect below 1.
    ratio = first.intrinsics[0, 0] / first.intrinsics[1, 1]
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0 / ratio, 1.0), max(ratio, 1.0)


def _make_camera_data(frame: NerfstudioFrame) -> Any:
    import bpy

    camera, data = frame.camera, bpy.data.cameras.new(frame.name)
    focal_x, focal_y = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    data.type, data.sensor_fit, data.sensor_width = "PERSP", "HORIZONTAL", SENSOR_MM
    data.lens = focal_x / camera.width * SENSOR_MM
    data.shift_x = (camera.width / 2.0 - camera.intrinsics[0, 2]) / camera.width
    # Shifts count in widths of the picture; a pixel is focal_x / focal_y as high as it is wide.
    data.shift_y = (camera.intrinsics[1, 2] - camera.height / 2.0) / camera.width * focal_x / focal_y
    data.clip_start, data.clip_end = CLIP_RANGE
    return data


def _make_camera_matrix(camera: Camera) -> Any:
    from mathutils import Matrix

    return Matrix((camera.pose @ OPENGL_CAMERA_AXES).tolist())
