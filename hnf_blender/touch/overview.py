"""A view cut open: a stroke that something stands before is looked at past it.

The rendered view in a stroke's picture: the scene's own camera where it shows the stroke, one of ours else.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts
from hnf_core.export.plots.stroke_figure import StrokeView
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera
from hnf_core.scene.rgbd_view import RgbdView

from ..bridge.render.cycles import make_overview_camera, read_camera
from ..bridge.render.lit_render import OverviewRenderer, RenderHashes
from ..bridge.scene.bounding_boxes import get_world_boxes
from ..bridge.scene.meshes import Surface
from ..compat import has_denoiser
from .report import Counts

Float = NDArray[np.float64]

OCCLUSION_DEPTH_M = 3e-3
"""A contact point this far behind what the picture shows there is hidden."""


def sample_depth(image: NDArray[np.float32], uv: Float) -> Float:
    """(n,) what a depth picture (H, W) holds at pixels (n, 2), counted from its upper left corner; outside, what is
    nearest there."""
    height, width = image.shape
    column = np.clip(uv[:, 0].astype(int), 0, width - 1)
    row = np.clip(uv[:, 1].astype(int), 0, height - 1)
    return np.asarray(image[row, column], dtype=np.float64)


def clip_obstacles(camera: Camera, depth: Float, visible_depth: Float, clearance_m: float) -> Camera | None:
    """camera, seeing nothing of what stands before a stroke; None where that stands beside the stroke instead, so that
    no cut parts them.

    depth: (n,) of the stroke's points, shown: (n,) what a picture by camera shows there, planar metres. room_m: this
    much before the stroke is kept where the obstacle is farther away.
    """
    nearest = float(depth.min())
    before = visible_depth[(visible_depth < depth - OCCLUSION_DEPTH_M) & (visible_depth < nearest - OCCLUSION_DEPTH_M)]
    if not len(before):
        return None
    return replace(camera, clip_start=max(nearest - clearance_m, (float(before.max()) + nearest) / 2.0))


WIDTH, HEIGHT = 768, 432
SAMPLES = 2
"""Enough under a denoiser: on the demo scene 0.020 of sRGB (RMS) off 256 samples, and ridges a few pixels wide stay
(correlation 0.79; by colour alone 0.35). Four give 0.016 and 0.84 for half as much time again. A picture says where the
stroke is, and costs more than the touch itself."""
SAMPLES_UNDENOISED = 12
"""0.018 there (0.012 with 24)."""
MIN_STROKE_FRACTION = 0.08
"""A stroke shorter than this share of the picture's width is better seen by a camera of our own."""
MAX_NEIGHBOURS, MAX_NEIGHBOUR_FACES = 40, 400_000
"""What else may stand in the picture: its cost must not follow the size of the scene."""
MARGIN_RANGE_M = (0.012, 0.03)
"""What a camera of our own shows beside a stroke: less of a short one, or it would be a speck."""
MIN_VISIBLE_FRACTION = 0.25
"""Of a stroke's points; with fewer in sight another view of it is looked for."""
MAX_CUTS = 2
"""One obstacle may stand behind another."""
MAX_STROKE_VIEWS = 1 + MAX_CUTS
"""Renders for one stroke at most, beside the scene camera's view, which all share."""


@dataclass(frozen=True)
class Overview:
    """A lit view and the camera it was taken with (world metres)."""

    view: RgbdView
    notes: tuple[str, ...]


@dataclass(frozen=True)
class CameraView:
    """How a stroke is to be seen. path: (n, 3) world metres. radius_m: around it, that the picture is meant to show."""

    path: Float
    camera: Camera
    radius_m: float


@dataclass(frozen=True)
class Surroundings:
    """What may stand in a picture beside what is touched. centre: (n, 3), radius: (n,) of the objects' bounding spheres
    in world metres."""

    objects: tuple[Any, ...]
    centre: Float
    radius: Float


def collect_surroundings(scene: Any, depsgraph: Any, metres_per_unit: float) -> Surroundings:
    """All of the scene that renders, without its strokes."""
    objects = tuple(
        obj
        for obj in scene.objects
        if obj.type in {"MESH", "CURVE", "SURFACE", "META", "FONT"}
        and not obj.hide_render
        and not (obj.type == "CURVE" and obj.hnf_stroke.is_stroke)
    )
    low, high = get_world_boxes(objects, depsgraph, metres_per_unit)
    return Surroundings(objects, (low + high) / 2.0, np.linalg.norm(high - low, axis=1) / 2.0)


