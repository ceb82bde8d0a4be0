"""Lines and discs of the stroke overlay, by the gpu module. Batches are kept until a path changes."""

from __future__ import annotations

from typing import Any

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix
from numpy.typing import NDArray

from hnf_core.export.force_colour import Colour, force_to_colour

from .overlay_paths import OverlayPath

Float = NDArray[np.float64]

LINE_PX, ACTIVE_PX, HALO_PX = 2.0, 3.5, 3.0
HALO: Colour = (0.02, 0.02, 0.03, 0.75)
WHITE: Colour = (1.0, 1.0, 1.0, 1.0)
DEPTH_BIAS = 4e-3
"""By this share of its distance a line is drawn nearer than it is, so that it does not sink into the surface."""
OCCLUDED_ALPHA = 0.35
MUTED_ALPHA = 0.3
START_PX, CONTACT_PX, ACTIVE_CONTACT_PX = 5.0, 6.0, 8.0

_batches: dict[str, tuple[Any, Any, Any]] = {}


class OverlayView:
    """Of one region: where the eye is, and how long a pixel is."""

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

    def disc(self, centre: Float, radius_px: float, segments: int = 20) -> Float:
        """(segments, 3) corners of a disc in the world that faces the eye."""
        eye = self.view[:3, :3] @ centre + self.view[:3, 3]
        w = float(self.window[3, :3] @ eye + self.window[3, 3])
        radius = radius_px * self.pixel_size * 2.0 * abs(w) / (abs(self.window[1, 1]) * self.size[1])
        angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
        right, up = self.view[0, :3], self.view[1, :3]
        return np.asarray(centre + radius * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up))


def remove_batches(name: str) -> None:
    """Drop the batches of one stroke."""
    _batches.pop(name, None)


def draw_path(name: str, path: OverlayPath, world: Any, view: OverlayView, *, is_active: bool, is_muted: bool) -> None:
    """A path with its halo; what lies behind something shows through a little."""
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
    """A white ring."""
    _draw_disc(view.disc(point, START_PX + 1.5), HALO)
    _draw_disc(view.disc(point, START_PX), WHITE)
    _draw_disc(view.disc(point, START_PX - 2.0), HALO)


def draw_contact(point: Float, force_n: float, view: OverlayView, *, is_active: bool) -> None:
    """A disc of the force's colour; grey where the hand is in the air."""
    radius = ACTIVE_CONTACT_PX if is_active else CONTACT_PX
    _draw_disc(view.disc(point, radius + 2.5), HALO)
    _draw_disc(view.disc(point, radius + 1.0), WHITE)
    _draw_disc(view.disc(point, radius - 1.0), force_to_colour(force_n))


def _make_batches(path: OverlayPath) -> tuple[Any, Any, Any]:
    coloured, plain = (gpu.shader.from_builtin(f"POLYLINE_{kind}_COLOR") for kind in ("SMOOTH", "UNIFORM"))
    line = batch_for_shader(coloured, "LINE_STRIP", {"pos": path.points, "color": path.colours})
    halo = batch_for_shader(plain, "LINE_STRIP", {"pos": path.points})
    ticks = batch_for_shader(plain, "LINES", {"pos": path.ticks}) if len(path.ticks) else None
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


def _draw_disc(corners: Float, colour: Colour) -> None:
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_float("color", colour)
    fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
    batch_for_shader(shader, "TRIS", {"pos": corners.astype(np.float32)}, indices=fan).draw(shader)
    gpu.state.blend_set("NONE")


def _get_preferences() -> Any:
    import bpy

    return bpy.context.preferences
