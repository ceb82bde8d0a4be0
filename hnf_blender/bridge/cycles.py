"""Cycles renders on the CPU in temporary scenes, read back from a multilayer EXR; cameras and unlit images.

`read_camera` and `set_camera` convert between Blender's cameras and `Camera`; `make_overview_camera` makes one for
scenes without a camera.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.errors import SceneError
from hnf_core.progress import add_work
from hnf_core.scene.camera import Camera
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.rgbd_view import read_exr

from .. import compat
from .scene.temp_scene import TemporaryScene, suppress_output
from .shader.aov_taps import Passes, Tap, compute_resolved_wavelength
from .shader.closures import ColourSources

NO_HIT_DEPTH = 1e9
"""Depth from which a pixel counts as empty; Cycles writes 1e10 there."""


def configure_cycles(scene: Any, samples: int) -> None:
    """Set up Cycles on the CPU with a multilayer EXR, without compositor, sequencer and denoising.

    `samples` is per pixel; one is exact for unlit AOVs. Raises SceneError if Cycles is disabled.
    """
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
    """Stop every path at the first surface, so that one sample per pixel center is enough."""
    cycles = scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 0
    cycles.transparent_max_bounces = 0


def add_aovs(view_layer: Any, taps: Iterable[Tap]) -> None:
    """Add an AOV pass to a view layer for every tap (a shader value that an AOV Output node writes)."""
    for tap in taps:
        add_work("passes", item=tap.name)
        aov = view_layer.aovs.add()
        aov.name, aov.type = tap.name, tap.kind


def add_camera(temporary: TemporaryScene) -> Any:
    """Add a camera to the temporary scene and make it the active one."""
    import bpy

    camera = temporary.new_object("hnf camera", bpy.data.cameras.new("hnf camera"))
    temporary.scene.camera = camera
    return camera


def set_camera(scene: Any, camera_object: Any, camera: Camera, rigid: ArrayLike, metres_per_unit: float) -> None:
    """Set a Blender camera and the render size to a Camera.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that is rendered.
    camera_object : bpy.types.Object
        Camera to set.
    camera : Camera
        Camera, in any metric frame.
    rigid : (4, 4) array_like
        World [m] ← that frame.
    metres_per_unit : float
        Length of the scene's unit [m].

    Raises
    ------
    SceneError
        If the pixels are not square.
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


PASSES_FILE = "passes.exr"
"""Name of the rendered file in the folder of a temporary scene."""


def render_passes(temporary: TemporaryScene) -> dict[str, NDArray[np.float32]]:
    """Render the temporary scene and return all passes by name. Raises SceneError if Blender fails."""
    import bpy

    path = temporary.folder / PASSES_FILE
    path.unlink(missing_ok=True)
    temporary.scene.render.filepath = str(path)
    try:
        # An operator updates its context's view layer. With the temporary one the cost does not depend on the user's
        # scene.
        with suppress_output(), compat.override_context(scene=temporary.scene, view_layer=temporary.view_layer):
            bpy.ops.render.render(scene=temporary.scene.name, layer=temporary.view_layer.name, write_still=True)
    except RuntimeError as error:
        raise SceneError(f"Blender could not render ({error}).", where="close-up") from error
    passes = read_exr(path)
    add_work("images", item=next(iter(passes.values())).shape[1])
    return passes


def get_planar_depth(passes: dict[str, NDArray[np.float32]], metres_per_unit: float) -> NDArray[np.float32]:
    """Return the planar depth (H, W) [m] from the rendered passes, inf where nothing is hit."""
    depth = passes["Depth"]
    return np.where(depth < NO_HIT_DEPTH, depth * np.float32(metres_per_unit), np.inf).astype(np.float32)


Float = NDArray[np.float64]

FIELD_OF_VIEW_RAD = np.radians(40.0)
"""Horizontal field of view of the overview camera [rad]."""


