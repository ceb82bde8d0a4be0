"""Close-ups of a reconstructed surface: a patch as its splats show it, beside closeup.py's of what has a shader."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.material import Appearance
from hnf_core.scene.camera import Camera
from hnf_core.scene.patch import CAMERA_DISTANCE_M, Patch
from hnf_core.scene.raycast import CastView, RayCaster, cast_view
from hnf_core.scene.splats.cloud import Splats
from hnf_core.scene.splats.project import on_own_axes
from hnf_core.scene.splats.sights import linear_colour
from hnf_core.scene.splats.splatter import render_splats
from hnf_core.scene.splats.view import SplatView
from hnf_core.scene.view import RgbdView
from hnf_core.tactile.height import fill_masked
from hnf_core.tactile.held_wave import held_wave

from .closeup import APPEARANCE_PIXELS, CloseUp, unoccluded, within_reach
from .look import CODES, UNIFORM_CODES, Look
from .meshes import Surface, ray_caster
from .own_surface import connected
from .splat_cloud import read_cloud, source_of
from .splat_frame import CloudFrame, cloud_frame

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

OPAQUE = 0.5
"""Opacity from which a pixel shows the surface, and not a haze in front of nothing."""
AWAY_M = CAMERA_DISTANCE_M / 2.0
"""What splats show so far from the touched surface, or farther than the finest wave that they show, is not that
surface, once the one is laid on the other. All of it together may stand off its splats: at every fourth place of a
guitar 1.1 m long, whose surface was made on a grid of 4 mm, it does so by more than 2.5 mm."""
MIDDLE = 0.25
"""Part of a patch's side in whose square the one is laid on the other."""
HALF_PASS = np.pi * np.sqrt(2.0 / np.log(2.0))
"""Wavelength in standard deviations of which a Gaussian leaves a half: exp(−2 π² σ² / λ²) = ½ at λ = 5.34 σ."""
FINEST_SHARE = 0.1
"""Share of what is seen of a patch, by area, whose splats are as fine as what the patch is said to resolve."""
DEEP = 2.0
"""A splat counts as seen where its centre lies no more than so many of its own standard deviations, along the view,
behind the surface that is seen there."""
PIXELS_A_WAVE = 8
"""Of the finest detail that splats show: what widens them to a pixel then takes a tenth of it at most."""


def iter_splat_closeups(
    obj: Any,
    cloud: Any,
    patches: Sequence[Patch],
    *,
    surface: Surface,
    caster: RayCaster | None = None,
    pixels: int = 512,
) -> Generator[CloseUp, None, None]:
    """A close-up a patch: colour and depth from the splats, faces from rays on the surface.

    cloud: object with the splats of obj. patches: in the surface frame. pixels: side at most. A patch is looked at with
    APPEARANCE_PIXELS first, and again where its splats show more than that. Raises SceneError where the splats cannot
    be read, are scaled unevenly or mirrored.
    """
    if not patches:
        return
    frame = cloud_frame(obj, cloud, surface.stretch)
    splats = read_cloud(cloud)
    surface = surface if caster is not None else within_reach(surface, patches)
    caster = caster or ray_caster(surface.mesh)
    source = f"splats of {source_of(cloud)}"
    fewest = min(pixels, APPEARANCE_PIXELS)
    for patch in patches:
        camera, rays = unoccluded(patch, fewest, caster)
        cast = cast_view(caster, surface.mesh, camera)
        near = _Near(patch, camera.clip_start, cast, surface, frame, splats, source)
        closeup = _closeup(near, fewest)
        side = pixels_for(closeup.look, patch, fewest, pixels)
        if side > fewest:
            closeup = replace(_closeup(near, side), renders=2)
        yield as_held(replace(closeup, rays=rays + cast.depth.size))


def pixels_for(look: Look | None, patch: Patch, fewest: int, most: int) -> int:
    """Side of a picture that shows as much as the splats of a patch do. look: resolving what their size allows."""
    if look is None:
        return fewest
    wanted = int(np.ceil(PIXELS_A_WAVE * patch.size_m / look.resolved_wavelength_m))
    # With the least wave that fewest pixels show, the splats may show more than was seen.
    return most if look.resolved_wavelength_m <= 2.0 * patch.size_m / fewest else min(max(wanted, fewest), most)


