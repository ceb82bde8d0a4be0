"""Scenes to look at from all sides: two real ones where the data for development are, else a small one of ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.camera import Camera
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.patch import PATCH_SIZE_M

SCENE_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "scenes"
REAL_SCENES = (
    SCENE_DATA / "FlightHelmet" / "FlightHelmet.gltf",
    SCENE_DATA / "SheenChairScene" / "MixedLightingExample.gltf",
)
FLOOR_NAME = "Plane"
"""Not what the cameras are to show."""
MARGIN_PX = 8
"""Around a patch, so that the denoiser sees what goes on beside it."""


@dataclass(frozen=True)
class Rectangle:
    """Of pixels."""

    left: int
    top: int
    width: int
    height: int

    def crop(self, image: NDArray[Any]) -> NDArray[Any]:
        """Of an image (H, W, …)."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def list_scenes(quick: bool) -> dict[str, Callable[[], Any]]:
    """Name → what opens it anew, lit, and returns it."""
    if quick or not all(path.is_file() for path in REAL_SCENES):
        return {"three balls": make_three_balls}
    return {path.parent.name: lambda path=path: _open_scene(path) for path in REAL_SCENES}  # type: ignore[misc]


def make_three_balls() -> Any:
    """Balls of 60 mm on a floor, under a lamp."""
    import bpy

    from ..bridge.importers import open_empty_scene

    open_empty_scene()
    scene = bpy.context.scene
    _, floor = bpy.ops.mesh.primitive_plane_add(size=0.6), bpy.context.object
    floor.name = FLOOR_NAME
    for place in (-0.08, 0.0, 0.08):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=0.03, location=(place, place / 2, 0.03))
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    scene.collection.objects.link(lamp)
    lamp.data.energy, lamp.rotation_euler = 2.0, (0.5, 0.3, 0.0)
    bpy.context.view_layer.update()
    return scene


def place_cameras(scene: Any, count: int, width: int, height: int) -> list[Camera]:
    """count cameras on a ring, three-quarter views of all that stands on the floor."""
    from ..bridge.boxes import get_world_box
    from ..bridge.scene_camera import make_overview_camera

    depsgraph = scene.view_layers[0].depsgraph
    boxes = [get_world_box(obj, depsgraph, 1.0) for obj in list_meshes(scene) if obj.name != FLOOR_NAME]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    turns = 2.0 * np.pi * np.arange(count) / 12.0 + 0.3
    return [make_overview_camera(corners, [np.cos(turn), np.sin(turn), 0.15], 0.05, width, height) for turn in turns]


def list_meshes(scene: Any) -> list[Any]:
    return [obj for obj in scene.objects if obj.type == "MESH"]


def find_patch(camera: Camera, depth: NDArray[np.float32]) -> Rectangle:
    """What shows 20 mm of surface around the pixel nearest to the middle of the picture that shows any."""
    rows, columns = np.nonzero(np.isfinite(depth))
    nearest = np.argmin((rows - camera.height / 2.0) ** 2 + (columns - camera.width / 2.0) ** 2)
    row, column = int(rows[nearest]), int(columns[nearest])
    side = max(4, round(PATCH_SIZE_M * camera.intrinsics[0, 0] / float(depth[row, column])))
    left, top = max(0, column - side // 2), max(0, row - side // 2)
    return Rectangle(left, top, min(side, camera.width - left), min(side, camera.height - top))


def expand_rectangle(patch: Rectangle, camera: Camera) -> Rectangle:
    """With MARGIN_PX around it, as far as the picture reaches."""
    left, top = max(0, patch.left - MARGIN_PX), max(0, patch.top - MARGIN_PX)
    right = min(camera.width, patch.left + patch.width + MARGIN_PX)
    bottom = min(camera.height, patch.top + patch.height + MARGIN_PX)
    return Rectangle(left, top, right - left, bottom - top)


def make_world_mesh(scene: Any) -> TriangleMesh:
    """Every solid of the scene in one mesh, world metres."""
    from ..bridge.meshes import read_surface

    depsgraph = scene.view_layers[0].depsgraph
    parts = [read_surface(obj, depsgraph, 1.0) for obj in list_meshes(scene)]
    starts = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    turned = [part.rigid[:3, :3] for part in parts]
    return TriangleMesh(
        vertices=np.concatenate([
            part.mesh.vertices @ turn.T + part.rigid[:3, 3] for part, turn in zip(parts, turned, strict=True)
        ]),
        triangles=np.concatenate([part.mesh.triangles + start for part, start in zip(parts, starts, strict=False)]),
        normals=np.concatenate([part.mesh.normals @ turn.T for part, turn in zip(parts, turned, strict=True)]),
        face=np.concatenate([part.mesh.face for part in parts]),
        slot=np.concatenate([part.mesh.slot for part in parts]),
    )  # fmt: skip


def _open_scene(path: Path) -> Any:
    """Lit by a neutral dome where it has no light, as our pictures of it are."""
    from ..bridge.importers import open_scene
    from ..bridge.picture import add_dome, is_lit

    scene = open_scene(path)
    if not is_lit(scene):
        add_dome(scene)
    return scene