def read_camera(scene: Any, camera_object: Any, metres_per_unit: float, matrix_world: Any = None) -> Camera:
    """Return the Camera of a camera object as a scene renders it.

    Resolution and its percentage, pixel aspect, sensor fit and shift count; a render border does not.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that is rendered.
    camera_object : bpy.types.Object
        Camera object.
    metres_per_unit : float
        Length of the scene's unit [m].
    matrix_world : (4, 4) matrix, optional
        Evaluated world matrix of an animated camera; its current one by default.

    Returns
    -------
    Camera

    Raises
    ------
    SceneError
        For a panoramic camera.
    """
    data, render = camera_object.data, scene.render
    if data.type not in {"PERSP", "ORTHO"}:
        raise SceneError(
            "it is a panoramic camera, which has no flat picture.",
            where=f"camera '{camera_object.name}'",
            remedy="Choose Perspective or Orthographic as its type.",
        )
    width = max(1, render.resolution_x * render.resolution_percentage // 100)
    height = max(1, render.resolution_y * render.resolution_percentage // 100)
    frame = np.array([list(corner) for corner in data.view_frame(scene=scene)], dtype=np.float64)
    (left, bottom, _), (right, top, _) = frame.min(axis=0), frame.max(axis=0)
    # view_frame is on a plane in front of the camera; a perspective image scales with the plane's distance.
    plane_distance = -frame[0, 2] if data.type == "PERSP" else 1.0 / metres_per_unit
    scale_x, scale_y = width / (right - left), height / (top - bottom)
    intrinsics = np.array(
        [[scale_x * plane_distance, 0.0, -left * scale_x], [0.0, scale_y * plane_distance, top * scale_y], [0, 0, 1]]
    )
    matrix = camera_object.matrix_world if matrix_world is None else matrix_world
    pose = np.array([list(row) for row in matrix], dtype=np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    pose[:3, 3] *= metres_per_unit
    return Camera(
        "perspective" if data.type == "PERSP" else "orthographic",
        width,
        height,
        intrinsics,
        pose @ np.diag([1.0, -1.0, -1.0, 1.0]),
        data.clip_start * metres_per_unit,
        data.clip_end * metres_per_unit,
    )


def make_overview_camera(
    points: ArrayLike, outward: ArrayLike, radius_m: float, width: int = 960, height: int = 540
) -> Camera:
    """Make a perspective camera that shows points at a three-quarter view.

    Parameters
    ----------
    points : (n, 3) array_like
        World points [m], z up.
    outward : (3,) array_like
        Direction towards the viewer, e.g. the surface's normal.
    radius_m : float
        Minimum radius around the points' center that is in the image [m].
    width, height : int
        Image size [pixels].

    Returns
    -------
    Camera
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    normal = np.asarray(outward, dtype=np.float64)
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, normal)
    level = np.linalg.norm(side) < 0.2  # a table top or a ceiling: view it from the front
    lean = np.array([0.45, -0.8, 0.0]) if level else 0.5 * side / np.linalg.norm(side) + 0.35 * up
    back = normal + lean
    back = back / np.linalg.norm(back)
    reach = max(float(np.linalg.norm(points - middle, axis=-1).max(initial=0.0)), radius_m, 1e-6)
    focal = width / (2.0 * np.tan(FIELD_OF_VIEW_RAD / 2.0))
    distance = 1.1 * reach * np.hypot(focal, min(width, height) / 2.0) / (min(width, height) / 2.0)
    right = np.cross(up, back)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(-back, right), -back
    pose[:3, 3] = middle + distance * back
    intrinsics = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    return Camera("perspective", width, height, intrinsics, pose, distance * 1e-3, distance * 1e3)


ZOOM_PIXELS, ZOOM = 96, 8
"""Side [pixels] of a view of a patch's middle, and how much smaller its pixels are than the patch's: it shows waves
that the patch's pixels would fold into longer ones."""
MAX_OVERSAMPLING = 4
"""Most renders' pixels per pixel of a patch and axis, for a relief finer than its pixels."""
MAX_FOLDED_RATIO = 1.5
"""Power of waves finer than two pixels, over that of the octave above, which may fold. A vertical step has 1, so that
only what is rougher than any edge is worth more pixels."""
MIN_FOLDED_M = 20e-9
"""RMS height of waves finer than two pixels that may fold anyway [m]."""


@dataclass(frozen=True)
class Sampling:
    """Sampling of a relief that may be finer than a patch's pixels.

    Attributes
    ----------
    factor : int
        Rendered pixels per pixel and axis; more than 1 are reduced by a filter.
    folded_m : float
        RMS height of the waves that still fold into longer ones [m].
    """

    factor: int = 1
    folded_m: float = 0.0


PLAIN_SAMPLING = Sampling()
"""One rendered pixel per pixel."""


def choose_sampling(height: Float, mask: NDArray[np.bool_], zoom_pixel_m: float) -> Sampling:
    """Choose the sampling of a relief from a view of its middle (H, W) [m] with `ZOOM` times smaller pixels.

    `zoom_pixel_m` is their size [m], `mask` (H, W) the surface. The result's factor is the smallest at which little
    folds.
    """
    values = np.where(mask, height, 0.0)
    window = np.outer(np.hanning(values.shape[0]), np.hanning(values.shape[1])) * mask
    if not window.any():
        return Sampling()
    level = (values - np.average(values, weights=window)) * window
    power = np.square(np.abs(np.fft.fft2(level))) / (level.size * np.square(window).sum())
    frequency = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, values.shape), indexing="ij"))
    limit = 0.5 / ZOOM  # of the patch's pixels, in cycles per pixel of this view

    def sum_power(lowest: float, highest: float) -> float:
        return float(power[(frequency >= lowest) & (frequency < highest)].sum())

    beside = sum_power(limit / 2.0, limit)
    if sum_power(limit, np.inf) <= max(MAX_FOLDED_RATIO * beside, MIN_FOLDED_M**2):
        return Sampling()
    factor = 2
    while factor < MAX_OVERSAMPLING and sum_power(factor * limit, np.inf) > max(0.1 * beside, MIN_FOLDED_M**2):
        factor *= 2
    return Sampling(factor, float(np.sqrt(sum_power(factor * limit, np.inf))))