@dataclass(frozen=True)
class _Near:
    """What there is to look at of one patch. clip_start: metres below the camera where it begins."""

    patch: Patch
    clip_start: float
    cast: CastView
    surface: Surface
    frame: CloudFrame
    splats: Splats
    source: str


def _closeup(near: _Near, pixels: int) -> CloseUp:
    patch, cast, surface = near.patch, near.cast, near.surface
    camera = replace(patch.camera(pixels), clip_start=near.clip_start)
    seen = render_splats(near.splats, near.frame.camera(camera))
    pixel_m = patch.size_m / pixels
    # Half of the light is gone at the surface; the mean of all that shines through lies behind it.
    depth = np.asarray(seen.median, dtype=np.float32) * np.float32(near.frame.metres)
    slot = np.where(cast.triangle >= 0, surface.mesh.slot[cast.triangle], -1)
    own = _enlarged(connected(slot == patch.slot, cast.depth, patch.size_m / cast.depth.shape[1]), camera)
    opaque = own & (seen.opacity >= OPAQUE)
    resolved = resolved_by_splats(near.splats, seen, opaque) * near.frame.metres
    reach = max(AWAY_M, resolved) if np.isfinite(resolved) else AWAY_M
    shown = opaque & (away_from(depth, _enlarged(cast.depth, camera), opaque) <= reach)
    opacity = np.where(opaque & ~shown, np.float32(0.0), seen.opacity)
    mask, linear, depth = without_pinholes(shown, own, linear_colour(seen), depth, opacity, resolved, pixel_m)
    notes = () if mask.any() else (_nothing_seen(surface.object_name),)
    colour = tuple(float(part) for part in linear[mask].mean(axis=0)) if mask.any() else None
    return CloseUp(
        patch=patch,
        view=RgbdView(camera, linear, depth, _enlarged(cast.face_id, camera), None),
        height=None,
        height_source="",
        appearance=Appearance() if colour is None else Appearance(base_color=(colour[0], colour[1], colour[2])),
        mask=mask,
        resolved_wavelength_m=float("inf"),
        notes=notes,
        faces=np.unique(cast.face_id[_reduced(mask, cast.face_id.shape) & (cast.face_id >= 0)]),
        rays=cast.depth.size,
        renders=1,
        look=_look(linear, depth, mask, resolved, pixel_m, near.source),
    )


def away_from(depth: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]], shown: Mask) -> Float:
    """(H, W) how far depth lies from true where shown, once both are laid on each other in the middle; inf elsewhere.
    All (H, W), of the same pixels."""
    known = shown & np.isfinite(true)
    away = np.full(depth.shape, np.inf)
    away[known] = depth[known].astype(np.float64) - true[known]
    middle = np.zeros_like(known)
    rows, columns = (np.rint(np.array([1.0 - MIDDLE, 1.0 + MIDDLE]) * side / 2.0).astype(int) for side in depth.shape)
    middle[slice(*rows), slice(*columns)] = True
    middle &= known
    return np.asarray(np.abs(away - (np.median(away[middle]) if middle.any() else 0.0)))


def without_pinholes(
    shown: Mask,
    own: Mask,
    linear: NDArray[np.float32],
    depth: NDArray[np.float32],
    opacity: NDArray[np.floating[Any]],
    resolved_m: float,
    pixel_m: float,
) -> tuple[Mask, NDArray[np.float32], NDArray[np.float32]]:
    """shown, linear and depth with what lies between splats filled from around: a view that D_φ is shown must lie
    inside the mask altogether, and few splats close up to the last pixel.

    A pinhole in own is narrower than what the picture resolves: over a square of half that wave, it is OPAQUE on
    average. All (H, W), linear (H, W, 3).
    """
    side = int(np.clip(resolved_m / 2.0 / pixel_m, 1, min(shown.shape))) if np.isfinite(resolved_m) else 1
    holes = own & ~shown & (_box_mean(opacity, side) >= OPAQUE)
    if not shown.any() or not holes.any():
        return shown, linear, depth
    linear, depth = linear.copy(), np.where(holes, fill_masked(depth, shown), depth).astype(np.float32)
    for channel in range(3):
        linear[..., channel][holes] = fill_masked(linear[..., channel], shown)[holes]
    return shown | holes, linear, depth


