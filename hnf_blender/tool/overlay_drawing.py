"""Geometry and drawing of the stroke overlay: stroke → `OverlayPath` → lines and discs, by Blender's gpu module.

Paths and batches are cached until a stroke changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix
from numpy.typing import NDArray

from hnf_core.action.curves import ArcCurve
from hnf_core.errors import HnfError
from hnf_core.export.figure import Colour, force_to_colour

from ..state.interface import HALO, WHITE, draw_disc

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]

STEP_M = 1e-3
"""Distance between the points of a path [m]."""
MAX_POINTS = 1500
"""Largest number of points of a path."""
TICK_SPACING_M = 8e-3
"""Distance between direction ticks along the path [m]."""
MIN_TICKS, MAX_TICKS = 2, 10
"""Smallest and largest number of ticks."""
TICK_SHARE = 0.028
"""Length of a tick's arms as a fraction of the curve's length."""
TICK_SIZE_M = (0.6e-3, 4e-3)
"""Smallest and largest length of a tick's arms [m]."""


@dataclass(frozen=True)
class OverlayPath:
    """Path of a stroke to be drawn, in the coordinates of its object, so that moving the object costs nothing.

    Attributes
    ----------
    points : (k, 3) array
        Points in the order of the motion.
    colours : (k, 4) array
        Colors of the points.
    ticks : (4m, 3) array
        Pairs of end points.
    frames : (n,) array
        Frames, ascending.
    contact_points : (n, 3) array
        Contact point at each frame.
    forces : (n,) array
        Normal force at each frame [N].
    """

    points: Float32
    colours: Float32
    ticks: Float32
    frames: Float
    contact_points: Float32
    forces: Float


def compute_overlay_path(obj: Any, scene: Any, depsgraph: Any, metres_per_unit: float) -> OverlayPath | None:
    """Compute the path of a stroke; None if it cannot be read, which the Touch tab reports.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    scene : bpy.types.Scene
        Gives frame rate and animation.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph with the touched surface.
    metres_per_unit : float
        Length of a scene unit [m].
    """
    from ..bridge.stroke.read_stroke import sample_timeline

    try:
        timeline = sample_timeline(obj, scene, metres_per_unit)
    except HnfError:
        return None
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    if abs(np.linalg.det(world[:3, :3])) < 1e-30:
        return None
    local = np.linalg.inv(world)
    distance = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(timeline.position)))])
    count = int(np.clip(np.ceil(distance[-1] / STEP_M) + 1, 2, MAX_POINTS))
    sample_index = np.interp(np.linspace(0.0, distance[-1], count), distance, np.arange(len(distance)))
    position, force = (
        np.interp(sample_index, np.arange(len(distance)), values) for values in (timeline.position, timeline.force)
    )
    arc = timeline.arc
    return OverlayPath(
        points=_transform_points(local, arc.point_at(position)),
        colours=_compute_colours(force),
        ticks=_transform_points(local, _compute_ticks(arc, position, obj, depsgraph, metres_per_unit)),
        frames=timeline.frames,
        contact_points=_transform_points(local, arc.point_at(timeline.position)),
        forces=timeline.force,
    )


def _compute_ticks(arc: ArcCurve, position: Float, obj: Any, depsgraph: Any, metres_per_unit: float) -> Float:
    """Return V-shaped marks on the surface that point in the direction of motion: (4m, 3) pairs of end points [m].

    `position` (n,) is the distance along the curve `arc` over time [m].
    """
    distance = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(position)))])
    if distance[-1] <= 0.0:
        return np.empty((0, 3))
    count = int(np.clip(distance[-1] / TICK_SPACING_M, MIN_TICKS, MAX_TICKS))
    fraction = (np.arange(count) + 0.5) / count
    index = np.clip(np.searchsorted(distance, fraction * distance[-1]), 1, len(distance) - 1)
    tip = arc.point_at(position[index])
    size = float(np.clip(TICK_SHARE * arc.length, *TICK_SIZE_M))
    # The direction is taken over the length of the arms, so that a trembling hand does not turn them.
    ahead = arc.point_at(position[index] + size) - arc.point_at(position[index] - size)
    ahead *= np.sign(position[index] - position[index - 1])[:, None]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    normal = _find_normals(tip, ahead, obj, depsgraph, metres_per_unit)
    sideways = np.cross(normal, ahead)
    sideways /= np.maximum(np.linalg.norm(sideways, axis=1, keepdims=True), 1e-12)
    ends = [tip - size * (ahead + side * sideways) for side in (-1.0, 1.0)]
    return np.asarray(np.stack([ends[0], tip, tip, ends[1]], axis=1).reshape(-1, 3))


