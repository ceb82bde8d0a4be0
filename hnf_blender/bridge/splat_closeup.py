"""Close-ups of a reconstructed surface: color and depth of a patch from its splats, faces from rays on the mesh.

A patch is a square of surface. This is the counterpart of `bridge/closeup.py` for surfaces with splats instead
of a shader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.library import Appearance
from hnf_core.scene.camera import CAMERA_DISTANCE_M, Camera, Patch
from hnf_core.scene.raycast import CastView, ViewCaster, cast_view
from hnf_core.scene.rgbd_view import RgbdView
from hnf_core.scene.splats.depth_views import compute_linear_colour
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.project import transform_to_principal_axes
from hnf_core.scene.splats.rasterize import SplatView, render_splats
from hnf_core.tactile.height import fill_masked
from hnf_core.tactile.image_resolution import estimate_resolved_wavelength

from .closeup import APPEARANCE_PIXELS, CloseUp, crop_to_patches, find_connected_pixels, make_unoccluded_camera
from .cycles import MAX_CODE, MIN_COLOUR_STD_CODES, UnlitImage
from .scene.meshes import Surface, make_ray_caster
from .splat_cloud import CloudFrame, compute_cloud_frame, get_cloud_source, read_cloud

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_SURFACE_OPACITY = 0.5
"""Opacity from which a pixel shows the surface, and not haze."""
MAX_SURFACE_OFFSET_M = CAMERA_DISTANCE_M / 2.0
"""Maximum distance between splat depth and mesh depth, after removing their median offset [m]. Pixels farther apart
than this, or than the resolved wavelength if larger, are treated as another surface. The offset may be large: more than
2.5 mm at a quarter of the patches of a guitar 1.1 m long, whose surface was made on a grid of 4 mm."""
CENTRE_FRACTION = 0.25
"""Side of the central square in which the median offset is computed, as a fraction of the patch's side."""
HALF_PASS_SIGMAS = np.pi * np.sqrt(2.0 / np.log(2.0))
"""Wavelength λ whose contrast is halved by a Gaussian, in its σ: exp(−2 π² σ² / λ²) = ½ at λ = 5.34 σ."""
FINEST_AREA_FRACTION = 0.1
"""Fraction of a patch's visible area whose splats must be as fine as its resolution."""
MAX_DEPTH_SIGMAS = 2.0
"""Maximum depth of a visible splat's center behind the surface, in its standard deviations along the view."""
PIXELS_PER_WAVELENGTH = 8
"""Pixels per shortest wavelength that splats show; the minimum splat width of one pixel then costs a tenth of it at
most."""


class SplatCloseUpRenderer:
    """Context manager that renders close-ups of patches (squares of surface) of one object from its splats.

    The splats are read for the first patch and released on exit. A patch is rendered with APPEARANCE_PIXELS first, and
    again if its splats resolve more.

    Parameters
    ----------
    obj : bpy.types.Object
        Surface object.
    cloud : bpy.types.Object
        Object with the splats of `obj`.
    patches : sequence of Patch
        All patches that will be rendered, in the surface frame.
    surface : Surface
        Surface of `obj`.
    pixels : int, default 512
        Maximum side of an image [pixels].
    """

    def __init__(
        self,
        obj: Any,
        cloud: Any,
        patches: Sequence[Patch],
        *,
        surface: Surface,
        pixels: int = 512,
    ) -> None:
        self._obj, self._cloud, self._patches = obj, cloud, patches
        self._surface, self._pixels = surface, pixels
        self._scene: _SplatScene | None = None

    def __enter__(self) -> SplatCloseUpRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self._scene = None

    def render(self, patch: Patch) -> CloseUp:
        """Render one of the patches.

        Raises SceneError if the splats cannot be read, are scaled unevenly or mirrored.
        """
        if self._scene is None:
            self._scene = self._read_scene()
        scene, min_side = self._scene, min(self._pixels, APPEARANCE_PIXELS)
        camera, clip_rays = make_unoccluded_camera(patch, min_side, scene.caster)
        cast = cast_view(scene.caster, scene.surface.mesh, camera)
        splat_patch = _SplatPatch(patch, camera.clip_start, cast, scene)
        closeup = _render_closeup(splat_patch, min_side)
        side = choose_splat_resolution(closeup.unlit, patch, min_side, self._pixels)
        if side > min_side:
            closeup = replace(_render_closeup(splat_patch, side), renders=2)
        return limit_resolution(replace(closeup, rays=clip_rays + cast.depth.size))

    def _read_scene(self) -> _SplatScene:
        frame = compute_cloud_frame(self._obj, self._cloud, self._surface.stretch)
        splats = read_cloud(self._cloud)
        surface = crop_to_patches(self._surface, self._patches)
        return _SplatScene(
            surface, make_ray_caster(surface.mesh), frame, splats, f"splats of {get_cloud_source(self._cloud)}"
        )


