"""EWA projection of 3-D Gaussians to 2-D Gaussians in an image (Zwicker et al. 2001; Kerbl et al. 2023), in float64.

Every splat is computed element by element, so that its result does not depend on the number or order of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ..camera import Camera
from .gaussians import Splats

Float = NDArray[np.float64]
Int = NDArray[np.intp]

LOW_PASS_PX2 = 0.3
"""Variance added to the diagonal of every 2-D covariance (INRIA) [pixels²]: no splat is thinner than half a pixel."""
MIN_ALPHA = 1.0 / 255.0
"""Least α at which a splat contributes to a pixel (INRIA)."""
MAX_ALPHA = 0.99
"""Largest α of a splat at a pixel (INRIA)."""
MEDIAN_TRANSMITTANCE = 0.5
"""Transmittance behind the splat whose depth is the median depth."""
FOV_MARGIN = 0.3
"""Margin around the image within which Jacobians are taken, as a fraction of half the field of view (INRIA; gsplat's
rule for principal points off the centre)."""
SPLATS_PER_CHUNK = 1 << 16
"""Number of splats projected together."""
MIN_EIGENVALUE_SHARE = 1e-10
"""Least eigenvalue of a footprint's covariance, as a fraction of the trace, when its depth plane is solved for."""
MAX_DEPTH_REACH = 2.0
"""Largest deviation of a depth plane from a splat's centre, in standard deviations of the splat's depth."""
MAX_PRECISION = 1e30
"""Largest precision of a footprint that is rendered [1/pixels²]."""
BOX_MARGIN = 1e-9
"""Relative margin of bounding boxes against rounding."""


@dataclass(frozen=True)
class Footprints:
    """The 2-D Gaussians in an image of the M splats that overlap it. All arrays (M,), float64 unless stated.

    The Mahalanobis distance squared is q = dy² / var_y + precision · (x − u − shear · dy)², dy = y − v: the conic,
    completed to a square, which loses no digits for needle-like splats.

    Attributes
    ----------
    index : ndarray of int
        Index of the splat in the cloud.
    depth : ndarray
        Planar depth of the centre.
    u, v : ndarray
        Pixel coordinates of the centre.
    var_y : ndarray
        Σ_yy [pixels²].
    shear : ndarray
        Σ_xy / Σ_yy.
    precision : ndarray
        1 / Var(x | y) [1/pixels²].
    inverse_std : ndarray
        Upper bound of 1 over the least standard deviation [1/pixels].
    cutoff : ndarray
        q at which the opacity at a pixel, α = opacity · exp(−q/2), falls to `MIN_ALPHA`.
    opacity : ndarray
        Opacity of the splat.
    depth_slope_x, depth_slope_y : ndarray
        Growth of depth per pixel to the right and down.
    left, right, top, bottom : ndarray of int
        Pixels whose centres lie in the bounding box within the image; right and bottom exclusive.
    """

    index: Int
    depth: Float
    u: Float
    v: Float
    var_y: Float
    shear: Float
    precision: Float
    inverse_std: Float
    cutoff: Float
    opacity: Float
    depth_slope_x: Float
    depth_slope_y: Float
    left: Int
    right: Int
    top: Int
    bottom: Int

    def __len__(self) -> int:
        return len(self.index)

    def take(self, which: Int | NDArray[np.bool_]) -> Footprints:
        """Return the footprints selected by a mask or by indices."""
        return Footprints(*(getattr(self, field.name)[which] for field in fields(self)))


def evaluate_quadratic_form(prints: Footprints, which: Int, y: Int | Float) -> tuple[Float, Float, Float]:
    """Return the terms of the Mahalanobis distance squared q of splats `which` along pixel rows `y`, elementwise.

    They are the least q on the row, the x at which it is reached, and dy = y − v; then q = first + precision · (x + ½ −
    second)². All code that needs q calls this function, so that the reference and the fast rasterizer skip the same
    pixels.
    """
    dy = (y + 0.5) - prints.v[which]
    return dy * dy / prints.var_y[which], prints.u[which] + prints.shear[which] * dy, dy