def _find_normals(points: Float, ahead: Float, obj: Any, depsgraph: Any, metres_per_unit: float) -> Float:
    """Return the normals (m, 3) of the touched surface at points (m, 3) [m].

    Without a surface they are vertical, or horizontal where the direction of motion `ahead` (m, 3) is nearly vertical.
    """
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    normals[np.abs(ahead[:, 2]) > 0.9] = (1.0, 0.0, 0.0)
    surface = obj.hnf_stroke.surface or obj.parent
    if surface is None or surface.type != "MESH":
        return normals
    evaluated = surface.evaluated_get(depsgraph)
    if evaluated.data is None or len(evaluated.data.polygons) == 0:
        return normals
    world = np.array(evaluated.matrix_world, dtype=np.float64)
    if abs(np.linalg.det(world[:3, :3])) < 1e-30:
        return normals
    inverse = np.linalg.inv(world)
    for k, point in enumerate(points / metres_per_unit @ inverse[:3, :3].T + inverse[:3, 3]):
        try:
            is_found, _, normal, _ = evaluated.closest_point_on_mesh(point)
        except RuntimeError:  # The surface has no mesh in this view layer, e.g. hidden or excluded.
            return normals
        world_normal = inverse[:3, :3].T @ np.array(normal)
        if is_found and np.linalg.norm(world_normal) > 0.0:
            normals[k] = world_normal / np.linalg.norm(world_normal)
    return normals


def _transform_points(matrix: Float, points: Float) -> Float32:
    return np.ascontiguousarray(points @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float32)


def _compute_colours(force: Float) -> Float32:
    return np.array([force_to_colour(float(value)) for value in force], dtype=np.float32).reshape(-1, 4)


LINE_PX, ACTIVE_PX, HALO_PX = 2.0, 3.5, 3.0
"""Line width of a path, of the active one, and added by the halo [px]."""
DEPTH_BIAS = 4e-3
"""Fraction of its distance by which a line is drawn nearer, so that it does not sink into the surface."""
OCCLUDED_ALPHA = 0.35
"""Opacity of lines behind objects."""
MUTED_ALPHA = 0.3
"""Opacity of muted strokes."""
START_PX, CONTACT_PX, ACTIVE_CONTACT_PX = 5.0, 6.0, 8.0
"""Radius of the start ring, of a contact, and of the active contact [px]."""

CONTACT_SHARE = 0.04
"""Largest radius of a contact as a fraction of its stroke's size."""

_batches: dict[str, tuple[Any, Any, Any]] = {}
"""Batches for path, halo and ticks by stroke name."""


class OverlayView:
    """Projection of one 3D view region, with the size of a pixel in the world."""

    def __init__(self, region_data: Any, region: Any) -> None:
        scale = float(_get_preferences().system.pixel_size or 1.0)
        self.size = (float(region.width), float(region.height))
        self.pixel_size = scale
        self.view = np.array(region_data.view_matrix)
        self.window = np.array(region_data.window_matrix)
        self.is_perspective = bool(region_data.is_perspective)
        distance = float(region_data.view_distance)
        self.depth_bias_matrix = (
            Matrix.Diagonal((1.0 - DEPTH_BIAS, 1.0 - DEPTH_BIAS, 1.0 - DEPTH_BIAS, 1.0))
            if self.is_perspective
            else Matrix.Translation((0.0, 0.0, DEPTH_BIAS * distance))
        )

    def disc(self, centre: Float, radius_px: float, segments: int = 20, largest: float = np.inf) -> Float:
        """Return the corners (segments, 3) of a disc that faces the viewer, in world coordinates.

        Its radius is `radius_px`, but not more than `largest` [Blender units].
        """
        eye = self.view[:3, :3] @ centre + self.view[:3, 3]
        w = float(self.window[3, :3] @ eye + self.window[3, 3])
        radius = min(radius_px * self.pixel_size * 2.0 * abs(w) / (abs(self.window[1, 1]) * self.size[1]), largest)
        angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
        right, up = self.view[0, :3], self.view[1, :3]
        return np.asarray(centre + radius * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up))


