"""What the overlay draws of each stroke, computed when something has changed and kept until it changes again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.curves import ArcCurve
from hnf_core.errors import HnfError
from hnf_core.export.force_colour import force_to_colour

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

STEP_M = 1e-3
MAX_POINTS = 1500
TICK_SPACING_M = 8e-3
"""A direction tick every so many metres of path, but FEWEST to MOST_TICKS of them."""
MIN_TICKS, MAX_TICKS = 2, 10
TICK_SHARE = 0.028
"""A tick's arms as a share of the curve's length, within TICK_SIZE_M."""
TICK_SIZE_M = (0.6e-3, 4e-3)


@dataclass(frozen=True)
class OverlayPath:
    """In the stroke object's coordinates, so that moving it costs nothing.

    points: (k, 3) along the way the hand takes. colours: (k, 4). ticks: (4m, 3) pairs of ends.
    frames: (n,) ascending. places: (n, 3) the contact point at these frames. forces: (n,) N.
    """

    points: Float32
    colours: Float32
    ticks: Float32
    frames: Float64
    contact_points: Float32
    forces: Float64


def compute_overlay_path(obj: Any, scene: Any, depsgraph: Any, metres_per_unit: float) -> OverlayPath | None:
    """None where the stroke cannot be read: the Touch tab says why."""
    from ..bridge.stroke_timeline import sample_timeline

    try:
        timeline = sample_timeline(obj, scene, metres_per_unit)
    except HnfError:
        return None
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    if abs(np.linalg.det(world[:3, :3])) < 1e-30:
        return None
    local = np.linalg.inv(world)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(timeline.position)))])
    count = int(np.clip(np.ceil(way[-1] / STEP_M) + 1, 2, MAX_POINTS))
    at = np.interp(np.linspace(0.0, way[-1], count), way, np.arange(len(way)))
    position, force = (np.interp(at, np.arange(len(way)), each) for each in (timeline.position, timeline.force))
    arc = timeline.arc
    return OverlayPath(
        points=_transform_points(local, arc.point_at(position)),
        colours=_compute_colours(force),
        ticks=_transform_points(local, _compute_ticks(arc, position, obj, depsgraph, metres_per_unit)),
        frames=timeline.frames,
        contact_points=_transform_points(local, arc.point_at(timeline.position)),
        forces=timeline.force,
    )


def _compute_ticks(arc: ArcCurve, position: Float64, obj: Any, depsgraph: Any, metres_per_unit: float) -> Float64:
    """Chevrons that lie on the surface and point where the hand goes: (4m, 3) pairs of ends in metres."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(position)))])
    if way[-1] <= 0.0:
        return np.empty((0, 3))
    count = int(np.clip(way[-1] / TICK_SPACING_M, MIN_TICKS, MAX_TICKS))
    share = (np.arange(count) + 0.5) / count
    index = np.clip(np.searchsorted(way, share * way[-1]), 1, len(way) - 1)
    tip = arc.point_at(position[index])
    size = float(np.clip(TICK_SHARE * arc.length, *TICK_SIZE_M))
    # Over as long a way as the arms: a tremble of the hand does not turn them.
    ahead = arc.point_at(position[index] + size) - arc.point_at(position[index] - size)
    ahead *= np.sign(position[index] - position[index - 1])[:, None]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    normal = _find_normals(tip, ahead, obj, depsgraph, metres_per_unit)
    aside = np.cross(normal, ahead)
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    ends = [tip - size * (ahead + side * aside) for side in (-1.0, 1.0)]
    return np.asarray(np.stack([ends[0], tip, tip, ends[1]], axis=1).reshape(-1, 3))


def _find_normals(points: Float64, ahead: Float64, obj: Any, depsgraph: Any, metres_per_unit: float) -> Float64:
    """The touched surface's normals (m, 3) in the world at points [m]; without a surface, as level as can be."""
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    up[np.abs(ahead[:, 2]) > 0.9] = (1.0, 0.0, 0.0)
    surface = obj.hnf_stroke.surface or obj.parent
    if surface is None or surface.type != "MESH":
        return up
    evaluated = surface.evaluated_get(depsgraph)
    if evaluated.data is None or len(evaluated.data.polygons) == 0:
        return up
    world = np.array(evaluated.matrix_world, dtype=np.float64)
    if abs(np.linalg.det(world[:3, :3])) < 1e-30:
        return up
    inverse = np.linalg.inv(world)
    for k, point in enumerate(points / metres_per_unit @ inverse[:3, :3].T + inverse[:3, 3]):
        try:
            found, _, normal, _ = evaluated.closest_point_on_mesh(point)
        except RuntimeError:  # no mesh of it in this view layer: appended with its stroke, hidden or excluded
            return up
        turned = inverse[:3, :3].T @ np.array(normal)
        if found and np.linalg.norm(turned) > 0.0:
            up[k] = turned / np.linalg.norm(turned)
    return up


def _transform_points(matrix: Float64, points: Float64) -> Float32:
    return np.ascontiguousarray(points @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float32)


def _compute_colours(force: Float64) -> Float32:
    return np.array([force_to_colour(float(each)) for each in force], dtype=np.float32).reshape(-1, 4)