def split_into_chunks(count: int) -> list[slice]:
    """Return slices that divide `count` splats into chunks of `SPLATS_PER_CHUNK`, at least one slice."""
    return [slice(start, min(start + SPLATS_PER_CHUNK, count)) for start in range(0, max(count, 1), SPLATS_PER_CHUNK)]


def concatenate_footprints(chunks: list[Footprints]) -> Footprints:
    """Concatenate the footprints of several chunks."""
    if len(chunks) == 1:
        return chunks[0]
    return Footprints(
        *(np.concatenate([getattr(chunk, field.name) for chunk in chunks]) for field in fields(Footprints))
    )


def sort_front_to_back(prints: Footprints) -> Int:
    """Return the indices that sort footprints by depth; equal depths keep the order of the cloud."""
    return np.argsort(prints.depth, kind="stable")


def project_chunk(splats: Splats, camera: Camera, low_pass: float, chunk: slice) -> Footprints:
    """Project the splats of one chunk, in the cloud's order.

    Splats that cannot reach the image are left out before their covariance is computed.

    Parameters
    ----------
    splats : Splats
        All splats.
    camera : Camera
        The camera, in the frame and unit of the splats.
    low_pass : float
        Variance added to every footprint [pixels²].
    chunk : slice
        Range of splats to project.

    Returns
    -------
    Footprints
        Footprints that overlap the image.

    Raises
    ------
    UsageError
        If `low_pass` is negative or not finite.
    """
    if not 0.0 <= low_pass < np.inf:
        raise UsageError(f"low_pass is {low_pass}.", remedy="It is a variance in pixels²: 0 or more.")
    with np.errstate(all="ignore"):  # the comparisons below drop what is not finite
        return _project_chunk(splats, camera, low_pass, chunk)


def _project_chunk(splats: Splats, camera: Camera, low_pass: float, chunk: slice) -> Footprints:
    rotation, focal = camera.pose[:3, :3], camera.intrinsics[:2, :2]
    offset = [splats.means[chunk, i].astype(np.float64) - camera.pose[i, 3] for i in range(3)]
    z = _dot(rotation[:, 2], offset)
    opacity = splats.opacities[chunk].astype(np.float64)
    cutoff = 2.0 * np.log(opacity / MIN_ALPHA)
    in_range = (z >= camera.clip_start) & (z <= camera.clip_end) & (cutoff >= 0.0)
    if camera.kind == "perspective":
        in_range &= z > 0.0
    candidates = np.flatnonzero(in_range)
    z, cutoff = z[candidates], cutoff[candidates]
    x, y = (_dot(rotation[:, i], [component[candidates] for component in offset]) for i in range(2))
    u, v, jacobian = _linearise_projection(camera, focal, x, y, z)
    widest = splats.scales[chunk].max(axis=1)[candidates].astype(np.float64) ** 2
    reach = [np.sqrt(cutoff * (widest * (row[0] ** 2 + row[1] ** 2 + row[2] ** 2) + low_pass)) for row in jacobian]
    overlapping = np.flatnonzero(_overlaps_image(camera, u, v, *reach))
    candidates, z, cutoff, u, v = (
        candidates[overlapping],
        z[overlapping],
        cutoff[overlapping],
        u[overlapping],
        v[overlapping],
    )
    jacobian = [[entry[overlapping] for entry in row] for row in jacobian]

    index = candidates + chunk.start
    depth_row = [np.full(len(index), axis) for axis in (0.0, 0.0, 1.0)]
    mx, my, mz = transform_to_principal_axes(
        splats, index, [[_dot(rotation[i], row) for i in range(3)] for row in (*jacobian, depth_row)]
    )
    sxx, sxy, syy = _dot(mx, mx), _dot(mx, my), _dot(my, my)
    area = _gram_determinant(mx, my)
    determinant = area + low_pass * (sxx + syy) + low_pass * low_pass
    slope_x, slope_y = _compute_depth_slopes(sxx, sxy, syy, area, (_dot(mx, mz), _dot(my, mz), _dot(mz, mz)), low_pass)
    var_x, var_y = sxx + low_pass, syy + low_pass
    precision, shear = var_y / determinant, sxy / var_y
    inverse_std = np.sqrt((var_x + var_y) / determinant)
    half_width, half_height = np.sqrt(cutoff * var_x), np.sqrt(cutoff * var_y)
    usable = (
        (determinant > 0.0)
        & (precision < MAX_PRECISION)
        & (var_y > 1.0 / MAX_PRECISION)
        & np.isfinite(half_width * half_height * shear)
    )
    usable = np.flatnonzero(usable & _overlaps_image(camera, u, v, half_width, half_height))
    edges = _compute_edges(camera, u[usable], v[usable], half_width[usable], half_height[usable])
    box = [edge.astype(np.intp) for edge in edges]
    values = (z, u, v, var_y, shear, precision, inverse_std, cutoff, opacity[candidates], slope_x, slope_y)
    numbers: list[Any] = [component[usable] for component in (index, *values)]
    return Footprints(*numbers, *box)