def remove_batches(name: str) -> None:
    """Remove the cached GPU batches of a stroke."""
    _batches.pop(name, None)


def draw_path(name: str, path: OverlayPath, world: Any, view: OverlayView, *, is_active: bool, is_muted: bool) -> None:
    """Draw a stroke's path with a halo (a wider line behind it); parts hidden by objects show through faintly."""
    if name not in _batches:
        _batches[name] = _make_batches(path)
    line, halo, ticks = _batches[name]
    width = (ACTIVE_PX if is_active else LINE_PX) * view.pixel_size
    alpha = MUTED_ALPHA if is_muted else 1.0
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_mask_set(False)
    with gpu.matrix.push_pop():
        base = gpu.matrix.get_model_view_matrix()
        gpu.matrix.load_matrix(view.depth_bias_matrix @ base @ world)
        gpu.state.depth_test_set("GREATER")
        _draw_lines(halo, (*HALO[:3], OCCLUDED_ALPHA * alpha), width, view)
        gpu.state.depth_test_set("LESS_EQUAL")
        _draw_lines(halo, (*HALO[:3], HALO[3] * alpha), width + HALO_PX * view.pixel_size, view)
        if is_active:
            _draw_lines(ticks, (*HALO[:3], HALO[3] * alpha), width + HALO_PX * view.pixel_size, view)
            _draw_lines(ticks, (*WHITE[:3], alpha), 0.6 * width, view)
        _draw_lines(line, None, width, view)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def draw_start(point: Float, view: OverlayView) -> None:
    """Draw a white ring at the start."""
    draw_disc(view.disc(point, START_PX + 1.5), HALO)
    draw_disc(view.disc(point, START_PX), WHITE)
    draw_disc(view.disc(point, START_PX - 2.0), HALO)


def draw_contact(point: Float, force_n: float, view: OverlayView, *, is_active: bool, extent: float) -> None:
    """Draw a disc in the force's color; gray without contact. What hides the point hides the disc.

    `extent` is the size of the stroke [Blender units], so that a disc seen from afar is no blob that covers it.
    """
    radius, largest = ACTIVE_CONTACT_PX if is_active else CONTACT_PX, CONTACT_SHARE * extent
    with gpu.matrix.push_pop():
        gpu.matrix.load_matrix(view.depth_bias_matrix @ gpu.matrix.get_model_view_matrix())
        gpu.state.depth_test_set("LESS_EQUAL")
        for added_px, colour in ((2.5, HALO), (1.0, WHITE), (-1.0, force_to_colour(force_n))):
            share = (radius + added_px) / radius
            draw_disc(view.disc(point, radius + added_px, largest=largest * share), colour)
        gpu.state.depth_test_set("NONE")


def _make_batches(path: OverlayPath) -> tuple[Any, Any, Any]:
    colour_shader, uniform_shader = (
        gpu.shader.from_builtin(f"POLYLINE_{kind}_COLOR") for kind in ("SMOOTH", "UNIFORM")
    )
    line = batch_for_shader(colour_shader, "LINE_STRIP", {"pos": path.points, "color": path.colours})
    halo = batch_for_shader(uniform_shader, "LINE_STRIP", {"pos": path.points})
    ticks = batch_for_shader(uniform_shader, "LINES", {"pos": path.ticks}) if len(path.ticks) else None
    return line, halo, ticks


def _draw_lines(batch: Any, colour: Colour | None, width: float, view: OverlayView) -> None:
    if batch is None:
        return
    shader = gpu.shader.from_builtin("POLYLINE_SMOOTH_COLOR" if colour is None else "POLYLINE_UNIFORM_COLOR")
    shader.bind()
    shader.uniform_float("viewportSize", view.size)
    shader.uniform_float("lineWidth", width)
    if colour is not None:
        shader.uniform_float("color", colour)
    batch.draw(shader)


def _get_preferences() -> Any:
    import bpy

    return bpy.context.preferences