@dataclass(frozen=True)
class _SplatScene:
    """Splats, the file they are from and their frame, and the part of the surface mesh near the patches."""

    surface: Surface
    caster: ViewCaster
    frame: CloudFrame
    splats: Splats
    source: str


def choose_splat_resolution(unlit: UnlitImage | None, patch: Patch, min_pixels: int, max_pixels: int) -> int:
    """Return the image side [pixels], within the limits given, at which a patch shows all that its splats resolve.

    `unlit` is the image of a first render with `min_pixels`, None if that showed nothing.
    """
    if unlit is None:
        return min_pixels
    # If the pixels of the first pass limited its resolution, the splats may show more.
    if unlit.resolved_wavelength_m <= 2.0 * patch.size_m / min_pixels:
        return max_pixels
    needed = int(np.ceil(PIXELS_PER_WAVELENGTH * patch.size_m / unlit.resolved_wavelength_m))
    return min(max(needed, min_pixels), max_pixels)


@dataclass(frozen=True)
class _SplatPatch:
    """A patch with the rays cast on its mesh; `clip_start` is the camera's near clipping distance [m]."""

    patch: Patch
    clip_start: float
    cast: CastView
    scene: _SplatScene


def _render_closeup(splat_patch: _SplatPatch, pixels: int) -> CloseUp:
    patch, cast, scene = splat_patch.patch, splat_patch.cast, splat_patch.scene
    surface, metres_per_unit = scene.surface, scene.frame.metres_per_unit
    camera = replace(patch.camera(pixels), clip_start=splat_patch.clip_start)
    view = render_splats(scene.splats, scene.frame.to_cloud_camera(camera))
    pixel_m = patch.size_m / pixels
    # The median depth, as half of the light is gone at the surface; the mean of all that shines through lies behind it.
    depth = np.asarray(view.median, dtype=np.float32) * np.float32(metres_per_unit)
    slot = np.where(cast.triangle >= 0, surface.mesh.slot[cast.triangle], -1)
    ray_pixel_m = patch.size_m / cast.depth.shape[1]
    on_patch = _upsample(find_connected_pixels(slot == patch.slot, cast.depth, ray_pixel_m), camera)
    opaque = on_patch & (view.opacity >= MIN_SURFACE_OPACITY)
    resolved = compute_splat_resolution(scene.splats, view, opaque) * metres_per_unit
    max_distance = max(MAX_SURFACE_OFFSET_M, resolved) if np.isfinite(resolved) else MAX_SURFACE_OFFSET_M
    distance = compute_surface_distance(depth, _upsample(cast.depth, camera), opaque)
    visible = opaque & (distance <= max_distance)
    opacity = np.where(opaque & ~visible, np.float32(0.0), view.opacity)
    mask, linear, depth = fill_pinholes(
        visible, on_patch, compute_linear_colour(view), depth, opacity, resolved, pixel_m
    )
    notes = () if mask.any() else (_format_no_surface_note(surface.object_name),)
    colour = tuple(float(part) for part in linear[mask].mean(axis=0)) if mask.any() else None
    return CloseUp(
        patch=patch,
        view=RgbdView(camera, linear, depth, _upsample(cast.face_id, camera), None),
        height=None,
        height_source="",
        appearance=Appearance() if colour is None else Appearance(base_color=(colour[0], colour[1], colour[2])),
        mask=mask,
        resolved_wavelength_m=float("inf"),
        notes=notes,
        faces=np.unique(cast.face_id[_downsample_mask(mask, cast.face_id.shape) & (cast.face_id >= 0)]),
        rays=cast.depth.size,
        renders=1,
        unlit=_make_unlit_image(linear, depth, mask, resolved, pixel_m, scene.source),
    )