def _linearise_projection(
    camera: Camera, focal: Float, x: Float, y: Float, z: Float
) -> tuple[Float, Float, list[list[Float]]]:
    """Return pixel coordinates of points in the camera's frame, and the two rows of the projection's Jacobian there."""
    if camera.kind == "orthographic":
        flat_x, flat_y = x, y
        jacobian = [[np.full(len(z), row[0]), np.full(len(z), row[1]), np.zeros(len(z))] for row in focal]
    else:
        flat_x, flat_y = x / z, y / z
        (min_x, max_x), (min_y, max_y) = _jacobian_bounds(camera, focal)
        at_x, at_y = np.clip(flat_x, min_x, max_x), np.clip(flat_y, min_y, max_y)
        jacobian = [[row[0] / z, row[1] / z, -(row[0] * at_x + row[1] * at_y) / z] for row in focal]
    u, v = (row[0] * flat_x + row[1] * flat_y + camera.intrinsics[i, 2] for i, row in enumerate(focal))
    return u, v, jacobian


def _jacobian_bounds(camera: Camera, focal: Float) -> list[tuple[float, float]]:
    """Return the ranges of x / z and y / z to which points are clamped before Jacobians are taken, as in INRIA's code.

    A crop has the ranges of the uncropped image, so that it shows the same.
    """
    left, top, right, bottom = camera.frame
    corners = np.array([[left, top], [right, top], [left, bottom], [right, bottom]]) - camera.intrinsics[:2, 2]
    flat = corners @ np.linalg.inv(focal).T
    lower, upper = flat.min(axis=0), flat.max(axis=0)
    margin = FOV_MARGIN * 0.5 * (upper - lower)
    return [(float(lower[i] - margin[i]), float(upper[i] + margin[i])) for i in range(2)]


def transform_to_principal_axes(splats: Splats, index: Int, rows: Sequence[Sequence[Any]]) -> list[list[Float]]:
    """Return rows · R · diag(scales): row vectors, such as Jacobian rows, in the scaled principal axes of each splat.

    The dot product of two results is an entry of J Σ Jᵀ, the covariance of the projected splat.

    Parameters
    ----------
    splats : Splats
        All splats.
    index : ndarray of int, shape (N,)
        Splats to transform.
    rows : sequence of sequence
        Row vectors, 3 entries each, numbers or arrays (N,).

    Returns
    -------
    list of list of ndarray
        For each row its 3 components, (N,) each.
    """
    w, x, y, z = (splats.rotations[index, i].astype(np.float64) for i in range(4))
    norm = 2.0 / (w * w + x * x + y * y + z * z)
    rotation = [
        [1.0 - norm * (y * y + z * z), norm * (x * y - w * z), norm * (x * z + w * y)],
        [norm * (x * y + w * z), 1.0 - norm * (x * x + z * z), norm * (y * z - w * x)],
        [norm * (x * z - w * y), norm * (y * z + w * x), 1.0 - norm * (x * x + y * y)],
    ]
    scales = [splats.scales[index, k].astype(np.float64) for k in range(3)]
    return [[_dot(row, [rotation[i][k] for i in range(3)]) * scales[k] for k in range(3)] for row in rows]