class StrokeViews:
    """Overviews of one run; a scene camera that serves several strokes is rendered once. Use as a context manager.

    depsgraph: of the scene as it is now. A run adds nothing but strokes to it, so that boxes hold for all of it: after
    any change of the file's data Blender would evaluate the relations of every object again. source: hash of its file.
    """

    def __init__(self, scene: Any, depsgraph: Any, metres_per_unit: float, counts: Counts, source: str = "") -> None:
        self._scene, self._metres, self._counts = scene, metres_per_unit, counts
        self._surroundings = collect_surroundings(scene, depsgraph, metres_per_unit)
        self._hashes = RenderHashes(scene, depsgraph, metres_per_unit, source)
        self._from_scene_camera: Overview | None = None
        self._stack = ExitStack()
        self._overviews: OverviewRenderer | None = None

    def __enter__(self) -> StrokeViews:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def hash_view(self, contacts: Contacts, surface: Surface, touched: Any) -> str:
        """Of all that the picture of a stroke may show; nothing is rendered."""
        shots = self._make_camera_views(contacts, surface)
        views = (self._hashes.hash_view(shot.camera, self._list_objects(shot, touched)) for shot in shots)
        return content_hash(
            *views, shots[0].path.tobytes(), contacts.force.tobytes(), str(_get_sample_count()), str(has_denoiser())
        )

    def render_stroke(
        self, contacts: Contacts, surface: Surface, touched: Any, name: str
    ) -> tuple[StrokeView, tuple[str, ...]]:
        """The picture of stroke `name` with its path in it, and notes. touched: the object under the stroke.

        The scene's camera where it shows enough of the stroke; else one before the surface, and where something stands
        between, that is cut away.
        """
        *shared, own = self._make_camera_views(contacts, surface)
        overview, told = None if not shared else self._get_shared_overview(shared[0], touched), ""
        if overview is None or mask_visible_points(overview.view, own.path).mean() < MIN_VISIBLE_FRACTION:
            overview, told = self._render_past_obstacles(own, touched)
        visible = mask_visible_points(overview.view, own.path)
        if not visible.any():
            told = "all of it is hidden in its picture."
        uv, _ = overview.view.camera.project(own.path)
        notes = (*overview.notes, *([f"stroke '{name}': {told}"] if told else []))
        return StrokeView(overview.view.rgb, uv, contacts.force, visible), notes

    def _make_camera_views(self, contacts: Contacts, surface: Surface) -> tuple[CameraView, ...]:
        """By the scene's camera where it has the whole path in its frame, and by one of our own."""
        path = contacts.point @ surface.rigid[:3, :3].T + surface.rigid[:3, 3]
        outward = contacts.normal.mean(axis=0) @ surface.rigid[:3, :3].T
        half = float(np.linalg.norm(path - path.mean(axis=0), axis=1).max())
        radius = 1.6 * half + float(np.clip(2.5 * half, *MARGIN_RANGE_M))
        own = CameraView(path, make_overview_camera(path, outward, radius, WIDTH, HEIGHT), radius)
        camera = self._read_scene_camera()
        return (
            (own,) if camera is None or not is_path_visible(camera, path) else (CameraView(path, camera, radius), own)
        )

    def _get_shared_overview(self, camera_view: CameraView, touched: Any) -> Overview:
        if self._from_scene_camera is None:
            self._from_scene_camera = self._render(camera_view, touched)
        return self._from_scene_camera

    def _render_past_obstacles(self, camera_view: CameraView, touched: Any) -> tuple[Overview, str]:
        """The view that shows most of the path, and what was done for it."""
        views = [self._render(camera_view, touched)]
        while (
            len(views) <= MAX_CUTS
            and mask_visible_points(views[-1].view, camera_view.path).mean() < MIN_VISIBLE_FRACTION
        ):
            last = views[-1].view
            uv, depth = last.camera.project(camera_view.path)
            camera = clip_obstacles(last.camera, depth, sample_depth(last.depth, uv), camera_view.radius_m)
            if camera is None:
                break
            views.append(self._render(replace(camera_view, camera=camera), touched))
        best = max(views, key=lambda each: mask_visible_points(each.view, camera_view.path).sum())
        return best, "" if best is views[0] else "what stands before it is cut away in its picture."

    def _render(self, camera_view: CameraView, touched: Any) -> Overview:
        if self._overviews is None:
            overviews = OverviewRenderer(
                self._scene, metres_per_unit=self._metres, samples=_get_sample_count(), relief=True
            )
            self._overviews = self._stack.enter_context(overviews)
        self._counts.renders += 1
        return Overview(*self._overviews.render_view(camera_view.camera, self._list_objects(camera_view, touched)))

    def _list_objects(self, camera_view: CameraView, touched: Any) -> list[Any]:
        return select_visible_objects(self._surroundings, camera_view.camera, camera_view.path, touched)

    def _read_scene_camera(self) -> Camera | None:
        """The scene's camera at the picture's size; None where there is none, or it has no flat, square pixels."""
        if self._scene.camera is None or self._scene.camera.data.type not in {"PERSP", "ORTHO"}:
            return None
        camera = read_camera(self._scene, self._scene.camera, self._metres)
        if abs(camera.intrinsics[0, 0] / camera.intrinsics[1, 1] - 1.0) > 1e-6:
            return None
        return resize_camera(camera, WIDTH)