def compute_surface_distance(
    depth: NDArray[np.floating[Any]], reference: NDArray[np.floating[Any]], visible: Mask
) -> Float:
    """Return the absolute distance (H, W) [m] between the depth of splats and of the mesh, inf where unknown.

    `depth` and `reference` are their depths [m], `visible` masks the pixels to compare; all are (H, W). The median
    offset in the middle of the image is removed first, since splats may lie before or behind their mesh as a whole.
    """
    known = visible & np.isfinite(reference)
    offset = np.full(depth.shape, np.inf)
    offset[known] = depth[known].astype(np.float64) - reference[known]
    middle = np.zeros_like(known)
    rows, columns = (
        np.rint(np.array([1.0 - CENTRE_FRACTION, 1.0 + CENTRE_FRACTION]) * side / 2.0).astype(int)
        for side in depth.shape
    )
    middle[slice(*rows), slice(*columns)] = True
    middle &= known
    return np.asarray(np.abs(offset - (np.median(offset[middle]) if middle.any() else 0.0)))


def fill_pinholes(
    visible: Mask,
    patch_mask: Mask,
    linear: NDArray[np.float32],
    depth: NDArray[np.float32],
    opacity: NDArray[np.floating[Any]],
    resolved_m: float,
    pixel_m: float,
) -> tuple[Mask, NDArray[np.float32], NDArray[np.float32]]:
    """Return `visible`, `linear` and `depth` with the gaps between splats filled from the pixels around them.

    The network D_φ, which predicts a relief, needs views entirely inside the mask, and splats seldom cover every pixel.
    A gap inside `patch_mask` is filled if it is narrower than the image resolves: the mean opacity over a square of
    half the resolved wavelength is at least MIN_SURFACE_OPACITY. All arrays are (H, W), the linear color `linear` is
    (H, W, 3).
    """
    side = int(np.clip(resolved_m / 2.0 / pixel_m, 1, min(visible.shape))) if np.isfinite(resolved_m) else 1
    holes = patch_mask & ~visible & (_compute_box_mean(opacity, side) >= MIN_SURFACE_OPACITY)
    if not visible.any() or not holes.any():
        return visible, linear, depth
    linear, depth = linear.copy(), np.where(holes, fill_masked(depth, visible), depth).astype(np.float32)
    for channel in range(3):
        linear[..., channel][holes] = fill_masked(linear[..., channel], visible)[holes]
    return visible | holes, linear, depth


def _compute_box_mean(values: NDArray[np.floating[Any]], side: int) -> Float:
    """Return moving averages of `values` (H, W) over squares of `side` pixels, which are cropped at the borders."""
    half = side // 2
    total = np.pad(np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1), ((1, 0), (1, 0)))
    (top, bottom), (left, right) = (
        (np.maximum(pixel - half, 0), np.minimum(pixel + side - half, len(pixel)))
        for pixel in map(np.arange, values.shape)
    )
    sums = total[bottom][:, right] - total[top][:, right] - total[bottom][:, left] + total[top][:, left]
    return np.asarray(sums / np.outer(bottom - top, right - left))


