"""Rendered view in a stroke's plot: by the scene's camera if it shows the stroke, else by an overview camera.

Strokes beside each other that face one way share an overview, as rendering one costs more than drawing a stroke over
it. A stroke that no shared view shows gets a view of its own; if an obstacle hides it there, the near clipping plane is
moved behind the obstacle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts
from hnf_core.export.stroke_figure import StrokeView
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera
from hnf_core.scene.rgbd_view import RgbdView

from ..bridge.cycles import make_overview_camera, read_camera
from ..bridge.lit_render import OverviewRenderer, RenderHashes
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


def clip_obstacles(camera: Camera, depth: NDArray[np.float32], path: Float, clearance_m: float) -> Camera | None:
    """Return a camera whose near clipping plane cuts away what is in front of a stroke.

    None if the obstacle is not in front of all of it, so that no clipping plane separates them.

    Parameters
    ----------
    camera : Camera
        Camera of the view.
    depth : (H, W) array
        Planar depth that the view shows [m].
    path : (n, 3) array
        Points of the stroke in world coordinates [m].
    clearance_m : float
        Maximum distance of the clipping plane in front of the stroke [m].

    Returns
    -------
    Camera or None
    """
    uv, path_depth = camera.project(path)
    visible_depth, nearest = sample_depth(depth, uv), float(path_depth.min())
    obstacle_depth = visible_depth[
        (visible_depth < path_depth - OCCLUSION_DEPTH_M) & (visible_depth < nearest - OCCLUSION_DEPTH_M)
    ]
    if not len(obstacle_depth):
        return None
    return replace(camera, clip_start=max(nearest - clearance_m, (float(obstacle_depth.max()) + nearest) / 2.0))


WIDTH, HEIGHT = 768, 432
"""Size of the view [pixels]."""
SAMPLES = 1
"""Samples per pixel with a denoiser. The view has to show where the stroke is, and on which ridges: 512 × 288 pixels
would cost half as much and lose those (docs/benchmarks.md)."""
SAMPLES_UNDENOISED = 12
"""Samples per pixel without a denoiser."""
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
LOOK_WIDTH = WIDTH // 8
"""Width of a quick render that tells what hides a stroke before its view is rendered [pixels]."""
MAX_STROKE_VIEWS = 1 + MAX_CUTS
"""Maximum number of views rendered for one stroke, besides those that it shares."""
MIN_SHARED_FRACTION = 0.1
"""Extent of a stroke, as a fraction of the image's width, below which it does not share an overview."""
MIN_SHARING_STROKES = 2
"""Number of strokes from which they share an overview."""
MAX_SHARED_ANGLE_RAD = np.radians(50.0)
"""Maximum angle between the outward directions of strokes in one overview [rad]."""
MAX_MISSES = 8
"""Number of strokes, nearest first, that do not fit into a shared overview before it is complete."""
SHARED_FILL = 0.8
"""Extent of all strokes of a shared overview, as a fraction of the image's width or height."""
PIXELS_OF_DEPTH = 2.5
"""Depth behind the visible surface from which a point is hidden, in widths of a pixel, where pixels are wide."""


@dataclass(frozen=True)
class Overview:
    """A lit view of a stroke, and notes for the user."""

    view: RgbdView
    notes: tuple[str, ...]

    def mask_visible(self, path: Float) -> NDArray[np.bool_]:
        """Return a mask (n,) of the path's points (n, 3) that are visible."""
        return mask_visible_points(self.view.camera, self.view.depth, path)


