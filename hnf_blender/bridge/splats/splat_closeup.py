"""Close-ups of a reconstructed surface: colour and depth of a patch from its splats, faces from rays on the surface.

This is the counterpart of `bridge/render/closeup.py` for surfaces with splats instead of a shader.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.library import Appearance
from hnf_core.scene.camera import Camera
from hnf_core.scene.patch import CAMERA_DISTANCE_M, Patch
from hnf_core.scene.raycast import CastView, RayCaster, cast_view
from hnf_core.scene.rgbd_view import RgbdView
from hnf_core.scene.splats.depth_views import compute_linear_colour
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.project import transform_to_principal_axes
from hnf_core.scene.splats.rasterize import SplatView, render_splats
from hnf_core.tactile.height import fill_masked
from hnf_core.tactile.image_resolution import estimate_resolved_wavelength

from ..render.closeup import APPEARANCE_PIXELS, CloseUp, crop_to_patches, find_connected_pixels, make_unoccluded_camera
from ..render.unlit_image import MAX_CODE, MIN_COLOUR_STD_CODES, UnlitImage
from ..scene.meshes import Surface, make_ray_caster
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
"""Wavelength, in standard deviations, of which a Gaussian passes half: exp(−2 π² σ² / λ²) = ½ at λ = 5.34 σ."""
FINEST_AREA_FRACTION = 0.1
"""Fraction of a patch's visible area whose splats must be as fine as its resolution."""
MAX_DEPTH_SIGMAS = 2.0
"""Maximum depth of a visible splat's centre behind the surface, in its standard deviations along the view."""
PIXELS_PER_WAVELENGTH = 8
"""Pixels per shortest wavelength that splats show; widening splats to a pixel then costs at most a tenth of it."""


def iter_splat_closeups(
    obj: Any,
    cloud: Any,
    patches: Sequence[Patch],
    *,
    surface: Surface,
    caster: RayCaster | None = None,
    pixels: int = 512,
) -> Generator[CloseUp, None, None]:
    """Yield a close-up of every patch, rendered from splats.

    A patch is rendered with APPEARANCE_PIXELS first, and again if its splats resolve more.

    Parameters
    ----------
    obj : bpy.types.Object
        Surface object.
    cloud : bpy.types.Object
        Object with the splats of `obj`.
    patches : sequence of Patch
        Patches in the surface frame.
    surface : Surface
        Surface of `obj`.
    caster : RayCaster, optional
        Ray caster of `surface`.
    pixels : int, default 512
        Maximum side of an image [pixels].

    Yields
    ------
    CloseUp

    Raises
    ------
    SceneError
        If the splats cannot be read, are scaled unevenly or mirrored.
    """
    if not patches:
        return
    frame = compute_cloud_frame(obj, cloud, surface.stretch)
    splats = read_cloud(cloud)
    surface = surface if caster is not None else crop_to_patches(surface, patches)
    caster = caster or make_ray_caster(surface.mesh)
    source = f"splats of {get_cloud_source(cloud)}"
    fewest = min(pixels, APPEARANCE_PIXELS)
    for patch in patches:
        camera, rays = make_unoccluded_camera(patch, fewest, caster)
        cast = cast_view(caster, surface.mesh, camera)
        near = _SplatPatch(patch, camera.clip_start, cast, surface, frame, splats, source)
        closeup = _render_closeup(near, fewest)
        side = choose_splat_resolution(closeup.unlit, patch, fewest, pixels)
        if side > fewest:
            closeup = replace(_render_closeup(near, side), renders=2)
        yield limit_resolution(replace(closeup, rays=rays + cast.depth.size))


def choose_splat_resolution(unlit: UnlitImage | None, patch: Patch, min_pixels: int, max_pixels: int) -> int:
    """Return the image side [pixels] at which a patch shows all that its splats resolve."""
    if unlit is None:
        return min_pixels
    wanted = int(np.ceil(PIXELS_PER_WAVELENGTH * patch.size_m / unlit.resolved_wavelength_m))
    # With the least wave that fewest pixels show, the splats may show more than was seen.
    return (
        max_pixels
        if unlit.resolved_wavelength_m <= 2.0 * patch.size_m / min_pixels
        else min(max(wanted, min_pixels), max_pixels)
    )


