"""Rendered view in a stroke's plot: by the scene's camera if it shows the stroke, else by an overview camera.

If an obstacle hides the stroke from the overview camera, the near clipping plane is moved behind the obstacle.
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
from ..bridge.scene.meshes import Surface
from ..bridge.scene.object_size import get_world_boxes
from ..compat import has_denoiser
from .report import Counts

Float = NDArray[np.float64]

OCCLUSION_DEPTH_M = 3e-3
"""Depth behind the visible surface from which a contact point is hidden [m]."""


def sample_depth(image: NDArray[np.float32], uv: Float) -> Float:
    """Return the values (n,) of a depth image (H, W) at pixels (n, 2); outside the image, of its nearest pixel."""
    height, width = image.shape
    column = np.clip(uv[:, 0].astype(int), 0, width - 1)
    row = np.clip(uv[:, 1].astype(int), 0, height - 1)
    return np.asarray(image[row, column], dtype=np.float64)


def clip_obstacles(camera: Camera, depth: Float, visible_depth: Float, clearance_m: float) -> Camera | None:
    """Return a camera whose near clipping plane cuts away what is in front of a stroke.

    None if the obstacle is not in front of all of it, so that no clipping plane separates them.

    Parameters
    ----------
    camera : Camera
        Camera of the view.
    depth : (n,) array
        Planar depth of the stroke's points [m].
    visible_depth : (n,) array
        Depth that the view shows at these points [m].
    clearance_m : float
        Maximum distance of the clipping plane in front of the stroke [m].

    Returns
    -------
    Camera or None
    """
    nearest = float(depth.min())
    obstacle_depth = visible_depth[
        (visible_depth < depth - OCCLUSION_DEPTH_M) & (visible_depth < nearest - OCCLUSION_DEPTH_M)
    ]
    if not len(obstacle_depth):
        return None
    return replace(camera, clip_start=max(nearest - clearance_m, (float(obstacle_depth.max()) + nearest) / 2.0))


WIDTH, HEIGHT = 768, 432
"""Size of the view [pixels]."""
SAMPLES = 2
"""Samples per pixel with a denoiser. On the demo scene the error against 256 samples is 0.020 of sRGB (RMS), and ridges
a few pixels wide are preserved (correlation 0.79; with color alone 0.35). Four samples give 0.016 and 0.84 in 1.5
times the time. The view only has to show where the stroke is, and costs more than the touch itself."""
SAMPLES_UNDENOISED = 12
"""Samples per pixel without a denoiser: an error of 0.018 (0.012 with 24)."""
MIN_STROKE_FRACTION = 0.08
"""Extent of a stroke, as a fraction of the image's width, below which the overview camera is used."""
MAX_NEIGHBOURS, MAX_NEIGHBOUR_FACES = 40, 400_000
"""Limits of other objects in a view, so that its cost does not depend on the scene."""
MARGIN_RANGE_M = (0.012, 0.03)
"""Margin around a stroke in the overview camera's view [m]; smaller for a short stroke, which would be tiny."""
MIN_VISIBLE_FRACTION = 0.25
"""Fraction of visible points of a stroke below which another view is tried."""
MAX_CUTS = 2
"""Maximum number of clipped views, since one obstacle may hide another."""
MAX_STROKE_VIEWS = 1 + MAX_CUTS
"""Maximum number of renders for one stroke, besides the shared view of the scene's camera."""


@dataclass(frozen=True)
class Overview:
    """A lit view of a stroke, and notes for the user."""

    view: RgbdView
    notes: tuple[str, ...]


@dataclass(frozen=True)
class CameraView:
    """A camera from which one stroke may be shown.

    `path` (n, 3) is the stroke in world coordinates [m]; `radius_m` is the radius around it that the view should show.
    """

    path: Float
    camera: Camera
    radius_m: float


@dataclass(frozen=True)
class Surroundings:
    """Objects that may be in a view besides the touched one.

    `centre` (n, 3) and `radius` (n,) are their bounding spheres in world coordinates [m].
    """

    objects: tuple[Any, ...]
    centre: Float
    radius: Float