@dataclass(frozen=True, eq=False)
class CameraView:
    """A camera from which one or more strokes may be shown.

    `path` (n, 3) are the strokes in world coordinates [m]; `radius_m` is the radius around them that the view should
    show; `touched` are the objects that they touch.
    """

    path: Float
    camera: Camera
    radius_m: float
    touched: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class StrokeCameras:
    """The cameras from which a stroke may be shown.

    Attributes
    ----------
    name : str
        Name of the stroke, for notes.
    own : CameraView
        Overview of the stroke alone.
    outward : (3,) array
        Mean outward direction of its surface, in world coordinates.
    force : (n,) array
        Normal force [N].
    shared : CameraView or None
        View by the scene's camera, or an overview, in which it is tried first.
    """

    name: str
    own: CameraView
    outward: Float
    force: Float
    shared: CameraView | None = None


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
    """Context manager that renders the views shown in the plots of one run, those that strokes share once.

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
        self._shared: tuple[CameraView, Overview] | None = None
        self._stack = ExitStack()
        self._overviews: OverviewRenderer | None = None

    def __enter__(self) -> StrokeViews:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def choose_cameras(self, strokes: Iterable[tuple[str, Contacts, Surface, Any]]) -> list[StrokeCameras]:
        """Choose the cameras of all strokes; nothing is rendered.

        Parameters
        ----------
        strokes : iterable of tuple
            Name, contacts, touched surface, and touched object of each stroke.

        Returns
        -------
        list of StrokeCameras
            In the order of the strokes.
        """
        return choose_cameras(self._scene, self._metres, strokes)

    def hash_view(self, cameras: StrokeCameras) -> str:
        """Hash everything that a stroke's view may show; nothing is rendered."""
        views = (view for view in (cameras.shared, cameras.own) if view is not None)
        return content_hash(
            *(self._hashes.hash_view(view.camera, self._list_objects(view)) for view in views),
            cameras.own.path.tobytes(),
            cameras.force.tobytes(),
            str(_get_sample_count()),
            str(has_denoiser()),
        )

    def render_stroke(self, cameras: StrokeCameras) -> tuple[StrokeView, tuple[str, ...]]:
        """Render the view of a stroke and mark its path.

        The shared view is used if it shows enough of the stroke, else its own, with obstacles clipped away. Only the
        last shared view is kept: strokes that share one come one after the other.

        Parameters
        ----------
        cameras : StrokeCameras
            Cameras of the stroke.

        Returns
        -------
        view : StrokeView
        notes : tuple of str
            Remarks for the user.
        """
        path, note = cameras.own.path, ""
        overview = None if cameras.shared is None else self._get_shared_overview(cameras.shared)
        if overview is None or overview.mask_visible(path).mean() < MIN_VISIBLE_FRACTION:
            overview, note = self._render_past_obstacles(cameras.own)
        visible = overview.mask_visible(path)
        if not visible.any():
            note = "all of it is hidden in its picture."
        uv, _ = overview.view.camera.project(path)
        notes = (*overview.notes, *([f"stroke '{cameras.name}': {note}"] if note else []))
        return StrokeView(overview.view.rgb, uv, cameras.force, visible), notes

    def _get_shared_overview(self, camera_view: CameraView) -> Overview:
        if self._shared is None or self._shared[0] is not camera_view:
            self._shared = (camera_view, self._render(camera_view))
        return self._shared[1]

    def _render_past_obstacles(self, camera_view: CameraView) -> tuple[Overview, str]:
        """Return the view from a camera, clipped where obstacles hide the path, and a note if it is clipped."""
        own, path = camera_view, camera_view.path
        with self._get_overviews().link_objects(self._list_objects(camera_view)):
            for cuts_left in range(MAX_CUTS, -1, -1):
                cut = self._cut_by_look(camera_view) if cuts_left else None
                if cut is None:
                    overview = self._render(camera_view)
                    if cuts_left and overview.mask_visible(path).mean() < MIN_VISIBLE_FRACTION:
                        cut = clip_obstacles(overview.view.camera, overview.view.depth, path, camera_view.radius_m)
                    if cut is None:
                        break
                camera_view = replace(camera_view, camera=cut)
        return overview, "" if camera_view is own else "what stands before it is cut away in its picture."

    def _cut_by_look(self, camera_view: CameraView) -> Camera | None:
        """Return the camera with its near clipping plane moved past what hides the path; None if nothing does.

        A small quick render tells, which misses what lies within some of its wide pixels of the path.
        """
        camera = resize_camera(camera_view.camera, LOOK_WIDTH)
        depth = self._get_overviews().measure_depth(camera, self._list_objects(camera_view))
        if mask_visible_points(camera, depth, camera_view.path).mean() >= MIN_VISIBLE_FRACTION:
            return None
        cut = clip_obstacles(camera, depth, camera_view.path, camera_view.radius_m)
        return None if cut is None else replace(camera_view.camera, clip_start=cut.clip_start)

    def _render(self, camera_view: CameraView) -> Overview:
        self._counts.add("renders")
        return Overview(*self._get_overviews().render_view(camera_view.camera, self._list_objects(camera_view)))

    def _get_overviews(self) -> OverviewRenderer:
        if self._overviews is None:
            overviews = OverviewRenderer(
                self._scene, metres_per_unit=self._metres, samples=_get_sample_count(), relief="fast"
            )
            self._overviews = self._stack.enter_context(overviews)
        return self._overviews

    def _list_objects(self, camera_view: CameraView) -> list[Any]:
        return select_visible_objects(self._surroundings, camera_view.camera, camera_view.path, camera_view.touched)


