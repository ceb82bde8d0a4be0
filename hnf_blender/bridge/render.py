"""Renders by Cycles on the CPU, in temporary scenes, read back through a multilayer EXR."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera
from hnf_core.scene.exr import read_exr

from .. import compat
from .quiet import suppress_output
from .taps import Tap
from .temporary import TemporaryScene

NO_HIT_DEPTH = 1e9
"""Cycles writes 1e10 where a camera ray meets nothing."""


def configure_cycles(scene: Any, samples: int) -> None:
    """Cycles on the CPU into a multilayer EXR, no compositor, no sequencer; one sample is exact, never denoised."""
    try:
        scene.render.engine = "CYCLES"
    except TypeError as error:
        raise SceneError(
            "Cycles is switched off.", where="Blender", remedy="Enable 'Cycles Render Engine' in the preferences."
        ) from error
    render, cycles = scene.render, scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.seed = 0
    render.resolution_percentage = 100
    render.use_compositing = render.use_sequencer = render.use_border = render.use_multiview = False
    render.use_motion_blur = render.use_simplify = render.use_stamp = render.use_freestyle = False
    render.use_overwrite, render.use_placeholder, render.use_file_extension = True, False, True
    render.film_transparent = False
    compat.use_multilayer_exr(render)


def disable_lighting(scene: Any) -> None:
    """No light is followed: one sample of the first surface under each pixel centre."""
    cycles = scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 0
    cycles.transparent_max_bounces = 0


def add_aovs(view_layer: Any, taps: Iterable[Tap]) -> None:
    for tap in taps:
        aov = view_layer.aovs.add()
        aov.name, aov.type = tap.name, tap.kind


def add_camera(temporary: TemporaryScene, name: str = "hnf camera") -> Any:
    import bpy

    camera = temporary.new_object(name, bpy.data.cameras.new(name))
    temporary.scene.camera = camera
    return camera


def set_camera(scene: Any, camera_object: Any, camera: Camera, rigid: ArrayLike, metres_per_unit: float) -> None:
    """Set Blender's camera to camera, whose pose is in a frame that rigid (4, 4) brings to world metres.

    Square pixels only. Raises SceneError for a pixel aspect other than 1.
    """
    from mathutils import Matrix

    focal_x, focal_y = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    if abs(focal_x - focal_y) > 1e-6 * focal_x:
        raise SceneError("its pixels are not square.", where="camera", remedy="Render with pixel aspect 1.")
    pose = np.asarray(rigid, dtype=np.float64) @ camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] /= metres_per_unit
    camera_object.matrix_world = Matrix(pose.tolist())
    data, longest = camera_object.data, max(camera.width, camera.height)
    data.sensor_fit = "AUTO"
    if camera.kind == "orthographic":
        data.type, data.ortho_scale = "ORTHO", longest / focal_x / metres_per_unit
    else:
        data.type = "PERSP"
        data.lens = focal_x / longest * data.sensor_width
    data.shift_x = (camera.width / 2.0 - camera.intrinsics[0, 2]) / longest
    data.shift_y = (camera.intrinsics[1, 2] - camera.height / 2.0) / longest
    data.clip_start = max(camera.clip_start / metres_per_unit, 1e-6)
    data.clip_end = min(camera.clip_end / metres_per_unit, 1e6)
    render = scene.render
    render.resolution_x, render.resolution_y = camera.width, camera.height
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def render_passes(temporary: TemporaryScene) -> dict[str, NDArray[np.float32]]:
    """Render the temporary scene from its camera and read every pass. Raises SceneError where Blender fails."""
    import bpy

    path = temporary.folder / "passes.exr"
    path.unlink(missing_ok=True)
    temporary.scene.render.filepath = str(path)
    try:
        # An operator updates its context's view layer: ours, or cost would follow the size of the user's scene.
        with suppress_output(), bpy.context.temp_override(scene=temporary.scene, view_layer=temporary.view_layer):
            bpy.ops.render.render(scene=temporary.scene.name, layer=temporary.view_layer.name, write_still=True)
    except RuntimeError as error:
        raise SceneError(f"Blender could not render ({error}).", where="close-up") from error
    return read_exr(path)


def get_planar_depth(passes: dict[str, NDArray[np.float32]], metres_per_unit: float) -> NDArray[np.float32]:
    """Depth pass in metres, sky = inf."""
    depth = passes["Depth"]
    return np.where(depth < NO_HIT_DEPTH, depth * np.float32(metres_per_unit), np.inf).astype(np.float32)