def _compute_depth_slopes(
    sxx: Float, sxy: Float, syy: Float, area: Float, depth: tuple[Float, Float, Float], low_pass: float
) -> tuple[Float, Float]:
    """Return the depth slopes per pixel, right and down, (N,) each, of a splat: Σ_xy⁻¹ Σ_xy,z of its 3-D covariance.

    They describe the mean depth of the Gaussian along each ray; for a flat disc this is the disc's plane. `sxx`, `sxy`,
    `syy` are the 2-D covariance without the low-pass, which would bend the plane, `area` its determinant, and `depth`
    its covariances with depth. Slopes are limited for a splat seen nearly edge-on, whose plane would run far from its
    center.
    """
    sxz, syz, szz = depth
    floor = MIN_EIGENVALUE_SHARE * (sxx + syy)
    solvable = area + floor * (sxx + syy) + floor * floor
    slope_x = ((syy + floor) * sxz - sxy * syz) / solvable
    slope_y = ((sxx + floor) * syz - sxy * sxz) / solvable
    variance = (
        slope_x * slope_x * (sxx + low_pass) + 2.0 * slope_x * slope_y * sxy + slope_y * slope_y * (syy + low_pass)
    )
    limit = np.minimum(1.0, MAX_DEPTH_REACH * np.sqrt(szz / np.where(variance > 0.0, variance, 1.0)))
    slope_x, slope_y = limit * slope_x, limit * slope_y
    known = np.isfinite(slope_x) & np.isfinite(slope_y) & (variance > 0.0)
    return np.where(known, slope_x, 0.0), np.where(known, slope_y, 0.0)


def _gram_determinant(mx: list[Float], my: list[Float]) -> Float:
    """Return det(M Mᵀ) of the 2 × 3 matrix with rows mx, my as a sum of squares, which rounding cannot make negative.

    This is the Cauchy–Binet formula; a difference of products would suffer from cancellation.
    """
    pairs = ((0, 1), (0, 2), (1, 2))
    return np.asarray(sum((mx[i] * my[k] - mx[k] * my[i]) ** 2 for i, k in pairs))


def _overlaps_image(camera: Camera, u: Float, v: Float, wide: Float, high: Float) -> NDArray[np.bool_]:
    left, right, top, bottom = _compute_edges(camera, u, v, wide, high)
    return np.asarray((left < right) & (top < bottom))


def _compute_edges(camera: Camera, u: Float, v: Float, wide: Float, high: Float) -> tuple[Float, Float, Float, Float]:
    """Return left, right, top, bottom (N,) of the pixels within half sizes `wide`, `high` of (u, v), in the image."""
    wide, high = wide + BOX_MARGIN * (1.0 + wide + abs(u)), high + BOX_MARGIN * (1.0 + high + abs(v))
    return (
        np.maximum(np.ceil(u - wide - 0.5), 0.0),
        np.minimum(np.floor(u + wide - 0.5) + 1.0, camera.width),
        np.maximum(np.ceil(v - high - 0.5), 0.0),
        np.minimum(np.floor(v + high - 0.5) + 1.0, camera.height),
    )


def _dot(first: object, second: object) -> Float:
    """Return the dot product of two 3-vectors whose entries are numbers or arrays (N,), added in a fixed order."""
    a, b = first, second
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])  # type: ignore[index]