@dataclass(frozen=True)
class _SplatPatch:
    """Inputs for rendering one patch; `clip_start` is the camera's near clipping distance [m]."""

    patch: Patch
    clip_start: float
    cast: CastView
    surface: Surface
    frame: CloudFrame
    splats: Splats
    source: str


def _render_closeup(splat_patch: _SplatPatch, pixels: int) -> CloseUp:
    patch, cast, surface = splat_patch.patch, splat_patch.cast, splat_patch.surface
    camera = replace(patch.camera(pixels), clip_start=splat_patch.clip_start)
    seen = render_splats(splat_patch.splats, splat_patch.frame.to_cloud_camera(camera))
    pixel_m = patch.size_m / pixels
    # Half of the light is gone at the surface; the mean of all that shines through lies behind it.
    depth = np.asarray(seen.median, dtype=np.float32) * np.float32(splat_patch.frame.metres_per_unit)
    slot = np.where(cast.triangle >= 0, surface.mesh.slot[cast.triangle], -1)
    own = _upsample(find_connected_pixels(slot == patch.slot, cast.depth, patch.size_m / cast.depth.shape[1]), camera)
    opaque = own & (seen.opacity >= MIN_SURFACE_OPACITY)
    resolved = compute_splat_resolution(splat_patch.splats, seen, opaque) * splat_patch.frame.metres_per_unit
    reach = max(MAX_SURFACE_OFFSET_M, resolved) if np.isfinite(resolved) else MAX_SURFACE_OFFSET_M
    shown = opaque & (compute_surface_distance(depth, _upsample(cast.depth, camera), opaque) <= reach)
    opacity = np.where(opaque & ~shown, np.float32(0.0), seen.opacity)
    mask, linear, depth = fill_pinholes(shown, own, compute_linear_colour(seen), depth, opacity, resolved, pixel_m)
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
        unlit=_make_unlit_image(linear, depth, mask, resolved, pixel_m, splat_patch.source),
    )


def compute_surface_distance(
    depth: NDArray[np.floating[Any]], reference: NDArray[np.floating[Any]], visible: Mask
) -> Float:
    """Return the distance (H, W) [m] of splat depths from reference depths, inf where unknown.

    The median offset in the middle of the image is removed first. All arrays are (H, W).
    """
    known = visible & np.isfinite(reference)
    away = np.full(depth.shape, np.inf)
    away[known] = depth[known].astype(np.float64) - reference[known]
    middle = np.zeros_like(known)
    rows, columns = (
        np.rint(np.array([1.0 - CENTRE_FRACTION, 1.0 + CENTRE_FRACTION]) * side / 2.0).astype(int)
        for side in depth.shape
    )
    middle[slice(*rows), slice(*columns)] = True
    middle &= known
    return np.asarray(np.abs(away - (np.median(away[middle]) if middle.any() else 0.0)))