def compute_splat_resolution(splats: Splats, splat_view: SplatView, mask: Mask) -> float:
    """Return the shortest wavelength that splats show of a patch, in the unit of their camera; inf without splats.

    The splats are ordered by their narrower standard deviation in the image. The finest ones that together make up
    FINEST_AREA_FRACTION of the visible area determine the wavelength, of which they pass half (HALF_PASS_SIGMAS). A
    splat's weight is opacity times area. Visible are those whose center is under `mask` (H, W) and at most
    MAX_DEPTH_SIGMAS behind the surface.
    """
    camera = splat_view.camera
    scale = float(camera.intrinsics[0, 0])
    uv, depth = camera.project(splats.means)
    height, width = mask.shape
    column, row = (np.floor(uv[:, axis]).astype(np.int64) for axis in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    selected = np.flatnonzero(inside)
    selected = selected[mask[row[selected], column[selected]]]
    if len(selected) == 0:
        return float("inf")
    long_sigma, short_sigma, depth_sigma = _project_extents(splats.take(selected), camera.pose[:3, :3])
    surface_depth = splat_view.depth[row[selected], column[selected]]
    visible = depth[selected] <= surface_depth + MAX_DEPTH_SIGMAS * depth_sigma
    weight = splats.opacities[selected] * np.minimum(long_sigma * short_sigma, mask.sum() / scale**2) * visible
    if weight.sum() <= 0.0:
        return float("inf")
    order = np.argsort(short_sigma, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    finest = short_sigma[order][np.searchsorted(share, FINEST_AREA_FRACTION)]
    return float(max(HALF_PASS_SIGMAS * finest, 2.0 / scale))


def _project_extents(splats: Splats, rotation: Float) -> tuple[Float, Float, Float]:
    """Return the standard deviations (N,) of splats in an orthographic view, along three axes.

    The axes are the long and the short axis of the ellipse in the image, and the viewing direction. `rotation` (3, 3)
    is camera → frame of the splats.
    """
    right, down, forward = (
        np.stack(row) for row in transform_to_principal_axes(splats, np.arange(len(splats)), rotation.T.tolist())
    )
    # The eigenvalues of the covariance in the image are its mean variance ± half_difference.
    xx, yy, xy = (right * right).sum(axis=0), (down * down).sum(axis=0), (right * down).sum(axis=0)
    mean, half_difference = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    depth_sigma = np.sqrt((forward * forward).sum(axis=0))
    return np.sqrt(mean + half_difference), np.sqrt(np.maximum(mean - half_difference, 0.0)), depth_sigma


def _make_unlit_image(
    linear: NDArray[np.float32],
    depth: NDArray[np.float32],
    mask: Mask,
    resolved: float,
    pixel_m: float,
    source: str,
) -> UnlitImage | None:
    if not mask.any() or not np.isfinite(resolved):
        return None
    rgb = np.rint(MAX_CODE * np.sqrt(linear)).astype(np.uint8)
    if float(rgb[mask].std(axis=0).max()) < MIN_COLOUR_STD_CODES:
        return None
    known_depth = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
    return UnlitImage(rgb, known_depth, max(resolved, 2.0 * pixel_m), source)


def limit_resolution(closeup: CloseUp) -> CloseUp:
    """Return a close-up whose unlit image claims no finer resolution than its pixels contain.

    Splats may be finer than the photographs they were trained on.
    """
    unlit = closeup.unlit
    if unlit is None:
        return closeup
    resolved = estimate_resolved_wavelength(
        closeup.view.rgb, closeup.mask, closeup.metres_per_pixel, unlit.resolved_wavelength_m
    )
    return replace(closeup, unlit=replace(unlit, resolved_wavelength_m=resolved))


def _upsample(values: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """Resample values (h, w) per ray to the (H, W) pixels of a camera, by the nearest ray."""
    rows = (np.arange(camera.height) * values.shape[0]) // camera.height
    columns = (np.arange(camera.width) * values.shape[1]) // camera.width
    return np.asarray(values[rows[:, None], columns])


def _downsample_mask(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """Resample a mask (H, W) of pixels to the coarser grid of rays (h, w): true if any pixel of a ray is."""
    rows = (np.arange(mask.shape[0]) * shape[0]) // mask.shape[0]
    columns = (np.arange(mask.shape[1]) * shape[1]) // mask.shape[1]
    small = np.zeros(shape, dtype=np.bool_)
    mask_row, mask_column = np.nonzero(mask)
    small[rows[mask_row], columns[mask_column]] = True
    return small


def _format_no_surface_note(name: str) -> str:
    return (
        f"object '{name}': its splats show no surface at some of what is touched; the material there is a guess. Do "
        "they still lie on the surface, and is it whole there?"
    )
