"""One lit view of a scene, and which faces of a surface it shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_blender.bridge.lit_render import OverviewRenderer
from hnf_blender.bridge.scene.meshes import Surface, make_ray_caster
from hnf_core.scene.camera import Camera
from hnf_core.scene.raycast import RayCaster, cast_view
from hnf_core.scene.rgbd_view import RgbdView

DEPTH_TOLERANCE = 1e-3
"""Relative depth difference under which a rendered pixel shows the surface that a ray met."""


def render_overview(
    scene: Any,
    camera: Camera | None,
    *,
    metres_per_unit: float = 1.0,
    samples: int = 16,
    objects: Sequence[Any] | None = None,
    surface: Surface | None = None,
    caster: RayCaster | None = None,
    frame: float | None = None,
) -> tuple[RgbdView, tuple[str, ...]]:
    """(view, notes): one view of Overviews. objects: None = everything. surface: fills face_id with the evaluated
    polygons of this object where it is what the camera sees."""
    with OverviewRenderer(
        scene, metres_per_unit=metres_per_unit, samples=samples, entire_scene=objects is None
    ) as overviews:
        view, notes = overviews.render_view(camera, objects or (), frame)
    if surface is not None:
        view = replace(view, face_id=find_visible_faces(view, surface, caster or make_ray_caster(surface.mesh)))
    return view, notes


def find_visible_faces(view: RgbdView, surface: Surface, caster: RayCaster) -> NDArray[np.int32]:
    """(H, W) evaluated polygon of surface that each pixel of view shows, -1 where it shows something else."""
    cast = cast_view(caster, surface.mesh, to_surface_frame(view.camera, surface))
    seen = np.isfinite(cast.depth) & np.isfinite(view.depth)
    ours, theirs = np.where(seen, cast.depth, 0.0), np.where(seen, view.depth, 0.0)
    same = seen & (np.abs(ours - theirs) <= DEPTH_TOLERANCE * ours)
    return np.where(same, cast.face_id, -1).astype(np.int32)


def to_surface_frame(camera: Camera, surface: Surface) -> Camera:
    """A world camera, seen from a surface's own frame."""
    return replace(camera, pose=np.linalg.inv(surface.rigid) @ camera.pose)