FILTER_REACH = 3
"""Distance from the surface's border up to which a filter of render passes mixes in what lies beyond [pixels]."""


def erode(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Return the pixels of a mask (H, W) at least so far from its border inside the image."""
    for axis in (0, 1):
        padded = np.pad(mask, [(pixels, pixels) if each == axis else (0, 0) for each in (0, 1)], mode="edge")
        size = mask.shape[axis]
        mask = np.logical_and.reduce([np.take(padded, range(i, i + size), axis) for i in range(2 * pixels + 1)])
    return mask


Mask = NDArray[np.bool_]

MAX_CODE = 255.0
"""Largest value of an 8-bit image."""
MAX_READABLE_WAVELENGTH_M = 1e-3
"""Longest resolved wavelength of an image from which a relief is predicted [m]. It is softer than the widest view, but
within the training data of D_φ: the blur of its training images (σ up to 0.6 pixels) halves a wave of 1 mm."""
MIN_COLOUR_STD_CODES = 1.0
"""RMS variation, in steps of 1/255, below which a color counts as uniform: a texture's rounding."""


@dataclass(frozen=True)
class UnlitImage:
    """Unlit color and depth of a patch (a square of surface), from which a relief can be predicted.

    Attributes
    ----------
    rgb : (H, W, 3) uint8 array
        255 times the square root of linear color, which has finer steps in the dark, as vision does.
    depth_m : (H, W) float32 array
        Planar depth from the close-up's camera [m], NaN without surface.
    resolved_wavelength_m : float
        Shortest wavelength that the image shows [m]: two texels of its finest texture, two pixels if procedural, two
        vertex spacings for vertex colors.
    source : str
        Description of what it is made from.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    resolved_wavelength_m: float
    source: str

    @property
    def linear(self) -> NDArray[np.float32]:
        """Linear color (H, W, 3), 0 to 1."""
        return np.asarray((self.rgb.astype(np.float32) / np.float32(MAX_CODE)) ** 2)


def make_unlit_image(
    sources: ColourSources,
    albedo: NDArray[np.float32],
    depth_m: Float,
    mask: Mask,
    *,
    passes: Passes,
    pixel_m: float,
    mesh: TriangleMesh,
    triangle: NDArray[np.int32],
) -> UnlitImage | None:
    """Make the unlit image of a patch.

    Parameters
    ----------
    sources : ColourSources
        Sources of the color.
    albedo : (H, W, 3) array
        Linear color.
    depth_m : (H, W) array
        Planar depth [m].
    mask : (H, W) bool array
        The patch's own surface.
    passes : Passes
        Rendered AOV passes with the texture coordinates of `sources`.
    pixel_m : float
        Size of a pixel [m].
    mesh : TriangleMesh
        Mesh of the surface.
    triangle : (H, W) int array
        Triangle at each pixel, −1 for none.

    Returns
    -------
    UnlitImage or None
        None if the color is uniform under `mask`, or its resolution is unknown.
    """
    if not mask.any():
        return None
    rgb = np.rint(MAX_CODE * np.sqrt(np.clip(np.nan_to_num(albedo), 0.0, 1.0))).astype(np.uint8)
    if float(rgb[mask].std(axis=0).max()) < MIN_COLOUR_STD_CODES:
        return None
    resolved = compute_resolved_wavelength((sources,), passes, mask, pixel_m)
    if sources.painted:
        resolved = min(resolved, max(2.0 * _compute_vertex_spacing(mesh, triangle[mask]), 2.0 * pixel_m))
    if not np.isfinite(resolved):
        return None
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float32)
    return UnlitImage(rgb, depth, resolved, sources.source)


def _compute_vertex_spacing(mesh: TriangleMesh, triangle: NDArray[np.int32]) -> float:
    """Return the vertex spacing [m] of a regular mesh whose triangles have the median area of the visible ones.

    `triangle` (H, W) is the triangle at each pixel, −1 for none.
    """
    corners = mesh.vertices[mesh.triangles[np.unique(triangle)]]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    return float(np.sqrt(2.0 * np.median(areas)))
