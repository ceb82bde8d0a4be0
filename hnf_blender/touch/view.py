"""The rendered view in a stroke's picture: the scene's own camera where it shows the stroke, one of ours else."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts
from hnf_core.export.path_on_view import StrokeView
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera
from hnf_core.scene.view import RgbdView

from ..bridge.boxes import world_boxes
from ..bridge.meshes import Surface
from ..bridge.picture import Overviews
from ..bridge.picture_hash import PictureHashes
from ..bridge.scene_camera import camera_record, overview_camera
from ..compat import has_denoiser
from .cut_open import BEHIND_M, cut_open, depth_at
from .report import Counts

Float = NDArray[np.float64]

WIDTH, HEIGHT = 768, 432
SAMPLES = 2
"""Enough under a denoiser: on the demo scene 0.020 of sRGB (RMS) off 256 samples, and ridges a few pixels wide stay
(correlation 0.79; by colour alone 0.35). Four give 0.016 and 0.84 for half as much time again. A picture says where the
stroke is, and costs more than the touch itself."""
SAMPLES_UNDENOISED = 12
"""0.018 there (0.012 with 24)."""
LEAST_SHARE = 0.08
"""A stroke shorter than this share of the picture's width is better seen by a camera of our own."""
NEIGHBOURS, NEIGHBOUR_FACES = 40, 400_000
"""What else may stand in the picture: its cost must not follow the size of the scene."""
AROUND_M = (0.012, 0.03)
"""What a camera of our own shows beside a stroke: less of a short one, or it would be a speck."""
LEAST_SEEN = 0.25
"""Of a stroke's points; with fewer in sight another view of it is looked for."""
CUTS = 2
"""One obstacle may stand behind another."""
OWN_VIEWS = 1 + CUTS
"""Renders for one stroke at most, beside the scene camera's view, which all share."""


@dataclass(frozen=True)
class Overview:
    """A lit view and the camera it was taken with (world metres)."""

    view: RgbdView
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Shot:
    """How a stroke is to be seen. path: (n, 3) world metres. radius_m: around it, that the picture is meant to show."""

    path: Float
    camera: Camera
    radius_m: float


@dataclass(frozen=True)
class Crowd:
    """What may stand in a picture beside what is touched. centre: (n, 3), radius: (n,) of the objects' bounding spheres
    in world metres."""

    objects: tuple[Any, ...]
    centre: Float
    radius: Float


def crowd_of(scene: Any, depsgraph: Any, metres_per_unit: float) -> Crowd:
    """All of the scene that renders, without its strokes."""
    objects = tuple(
        obj
        for obj in scene.objects
        if obj.type in {"MESH", "CURVE", "SURFACE", "META", "FONT"}
        and not obj.hide_render
        and not (obj.type == "CURVE" and obj.hnf_stroke.is_stroke)
    )
    low, high = world_boxes(objects, depsgraph, metres_per_unit)
    return Crowd(objects, (low + high) / 2.0, np.linalg.norm(high - low, axis=1) / 2.0)