def collect_surroundings(scene: Any, depsgraph: Any, metres_per_unit: float) -> Surroundings:
    """Return all objects of the scene that are rendered, without its strokes."""
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
    """Context manager that renders the views shown in the plots of one run; the scene camera's view is rendered once.

    Bounding boxes are read at the start and stay valid, as a run only adds strokes to the scene; reading them again
    after any change of data would make Blender evaluate all objects again.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene of the strokes.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    counts : Counts
        Its renders are incremented.
    source : str, optional
        Hash of the scene's file.
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
        """Hash everything that a stroke's view may show; nothing is rendered."""
        camera_views = self._make_camera_views(contacts, surface)
        views = (
            self._hashes.hash_view(camera_view.camera, self._list_objects(camera_view, touched))
            for camera_view in camera_views
        )
        return content_hash(
            *views,
            camera_views[0].path.tobytes(),
            contacts.force.tobytes(),
            str(_get_sample_count()),
            str(has_denoiser()),
        )

    def render_stroke(
        self, contacts: Contacts, surface: Surface, touched: Any, name: str
    ) -> tuple[StrokeView, tuple[str, ...]]:
        """Render the view of a stroke and mark its path.

        The scene's camera is used if it shows enough of the stroke, else an overview camera, with obstacles clipped
        away.

        Parameters
        ----------
        contacts : Contacts
            Contacts of the stroke.
        surface : Surface
            Touched surface.
        touched : bpy.types.Object
            Touched object.
        name : str
            Name of the stroke, for notes.

        Returns
        -------
        view : StrokeView
        notes : tuple of str
            Remarks for the user.
        """
        *shared, custom = self._make_camera_views(contacts, surface)
        overview, note = None if not shared else self._get_shared_overview(shared[0], touched), ""
        if overview is None or mask_visible_points(overview.view, custom.path).mean() < MIN_VISIBLE_FRACTION:
            overview, note = self._render_past_obstacles(custom, touched)
        visible = mask_visible_points(overview.view, custom.path)
        if not visible.any():
            note = "all of it is hidden in its picture."
        uv, _ = overview.view.camera.project(custom.path)
        notes = (*overview.notes, *([f"stroke '{name}': {note}"] if note else []))
        return StrokeView(overview.view.rgb, uv, contacts.force, visible), notes

    def _make_camera_views(self, contacts: Contacts, surface: Surface) -> tuple[CameraView, ...]:
        """Return the cameras to try for a stroke: the scene's, if its frame contains the path, and an overview."""
        path = contacts.point @ surface.rigid[:3, :3].T + surface.rigid[:3, 3]
        outward = contacts.normal.mean(axis=0) @ surface.rigid[:3, :3].T
        extent = float(np.linalg.norm(path - path.mean(axis=0), axis=1).max())
        radius = 1.6 * extent + float(np.clip(2.5 * extent, *MARGIN_RANGE_M))
        custom = CameraView(path, make_overview_camera(path, outward, radius, WIDTH, HEIGHT), radius)
        camera = self._read_scene_camera()
        return (
            (custom,)
            if camera is None or not is_path_visible(camera, path)
            else (CameraView(path, camera, radius), custom)
        )

    def _get_shared_overview(self, camera_view: CameraView, touched: Any) -> Overview:
        if self._from_scene_camera is None:
            self._from_scene_camera = self._render(camera_view, touched)
        return self._from_scene_camera

    def _render_past_obstacles(self, camera_view: CameraView, touched: Any) -> tuple[Overview, str]:
        """Return the view from a camera, clipped if that shows more of the path, and a note if it is clipped."""
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
        best = max(views, key=lambda overview: mask_visible_points(overview.view, camera_view.path).sum())
        return best, "" if best is views[0] else "what stands before it is cut away in its picture."

    def _render(self, camera_view: CameraView, touched: Any) -> Overview:
        if self._overviews is None:
            overviews = OverviewRenderer(
                self._scene, metres_per_unit=self._metres, samples=_get_sample_count(), relief=True
            )
            self._overviews = self._stack.enter_context(overviews)
        self._counts.add("renders")
        return Overview(*self._overviews.render_view(camera_view.camera, self._list_objects(camera_view, touched)))

    def _list_objects(self, camera_view: CameraView, touched: Any) -> list[Any]:
        return select_visible_objects(self._surroundings, camera_view.camera, camera_view.path, touched)

    def _read_scene_camera(self) -> Camera | None:
        """Return the scene's camera at the plot's size; None without one, or without square pixels."""
        if self._scene.camera is None or self._scene.camera.data.type not in {"PERSP", "ORTHO"}:
            return None
        camera = read_camera(self._scene, self._scene.camera, self._metres)
        if abs(camera.intrinsics[0, 0] / camera.intrinsics[1, 1] - 1.0) > 1e-6:
            return None
        return resize_camera(camera, WIDTH)