def choose_cameras(
    scene: Any, metres_per_unit: float, strokes: Iterable[tuple[str, Contacts, Surface, Any]]
) -> list[StrokeCameras]:
    """Choose the cameras of all strokes of a scene, each with its name, contacts, surface and touched object."""
    chosen = [_make_own_camera(*stroke) for stroke in strokes]
    camera = _read_scene_camera(scene, metres_per_unit)
    in_frame = [
        index for index, stroke in enumerate(chosen) if camera is not None and is_path_visible(camera, stroke.own.path)
    ]
    groups = group_strokes([(index, chosen[index]) for index in sorted({*range(len(chosen))} - {*in_frame})])
    views = [(group, _make_shared_view([chosen[index] for index in group])) for group in groups]
    if camera is not None and in_frame:
        views.append((in_frame, replace(_make_shared_view([chosen[index] for index in in_frame]), camera=camera)))
    for members, view in views:
        for index in members:
            chosen[index] = replace(chosen[index], shared=view)
    return chosen


def count_views(cameras: Iterable[StrokeCameras]) -> int:
    """Return the number of views that strokes are shown in, if nothing hides one."""
    return len({id(each.shared or each) for each in cameras})


def _read_scene_camera(scene: Any, metres_per_unit: float) -> Camera | None:
    """Return the scene's camera at the plot's size; None without one, or without square pixels."""
    if scene.camera is None or scene.camera.data.type not in {"PERSP", "ORTHO"}:
        return None
    camera = read_camera(scene, scene.camera, metres_per_unit)
    if abs(camera.intrinsics[0, 0] / camera.intrinsics[1, 1] - 1.0) > 1e-6:
        return None
    return resize_camera(camera, WIDTH)


def _make_own_camera(name: str, contacts: Contacts, surface: Surface, touched: Any) -> StrokeCameras:
    """Make the overview camera of one stroke."""
    path = contacts.point @ surface.rigid[:3, :3].T + surface.rigid[:3, 3]
    outward = contacts.normal.mean(axis=0) @ surface.rigid[:3, :3].T
    extent = float(np.linalg.norm(path - path.mean(axis=0), axis=1).max())
    radius = 1.6 * extent + float(np.clip(2.5 * extent, *MARGIN_RANGE_M))
    camera = make_overview_camera(path, outward, radius, WIDTH, HEIGHT)
    return StrokeCameras(name, CameraView(path, camera, radius, (touched,)), outward, contacts.force)


def _make_shared_view(strokes: Sequence[StrokeCameras]) -> CameraView:
    """Make an overview of several strokes that is filled with them, but no closer than the widest of their own."""
    path = np.concatenate([stroke.own.path for stroke in strokes])
    outward = np.sum([_normalise(stroke.outward) for stroke in strokes], axis=0)
    middle = (path.min(axis=0) + path.max(axis=0)) / 2.0
    widest = max(stroke.own.radius_m for stroke in strokes)
    radius = max(widest, float(np.linalg.norm(path - middle, axis=1).max()))
    camera = make_overview_camera(path, outward, radius, WIDTH, HEIGHT)
    uv, _ = camera.project(path)
    size = np.array([WIDTH, HEIGHT])
    zoom = min(float((SHARED_FILL * size / np.maximum(np.ptp(uv, axis=0), 1e-9)).min()), radius / widest)
    centre = (uv.min(axis=0) + uv.max(axis=0)) / 2.0
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2] *= zoom
    intrinsics[:2, 2] += size / 2.0 - zoom * centre
    touched = {obj.as_pointer(): obj for stroke in strokes for obj in stroke.own.touched}
    return CameraView(path, replace(camera, intrinsics=intrinsics), radius, tuple(touched.values()))