def _get_sample_count() -> int:
    return SAMPLES if has_denoiser() else SAMPLES_UNDENOISED


def resize_camera(camera: Camera, width: int) -> Camera:
    """The same view, width pixels wide: a 4K scene does not need a 4K picture of its strokes."""
    share = width / camera.width
    return replace(
        camera,
        width=width,
        height=max(1, round(camera.height * share)),
        intrinsics=camera.intrinsics * np.array([[share], [share], [1.0]]),
    )


def is_path_visible(camera: Camera, path: Float) -> bool:
    """Does the camera see the whole path (n, 3), and large enough?"""
    uv, depth = camera.project(path)
    size = np.array([camera.width, camera.height])
    inside = (uv > 0).all() and (uv < size).all() and (depth > camera.clip_start).all()
    extent = (uv.max(axis=0) - uv.min(axis=0)).max() if inside else 0.0
    return bool(extent >= MIN_STROKE_FRACTION * camera.width)


def select_visible_objects(surroundings: Surroundings, camera: Camera, path: Float, touched: Any) -> list[Any]:
    """The touched object and the nearest neighbours whose bounding sphere meets the picture."""
    away = np.linalg.norm(surroundings.centre - path.mean(axis=0), axis=1) - surroundings.radius
    seen = np.flatnonzero(may_be_visible(camera, surroundings.centre, surroundings.radius)).tolist()
    near = sorted(
        (index for index in seen if surroundings.objects[index] != touched),
        key=lambda index: (away[index], surroundings.objects[index].name),
    )
    chosen, faces = [touched], 0
    for obj in (surroundings.objects[index] for index in near[:MAX_NEIGHBOURS]):
        faces += len(obj.data.polygons) if obj.type == "MESH" else 1000
        if faces > MAX_NEIGHBOUR_FACES:
            break
        chosen.append(obj)
    return chosen


def may_be_visible(camera: Camera, centre: Float, radius: Float) -> NDArray[np.bool_]:
    """(n,) may spheres (n, 3), (n,) show in the picture? (Conservative: never False for one that does.)"""
    with np.errstate(divide="ignore", invalid="ignore"):  # a sphere around the camera's own plane is seen, see below
        uv, depth = camera.project(centre)
        reach = radius * camera.intrinsics[0, 0]
        if camera.kind == "perspective":
            reach = 1.5 * reach / (depth - radius)
    size = np.array([camera.width, camera.height])
    inside = ((uv > -reach[:, None]) & (uv < size + reach[:, None])).all(axis=1)
    around = depth < 2.0 * radius if camera.kind == "perspective" else np.zeros(len(radius), dtype=np.bool_)
    return np.asarray((depth >= -radius) & (around | inside))


def mask_visible_points(view: RgbdView, path: Float) -> NDArray[np.bool_]:
    """(n,) is a point of the path (n, 3) what the picture shows there?"""
    uv, depth = view.camera.project(path)
    inside = (uv >= 0).all(axis=1) & (uv < [view.camera.width, view.camera.height]).all(axis=1)
    return np.asarray(inside & (depth <= sample_depth(view.depth, uv) + OCCLUSION_DEPTH_M))