def _get_sample_count() -> int:
    return SAMPLES if has_denoiser() else SAMPLES_UNDENOISED


def resize_camera(camera: Camera, width: int) -> Camera:
    """Return a camera with the same view, `width` pixels wide, as plots need no 4K images."""
    scale = width / camera.width
    return replace(
        camera,
        width=width,
        height=max(1, round(camera.height * scale)),
        intrinsics=camera.intrinsics * np.array([[scale], [scale], [1.0]]),
    )


def is_path_visible(camera: Camera, path: Float) -> bool:
    """Return True if a camera's frame contains the entire path (n, 3), and shows it large enough."""
    uv, depth = camera.project(path)
    size = np.array([camera.width, camera.height])
    inside = (uv > 0).all() and (uv < size).all() and (depth > camera.clip_start).all()
    extent = (uv.max(axis=0) - uv.min(axis=0)).max() if inside else 0.0
    return bool(extent >= MIN_STROKE_FRACTION * camera.width)


def select_visible_objects(surroundings: Surroundings, camera: Camera, path: Float, touched: Any) -> list[Any]:
    """Return the touched object and the nearest of the surrounding objects whose bounding spheres are in view."""
    distance = np.linalg.norm(surroundings.centre - path.mean(axis=0), axis=1) - surroundings.radius
    visible = np.flatnonzero(may_be_visible(camera, surroundings.centre, surroundings.radius)).tolist()
    neighbours = sorted(
        (index for index in visible if surroundings.objects[index] != touched),
        key=lambda index: (distance[index], surroundings.objects[index].name),
    )
    chosen, faces = [touched], 0
    for obj in (surroundings.objects[index] for index in neighbours[:MAX_NEIGHBOURS]):
        faces += len(obj.data.polygons) if obj.type == "MESH" else 1000
        if faces > MAX_NEIGHBOUR_FACES:
            break
        chosen.append(obj)
    return chosen


def may_be_visible(camera: Camera, centre: Float, radius: Float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the spheres that may be in a camera's view; never False for one that is.

    `centre` (n, 3) and `radius` (n,) are in world coordinates [m].
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # spheres that reach the camera's plane are handled below
        uv, depth = camera.project(centre)
        reach = radius * camera.intrinsics[0, 0]
        if camera.kind == "perspective":
            reach = 1.5 * reach / (depth - radius)
    size = np.array([camera.width, camera.height])
    inside = ((uv > -reach[:, None]) & (uv < size + reach[:, None])).all(axis=1)
    around = depth < 2.0 * radius if camera.kind == "perspective" else np.zeros(len(radius), dtype=np.bool_)
    return np.asarray((depth >= -radius) & (around | inside))


def mask_visible_points(view: RgbdView, path: Float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the path's points (n, 3) that are visible in a view."""
    uv, depth = view.camera.project(path)
    inside = (uv >= 0).all(axis=1) & (uv < [view.camera.width, view.camera.height]).all(axis=1)
    return np.asarray(inside & (depth <= sample_depth(view.depth, uv) + OCCLUSION_DEPTH_M))
