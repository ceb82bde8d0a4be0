"""The rendered view in a stroke's picture: the scene's own camera where it shows the stroke, one of ours else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts
from hnf_core.export.path_on_view import StrokeView
from hnf_core.scene.camera import Camera
from hnf_core.scene.view import RgbdView

from ..bridge.boxes import world_box
from ..bridge.meshes import Surface
from ..bridge.picture import render_overview
from ..bridge.scene_camera import camera_record, overview_camera
from ..compat import has_denoiser
from .report import Counts

Float = NDArray[np.float64]

WIDTH, HEIGHT = 768, 432
SAMPLES = 6
"""Enough under a denoiser; a picture says where the stroke is, it is no final render."""
SAMPLES_UNDENOISED = 24
LEAST_SHARE = 0.08
"""A stroke shorter than this share of the picture's width is better seen by a camera of our own."""
NEIGHBOURS, NEIGHBOUR_FACES = 40, 400_000
"""What else may stand in the picture: its cost must not follow the size of the scene."""
BEHIND_M = 3e-3
"""A contact point this far behind what the picture shows there is hidden."""


@dataclass(frozen=True)
class Overview:
    """A lit view and the camera it was taken with (world metres)."""

    view: RgbdView
    notes: tuple[str, ...]


class Views:
    """Overviews of one run; a scene camera that serves several strokes is rendered once."""

    def __init__(self, scene: Any, depsgraph: Callable[[], Any], metres_per_unit: float, counts: Counts) -> None:
        self._scene, self._depsgraph, self._metres, self._counts = scene, depsgraph, metres_per_unit, counts
        self._from_scene_camera: Overview | None = None

    def of_stroke(self, contacts: Contacts, surface: Surface, touched: Any) -> tuple[StrokeView, tuple[str, ...]]:
        """The picture of a stroke with its path in it, and notes. touched: the object under the stroke."""
        path = contacts.point @ surface.rigid[:3, :3].T + surface.rigid[:3, 3]
        camera = self._scene_camera()
        if camera is not None and shows(camera, path):
            if self._from_scene_camera is None:
                self._from_scene_camera = self._render(camera, path, touched)
            overview = self._from_scene_camera
        else:
            outward = contacts.normal.mean(axis=0) @ surface.rigid[:3, :3].T
            radius = 1.6 * float(np.linalg.norm(path - path.mean(axis=0), axis=1).max()) + 0.03
            overview = self._render(overview_camera(path, outward, radius, WIDTH, HEIGHT), path, touched)
        uv, depth = overview.view.camera.project(path)
        return StrokeView(overview.view.rgb, uv, contacts.force, _visible(overview.view, uv, depth)), overview.notes

    def _render(self, camera: Camera, path: Float, touched: Any) -> Overview:
        objects = in_view(self._scene, self._depsgraph(), camera, path, touched, self._metres)
        self._counts.renders += 1
        view, notes = render_overview(
            self._scene,
            camera,
            metres_per_unit=self._metres,
            samples=SAMPLES if has_denoiser() else SAMPLES_UNDENOISED,
            objects=objects,
        )
        return Overview(view, notes)

    def _scene_camera(self) -> Camera | None:
        """The scene's camera at the picture's size; None where there is none, or it has no flat, square pixels."""
        if self._scene.camera is None or self._scene.camera.data.type not in {"PERSP", "ORTHO"}:
            return None
        camera = camera_record(self._scene, self._scene.camera, self._metres)
        if abs(camera.intrinsics[0, 0] / camera.intrinsics[1, 1] - 1.0) > 1e-6:
            return None
        return resized(camera, WIDTH)


def resized(camera: Camera, width: int) -> Camera:
    """The same view, width pixels wide: a 4K scene does not need a 4K picture of its strokes."""
    share = width / camera.width
    return replace(
        camera,
        width=width,
        height=max(1, round(camera.height * share)),
        intrinsics=camera.intrinsics * np.array([[share], [share], [1.0]]),
    )


def shows(camera: Camera, path: Float) -> bool:
    """Does the camera see the whole path (n, 3), and large enough?"""
    uv, depth = camera.project(path)
    size = np.array([camera.width, camera.height])
    inside = (uv > 0).all() and (uv < size).all() and (depth > camera.clip_start).all()
    extent = (uv.max(axis=0) - uv.min(axis=0)).max() if inside else 0.0
    return bool(extent >= LEAST_SHARE * camera.width)


def in_view(scene: Any, depsgraph: Any, camera: Camera, path: Float, touched: Any, metres_per_unit: float) -> list[Any]:
    """The touched object and the nearest visible neighbours whose bounding sphere meets the picture."""
    middle = path.mean(axis=0)
    near: list[tuple[float, Any]] = []
    for obj in scene.objects:
        if obj == touched or obj.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"} or obj.hide_render:
            continue
        if obj.type == "CURVE" and obj.hnf_stroke.is_stroke:
            continue
        low, high = world_box(obj, depsgraph, metres_per_unit)
        centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
        if meets_view(camera, centre, radius):
            near.append((float(np.linalg.norm(centre - middle)) - radius, obj))
    chosen, faces = [touched], 0
    for _, obj in sorted(near, key=lambda item: (item[0], item[1].name))[:NEIGHBOURS]:
        faces += len(obj.data.polygons) if obj.type == "MESH" else 1000
        if faces > NEIGHBOUR_FACES:
            break
        chosen.append(obj)
    return chosen


def meets_view(camera: Camera, centre: Float, radius: float) -> bool:
    """May a sphere show in the picture? (Conservative: never False for one that does.)"""
    uv, depth = camera.project(np.stack([centre, centre]))
    if depth[0] < -radius:
        return False
    focal = camera.intrinsics[0, 0]
    reach = radius * focal
    if camera.kind == "perspective":
        if depth[0] < 2.0 * radius:
            return True
        reach = 1.5 * radius * focal / (depth[0] - radius)
    size = np.array([camera.width, camera.height])
    return bool((uv[0] > -reach).all() and (uv[0] < size + reach).all())


def _visible(view: RgbdView, uv: Float, depth: Float) -> NDArray[np.bool_]:
    """(n,) is the path's point what the picture shows there?"""
    column = np.clip(uv[:, 0].astype(int), 0, view.camera.width - 1)
    row = np.clip(uv[:, 1].astype(int), 0, view.camera.height - 1)
    inside = (uv >= 0).all(axis=1) & (uv < [view.camera.width, view.camera.height]).all(axis=1)
    return np.asarray(inside & (depth <= view.depth[row, column] + BEHIND_M))