class Views:
    """Overviews of one run; a scene camera that serves several strokes is rendered once. Use as a context manager.

    depsgraph: of the scene as it is now. A run adds nothing but strokes to it, so that boxes hold for all of it: after
    any change of the file's data Blender would evaluate the relations of every object again. source: hash of its file.
    """

    def __init__(self, scene: Any, depsgraph: Any, metres_per_unit: float, counts: Counts, source: str = "") -> None:
        self._scene, self._metres, self._counts = scene, metres_per_unit, counts
        self._crowd = crowd_of(scene, depsgraph, metres_per_unit)
        self._hashes = PictureHashes(scene, depsgraph, metres_per_unit, source)
        self._from_scene_camera: Overview | None = None
        self._stack = ExitStack()
        self._overviews: Overviews | None = None

    def __enter__(self) -> Views:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def hash_of(self, contacts: Contacts, surface: Surface, touched: Any) -> str:
        """Of all that the picture of a stroke may show; nothing is rendered."""
        shots = self._shots(contacts, surface)
        views = (self._hashes.of(shot.camera, self._objects(shot, touched)) for shot in shots)
        return content_hash(
            *views, shots[0].path.tobytes(), contacts.force.tobytes(), str(_samples()), str(has_denoiser())
        )

    def of_stroke(
        self, contacts: Contacts, surface: Surface, touched: Any, name: str
    ) -> tuple[StrokeView, tuple[str, ...]]:
        """The picture of stroke `name` with its path in it, and notes. touched: the object under the stroke.

        The scene's camera where it shows enough of the stroke; else one before the surface, and where something stands
        between, that is cut away.
        """
        *shared, own = self._shots(contacts, surface)
        overview, told = None if not shared else self._shared(shared[0], touched), ""
        if overview is None or sight(overview.view, own.path).mean() < LEAST_SEEN:
            overview, told = self._past_obstacles(own, touched)
        visible = sight(overview.view, own.path)
        if not visible.any():
            told = "all of it is hidden in its picture."
        uv, _ = overview.view.camera.project(own.path)
        notes = (*overview.notes, *([f"stroke '{name}': {told}"] if told else []))
        return StrokeView(overview.view.rgb, uv, contacts.force, visible), notes

    def _shots(self, contacts: Contacts, surface: Surface) -> tuple[Shot, ...]:
        """By the scene's camera where it has the whole path in its frame, and by one of our own."""
        path = contacts.point @ surface.rigid[:3, :3].T + surface.rigid[:3, 3]
        outward = contacts.normal.mean(axis=0) @ surface.rigid[:3, :3].T
        half = float(np.linalg.norm(path - path.mean(axis=0), axis=1).max())
        radius = 1.6 * half + float(np.clip(2.5 * half, *AROUND_M))
        own = Shot(path, overview_camera(path, outward, radius, WIDTH, HEIGHT), radius)
        camera = self._scene_camera()
        return (own,) if camera is None or not shows(camera, path) else (Shot(path, camera, radius), own)

    def _shared(self, shot: Shot, touched: Any) -> Overview:
        if self._from_scene_camera is None:
            self._from_scene_camera = self._render(shot, touched)
        return self._from_scene_camera

    def _past_obstacles(self, shot: Shot, touched: Any) -> tuple[Overview, str]:
        """The view that shows most of the path, and what was done for it."""
        views = [self._render(shot, touched)]
        while len(views) <= CUTS and sight(views[-1].view, shot.path).mean() < LEAST_SEEN:
            last = views[-1].view
            uv, depth = last.camera.project(shot.path)
            camera = cut_open(last.camera, depth, depth_at(last.depth, uv), shot.radius_m)
            if camera is None:
                break
            views.append(self._render(replace(shot, camera=camera), touched))
        best = max(views, key=lambda each: sight(each.view, shot.path).sum())
        return best, "" if best is views[0] else "what stands before it is cut away in its picture."

    def _render(self, shot: Shot, touched: Any) -> Overview:
        if self._overviews is None:
            overviews = Overviews(self._scene, metres_per_unit=self._metres, samples=_samples(), relief=True)
            self._overviews = self._stack.enter_context(overviews)
        self._counts.renders += 1
        return Overview(*self._overviews.view(shot.camera, self._objects(shot, touched)))

    def _objects(self, shot: Shot, touched: Any) -> list[Any]:
        return in_view(self._crowd, shot.camera, shot.path, touched)

    def _scene_camera(self) -> Camera | None:
        """The scene's camera at the picture's size; None where there is none, or it has no flat, square pixels."""
        if self._scene.camera is None or self._scene.camera.data.type not in {"PERSP", "ORTHO"}:
            return None
        camera = camera_record(self._scene, self._scene.camera, self._metres)
        if abs(camera.intrinsics[0, 0] / camera.intrinsics[1, 1] - 1.0) > 1e-6:
            return None
        return resized(camera, WIDTH)


def _samples() -> int:
    return SAMPLES if has_denoiser() else SAMPLES_UNDENOISED


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


def in_view(crowd: Crowd, camera: Camera, path: Float, touched: Any) -> list[Any]:
    """The touched object and the nearest neighbours whose bounding sphere meets the picture."""
    away = np.linalg.norm(crowd.centre - path.mean(axis=0), axis=1) - crowd.radius
    seen = np.flatnonzero(meets_view(camera, crowd.centre, crowd.radius)).tolist()
    near = sorted(
        (index for index in seen if crowd.objects[index] != touched),
        key=lambda index: (away[index], crowd.objects[index].name),
    )
    chosen, faces = [touched], 0
    for obj in (crowd.objects[index] for index in near[:NEIGHBOURS]):
        faces += len(obj.data.polygons) if obj.type == "MESH" else 1000
        if faces > NEIGHBOUR_FACES:
            break
        chosen.append(obj)
    return chosen


def meets_view(camera: Camera, centre: Float, radius: Float) -> NDArray[np.bool_]:
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


def sight(view: RgbdView, path: Float) -> NDArray[np.bool_]:
    """(n,) is a point of the path (n, 3) what the picture shows there?"""
    uv, depth = view.camera.project(path)
    inside = (uv >= 0).all(axis=1) & (uv < [view.camera.width, view.camera.height]).all(axis=1)
    return np.asarray(inside & (depth <= depth_at(view.depth, uv) + BEHIND_M))