def _box_mean(values: NDArray[np.floating[Any]], side: int) -> Float:
    """(H, W) means over a square of about side pixels around each, cut off at the borders."""
    before = side // 2
    total = np.pad(np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1), ((1, 0), (1, 0)))
    (top, bottom), (left, right) = (
        (np.maximum(at - before, 0), np.minimum(at + side - before, len(at))) for at in map(np.arange, values.shape)
    )
    sums = total[bottom][:, right] - total[top][:, right] - total[bottom][:, left] + total[top][:, left]
    return np.asarray(sums / np.outer(bottom - top, right - left))


def resolved_by_splats(splats: Splats, seen: SplatView, mask: Mask) -> float:
    """Shortest wave that the picture of a patch shows, in the unit of its camera: what the finest splats pass that
    together make up FINEST_SHARE of what is seen under mask. inf where no splat is seen there.

    A splat is as fine as its narrower side in the picture, and weighs its opacity times its area there. Seen: its
    centre lies under mask, not behind what is seen there (DEEP).
    """
    camera = seen.camera
    scale = float(camera.intrinsics[0, 0])
    uv, depth = camera.project(splats.means)
    height, width = mask.shape
    column, row = (np.floor(uv[:, axis]).astype(np.int64) for axis in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    here = np.flatnonzero(inside)
    here = here[mask[row[here], column[here]]]
    if len(here) == 0:
        return float("inf")
    wide, narrow, deep = _extents(splats.take(here), camera.pose[:3, :3])
    front = depth[here] <= seen.depth[row[here], column[here]] + DEEP * deep
    weight = splats.opacities[here] * np.minimum(wide * narrow, mask.sum() / scale**2) * front
    if weight.sum() <= 0.0:
        return float("inf")
    order = np.argsort(narrow, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    finest = narrow[order][np.searchsorted(share, FINEST_SHARE)]
    return float(max(HALF_PASS * finest, 2.0 / scale))


def _extents(splats: Splats, turn: Float) -> tuple[Float, Float, Float]:
    """Standard deviations (N,) of splats in an orthographic view turned so (camera → frame): along the long and the
    short side of the ellipse in the picture, and along the view."""
    right, down, forward = (np.stack(row) for row in on_own_axes(splats, np.arange(len(splats)), turn.T.tolist()))
    along, across, both = (right * right).sum(axis=0), (down * down).sum(axis=0), (right * down).sum(axis=0)
    mean, apart = (along + across) / 2.0, np.hypot((along - across) / 2.0, both)
    deep = np.sqrt((forward * forward).sum(axis=0))
    return np.sqrt(mean + apart), np.sqrt(np.maximum(mean - apart, 0.0)), deep


def _look(
    linear: NDArray[np.float32],
    depth: NDArray[np.float32],
    mask: Mask,
    resolved: float,
    pixel_m: float,
    source: str,
) -> Look | None:
    if not mask.any() or not np.isfinite(resolved):
        return None
    rgb = np.rint(CODES * np.sqrt(linear)).astype(np.uint8)
    if float(rgb[mask].std(axis=0).max()) < UNIFORM_CODES:
        return None
    known = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
    return Look(rgb, known, max(resolved, 2.0 * pixel_m), source)


def as_held(closeup: CloseUp) -> CloseUp:
    """closeup, whose look resolves no more than its picture holds: splats may be finer than the pictures that they were
    made from."""
    look = closeup.look
    if look is None:
        return closeup
    held = held_wave(closeup.view.rgb, closeup.mask, closeup.metres_per_pixel, look.resolved_wavelength_m)
    return replace(closeup, look=replace(look, resolved_wavelength_m=held))


def _enlarged(values: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """(h, w) of the rays → (H, W) of the picture, each pixel the ray that it is nearest to."""
    rows = (np.arange(camera.height) * values.shape[0]) // camera.height
    columns = (np.arange(camera.width) * values.shape[1]) // camera.width
    return np.asarray(values[rows[:, None], columns])


def _reduced(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """(H, W) of the picture → (h, w) of the rays: where any pixel of a ray's square is in the mask."""
    rows = (np.arange(mask.shape[0]) * shape[0]) // mask.shape[0]
    columns = (np.arange(mask.shape[1]) * shape[1]) // mask.shape[1]
    small = np.zeros(shape, dtype=np.bool_)
    at = np.nonzero(mask)
    small[rows[at[0]], columns[at[1]]] = True
    return small


def _nothing_seen(name: str) -> str:
    return (
        f"object '{name}': its splats show no surface at some of what is touched; the material there is a guess. Do "
        "they still lie on the surface, and is it whole there?"
    )