def fill_pinholes(
    visible: Mask,
    patch_mask: Mask,
    linear: NDArray[np.float32],
    depth: NDArray[np.float32],
    opacity: NDArray[np.floating[Any]],
    resolved_m: float,
    pixel_m: float,
) -> tuple[Mask, NDArray[np.float32], NDArray[np.float32]]:
    """Return `visible`, `linear` and `depth` with the gaps between splats filled from around them.

    Views for D_φ must lie entirely inside the mask, and splats seldom cover every pixel. A gap inside `patch_mask` is
    filled if it is narrower than the image resolves: the mean opacity over a square of half the resolved wavelength is
    at least MIN_SURFACE_OPACITY. All arrays are (H, W), `linear` is (H, W, 3).
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
    """Return means (H, W) over squares of about `side` pixels, cropped at the borders."""
    before = side // 2
    total = np.pad(np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1), ((1, 0), (1, 0)))
    (top, bottom), (left, right) = (
        (np.maximum(at - before, 0), np.minimum(at + side - before, len(at))) for at in map(np.arange, values.shape)
    )
    sums = total[bottom][:, right] - total[top][:, right] - total[bottom][:, left] + total[top][:, left]
    return np.asarray(sums / np.outer(bottom - top, right - left))


def compute_splat_resolution(splats: Splats, splat_view: SplatView, mask: Mask) -> float:
    """Return the shortest wavelength that splats show of a patch, in the unit of their camera; inf without splats.

    It is the wavelength that passes the finest splats, which together make up FINEST_AREA_FRACTION of the visible area.
    A splat's fineness is its narrower side in the image, its weight is opacity times area. Visible are those whose
    centre is under `mask` and at most MAX_DEPTH_SIGMAS behind the surface.
    """
    camera = splat_view.camera
    scale = float(camera.intrinsics[0, 0])
    uv, depth = camera.project(splats.means)
    height, width = mask.shape
    column, row = (np.floor(uv[:, axis]).astype(np.int64) for axis in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    here = np.flatnonzero(inside)
    here = here[mask[row[here], column[here]]]
    if len(here) == 0:
        return float("inf")
    wide, narrow, deep = _project_extents(splats.take(here), camera.pose[:3, :3])
    front = depth[here] <= splat_view.depth[row[here], column[here]] + MAX_DEPTH_SIGMAS * deep
    weight = splats.opacities[here] * np.minimum(wide * narrow, mask.sum() / scale**2) * front
    if weight.sum() <= 0.0:
        return float("inf")
    order = np.argsort(narrow, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    finest = narrow[order][np.searchsorted(share, FINEST_AREA_FRACTION)]
    return float(max(HALF_PASS_SIGMAS * finest, 2.0 / scale))


def _project_extents(splats: Splats, turn: Float) -> tuple[Float, Float, Float]:
    """Return splats' standard deviations (N,) in an orthographic view with rotation `turn` (camera → frame).

    They are along the long and the short axis of the projected ellipse, and along the view.
    """
    right, down, forward = (
        np.stack(row) for row in transform_to_principal_axes(splats, np.arange(len(splats)), turn.T.tolist())
    )
    along, across, both = (right * right).sum(axis=0), (down * down).sum(axis=0), (right * down).sum(axis=0)
    mean, apart = (along + across) / 2.0, np.hypot((along - across) / 2.0, both)
    deep = np.sqrt((forward * forward).sum(axis=0))
    return np.sqrt(mean + apart), np.sqrt(np.maximum(mean - apart, 0.0)), deep


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
    known = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
    return UnlitImage(rgb, known, max(resolved, 2.0 * pixel_m), source)


def limit_resolution(closeup: CloseUp) -> CloseUp:
    """Return a close-up whose unlit image claims no finer resolution than its pixels contain.

    Splats may be finer than the photographs they were trained on.
    """
    look = closeup.unlit
    if look is None:
        return closeup
    held = estimate_resolved_wavelength(
        closeup.view.rgb, closeup.mask, closeup.metres_per_pixel, look.resolved_wavelength_m
    )
    return replace(closeup, unlit=replace(look, resolved_wavelength_m=held))


def _upsample(values: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """Resample (h, w) values of rays to the (H, W) pixels of a camera, by the nearest ray."""
    rows = (np.arange(camera.height) * values.shape[0]) // camera.height
    columns = (np.arange(camera.width) * values.shape[1]) // camera.width
    return np.asarray(values[rows[:, None], columns])


def _downsample_mask(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """Resample a mask (H, W) to the (h, w) rays: true if any pixel of a ray is."""
    rows = (np.arange(mask.shape[0]) * shape[0]) // mask.shape[0]
    columns = (np.arange(mask.shape[1]) * shape[1]) // mask.shape[1]
    small = np.zeros(shape, dtype=np.bool_)
    at = np.nonzero(mask)
    small[rows[at[0]], columns[at[1]]] = True
    return small


def _format_no_surface_note(name: str) -> str:
    return (
        f"object '{name}': its splats show no surface at some of what is touched; the material there is a guess. Do "
        "they still lie on the surface, and is it whole there?"
    )