def group_strokes(strokes: Sequence[tuple[int, StrokeCameras]]) -> list[list[int]]:
    """Group strokes that one overview can show at a legible size.

    From the first stroke on, each that is in no group yet takes in the nearest ones that face its way, as long as all
    of them are legible together. The same strokes in the same order give the same groups.

    Parameters
    ----------
    strokes : sequence of (int, StrokeCameras)
        Numbers of the strokes, and their cameras.

    Returns
    -------
    list of list of int
        Numbers of the strokes of each group with `MIN_SHARING_STROKES` or more.
    """
    corners = [replace(stroke, own=replace(stroke.own, path=_sample(stroke.own.path))) for _, stroke in strokes]
    middle = np.array([stroke.own.path.mean(axis=0) for stroke in corners]).reshape(-1, 3)
    outward = np.array([_normalise(stroke.outward) for stroke in corners]).reshape(-1, 3)
    extent = np.array([np.linalg.norm(np.ptp(stroke.own.path, axis=0)) for stroke in corners])
    is_free = np.ones(len(corners), dtype=np.bool_)
    groups = []
    for first in range(len(corners)):
        if not is_free[first]:
            continue
        distance = np.linalg.norm(middle - middle[first], axis=1)
        is_near = distance <= np.minimum(extent, extent[first]) / MIN_SHARED_FRACTION
        is_near &= is_free & (outward @ outward[first] >= np.cos(MAX_SHARED_ANGLE_RAD))
        is_near[first] = False
        group, misses = [first], 0
        for index in np.flatnonzero(is_near)[np.argsort(distance[is_near], kind="stable")].tolist():
            candidates = [corners[each] for each in (*group, index)]
            camera = _make_shared_view(candidates).camera
            if all(is_path_visible(camera, each.own.path, MIN_SHARED_FRACTION) for each in candidates):
                group.append(index)
            elif (misses := misses + 1) == MAX_MISSES:
                break
        if len(group) >= MIN_SHARING_STROKES:
            is_free[group] = False
            groups.append(sorted(strokes[index][0] for index in group))
    return groups


def _sample(path: Float, count: int = 9) -> Float:
    """Return points of a path, its ends included."""
    return np.asarray(path[np.linspace(0, len(path) - 1, min(count, len(path))).astype(int)])


def _normalise(vector: Float) -> Float:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


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


def is_path_visible(camera: Camera, path: Float, min_fraction: float = MIN_STROKE_FRACTION) -> bool:
    """Return True if a camera's frame contains the entire path (n, 3), and shows it large enough."""
    uv, depth = camera.project(path)
    size = np.array([camera.width, camera.height])
    inside = (uv > 0).all() and (uv < size).all() and (depth > camera.clip_start).all()
    extent = (uv.max(axis=0) - uv.min(axis=0)).max() if inside else 0.0
    return bool(extent >= min_fraction * camera.width)


def select_visible_objects(
    surroundings: Surroundings, camera: Camera, path: Float, touched: Sequence[Any]
) -> list[Any]:
    """Return the touched objects and the nearest of the surrounding objects whose bounding spheres are in view."""
    distance = np.linalg.norm(surroundings.centre - path.mean(axis=0), axis=1) - surroundings.radius
    visible = np.flatnonzero(may_be_visible(camera, surroundings.centre, surroundings.radius)).tolist()
    neighbours = sorted(
        (index for index in visible if surroundings.objects[index] not in touched),
        key=lambda index: (distance[index], surroundings.objects[index].name),
    )
    chosen, faces = list(touched), 0
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


def mask_visible_points(camera: Camera, depth: NDArray[np.float32], path: Float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the path's points (n, 3) that are visible where a view has a planar depth (H, W) [m]."""
    uv, path_depth = camera.project(path)
    inside = (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
    pixel_m = (path_depth if camera.kind == "perspective" else 1.0) / camera.intrinsics[0, 0]
    tolerance = np.maximum(OCCLUSION_DEPTH_M, PIXELS_OF_DEPTH * pixel_m)
    return np.asarray(inside & (path_depth <= sample_depth(depth, uv) + tolerance))
