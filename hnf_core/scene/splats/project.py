"""Splats as Gaussians in a picture: EWA projection (Zwicker et al. 2001) as 3D Gaussian Splatting does it, in float64.

Everything here is done number by number, so that what a splat becomes depends neither on which others are there nor on
how many.
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
"""On the diagonal of every 2-D covariance (INRIA): no splat is thinner than half a pixel."""
MIN_ALPHA = 1.0 / 255.0
"""A splat that covers less of a pixel than this is skipped there (INRIA)."""
MAX_ALPHA = 0.99
MEDIAN_TRANSMITTANCE = 0.5
"""Left behind the splat whose depth is the median."""
FOV_MARGIN = 0.3
"""Jacobians are taken no farther out than this part of the half field of view beyond the picture (INRIA; with gsplat's
rule for principal points off the centre)."""
SPLATS_PER_CHUNK = 1 << 16
MIN_EIGENVALUE_SHARE = 1e-10
"""Of the trace: least eigenvalue taken for a footprint where its depth plane is solved for."""
MAX_DEPTH_REACH = 2.0
"""A depth plane leaves a splat's centre by no more than this many of the splat's own reach in depth."""
MAX_PRECISION = 1e30
BOX_MARGIN = 1e-9


@dataclass(frozen=True)
class Footprints:
    """M splats that meet a picture as Gaussians in it. All (M,) float64 but as said.

    index: intp, in the cloud. depth: planar, of the centre. u, v: its pixel coordinates. var_y: Σ_yy, pixels². shear:
    Σ_xy / Σ_yy. sharp: 1 / Var(x | y). narrow: no less than 1 over its least standard deviation. limit: the Mahalanobis
    distance squared at which α falls to CUTOFF. opacity.
    rise_x, rise_y: depth per pixel. left, right, top, bottom: intp, the pixels whose centres lie in its bounding box
    within the picture, right and bottom exclusive.

    The quadratic form is q = dy² / var_y + sharp (x − u − shear dy)², dy = y − v: the conic, completed to a square,
    which loses nothing where a splat is a needle.
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
        return Footprints(*(getattr(self, each.name)[which] for each in fields(self)))


def evaluate_quadratic_form(prints: Footprints, which: Int, y: Int | Float) -> tuple[Float, Float, Float]:
    """(steep, across, along) of splats on rows of pixels: q = steep + sharp (x + ½ − across)², along = dy. The only
    place where q is made, so that the reference and the fast way leave out the same pixels."""
    along = (y + 0.5) - prints.v[which]
    return along * along / prints.var_y[which], prints.u[which] + prints.shear[which] * along, along


def split_into_chunks(count: int) -> list[slice]:
    """At least one."""
    return [slice(start, min(start + SPLATS_PER_CHUNK, count)) for start in range(0, max(count, 1), SPLATS_PER_CHUNK)]


def concatenate_footprints(chunks: list[Footprints]) -> Footprints:
    if len(chunks) == 1:
        return chunks[0]
    return Footprints(*(np.concatenate([getattr(part, each.name) for part in chunks]) for each in fields(Footprints)))


def sort_front_to_back(prints: Footprints) -> Int:
    """Their order; of equal depths the first in the cloud is in front."""
    return np.argsort(prints.depth, kind="stable")


def project_chunk(splats: Splats, camera: Camera, low_pass: float, chunk: slice) -> Footprints:
    """Of some splats, in the cloud's order. What cannot reach the picture is left out before it has a covariance."""
    if not 0.0 <= low_pass < np.inf:
        raise UsageError(f"low_pass is {low_pass}.", remedy="It is a variance in pixels²: 0 or more.")
    with np.errstate(all="ignore"):  # what is not finite falls to the comparisons
        return _project_chunk(splats, camera, low_pass, chunk)


def _project_chunk(splats: Splats, camera: Camera, low_pass: float, chunk: slice) -> Footprints:
    turn, focal = camera.pose[:3, :3], camera.intrinsics[:2, :2]
    offset = [splats.means[chunk, i].astype(np.float64) - camera.pose[i, 3] for i in range(3)]
    z = _dot(turn[:, 2], offset)
    opacity = splats.opacities[chunk].astype(np.float64)
    limit = 2.0 * np.log(opacity / MIN_ALPHA)
    seen = (z >= camera.clip_start) & (z <= camera.clip_end) & (limit >= 0.0)
    if camera.kind == "perspective":
        seen &= z > 0.0
    at = np.flatnonzero(seen)
    z, limit = z[at], limit[at]
    x, y = (_dot(turn[:, i], [each[at] for each in offset]) for i in range(2))
    u, v, jacobian = _linearise_projection(camera, focal, x, y, z)
    widest = splats.scales[chunk].max(axis=1)[at].astype(np.float64) ** 2
    reach = [np.sqrt(limit * (widest * (row[0] ** 2 + row[1] ** 2 + row[2] ** 2) + low_pass)) for row in jacobian]
    met = np.flatnonzero(_overlaps_image(camera, u, v, *reach))
    at, z, limit, u, v = at[met], z[met], limit[met], u[met], v[met]
    jacobian = [[entry[met] for entry in row] for row in jacobian]

    index = at + chunk.start
    deep = [np.full(len(index), axis) for axis in (0.0, 0.0, 1.0)]
    mx, my, mz = transform_to_principal_axes(
        splats, index, [[_dot(turn[i], row) for i in range(3)] for row in (*jacobian, deep)]
    )
    sxx, sxy, syy = _dot(mx, mx), _dot(mx, my), _dot(my, my)
    area = _gram_determinant(mx, my)
    determinant = area + low_pass * (sxx + syy) + low_pass * low_pass
    rise_x, rise_y = _compute_depth_slopes(sxx, sxy, syy, area, (_dot(mx, mz), _dot(my, mz), _dot(mz, mz)), low_pass)
    var_x, var_y = sxx + low_pass, syy + low_pass
    sharp, shear = var_y / determinant, sxy / var_y
    narrow = np.sqrt((var_x + var_y) / determinant)
    wide, high = np.sqrt(limit * var_x), np.sqrt(limit * var_y)
    kept = (
        (determinant > 0.0) & (sharp < MAX_PRECISION) & (var_y > 1.0 / MAX_PRECISION) & np.isfinite(wide * high * shear)
    )
    kept = np.flatnonzero(kept & _overlaps_image(camera, u, v, wide, high))
    box = _compute_box(camera, u[kept], v[kept], wide[kept], high[kept])
    found = (z, u, v, var_y, shear, sharp, narrow, limit, opacity[at], rise_x, rise_y)
    numbers: list[Any] = [each[kept] for each in (index, *found)]
    return Footprints(*numbers, *box)


def _linearise_projection(
    camera: Camera, focal: Float, x: Float, y: Float, z: Float
) -> tuple[Float, Float, list[list[Float]]]:
    """Pixel coordinates of points in the camera's frame, and the two rows of the projection's Jacobian there."""
    if camera.kind == "orthographic":
        flat_x, flat_y = x, y
        jacobian = [[np.full(len(z), row[0]), np.full(len(z), row[1]), np.zeros(len(z))] for row in focal]
    else:
        flat_x, flat_y = x / z, y / z
        (least_x, most_x), (least_y, most_y) = _jacobian_bounds(camera, focal)
        at_x, at_y = np.clip(flat_x, least_x, most_x), np.clip(flat_y, least_y, most_y)
        jacobian = [[row[0] / z, row[1] / z, -(row[0] * at_x + row[1] * at_y) / z] for row in focal]
    u, v = (row[0] * flat_x + row[1] * flat_y + camera.intrinsics[i, 2] for i, row in enumerate(focal))
    return u, v, jacobian


def _jacobian_bounds(camera: Camera, focal: Float) -> list[tuple[float, float]]:
    """Least and greatest x / z and y / z at which a Jacobian is taken: of the whole picture, so that a crop sees what
    the picture sees."""
    left, top, right, bottom = camera.frame
    corners = np.array([[left, top], [right, top], [left, bottom], [right, bottom]]) - camera.intrinsics[:2, 2]
    flat = corners @ np.linalg.inv(focal).T
    least, most = flat.min(axis=0), flat.max(axis=0)
    margin = FOV_MARGIN * 0.5 * (most - least)
    return [(float(least[i] - margin[i]), float(most[i] + margin[i])) for i in range(2)]


def transform_to_principal_axes(splats: Splats, index: Int, rows: Sequence[Sequence[Any]]) -> list[list[Float]]:
    """rows · R · diag(scales): linear forms of the frame (3 entries each, numbers or (N,)) on the own axes of those
    splats, 3 × (N,) each. Products of two of them are covariances."""
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
    """Depth per pixel of the mean along a ray, Σ_xy⁻¹ Σ_xy,z: for a disc its own plane. Without the low pass, which
    would bend it; held where the splat is seen so nearly from its edge that the pixels around it would leave it."""
    sxz, syz, szz = depth
    least = MIN_EIGENVALUE_SHARE * (sxx + syy)
    solvable = area + least * (sxx + syy) + least * least
    rise_x = ((syy + least) * sxz - sxy * syz) / solvable
    rise_y = ((sxx + least) * syz - sxy * sxz) / solvable
    var = rise_x * rise_x * (sxx + low_pass) + 2.0 * rise_x * rise_y * sxy + rise_y * rise_y * (syy + low_pass)
    held = np.minimum(1.0, MAX_DEPTH_REACH * np.sqrt(szz / np.where(var > 0.0, var, 1.0)))
    rise_x, rise_y = held * rise_x, held * rise_y
    known = np.isfinite(rise_x) & np.isfinite(rise_y) & (var > 0.0)
    return np.where(known, rise_x, 0.0), np.where(known, rise_y, 0.0)


def _gram_determinant(mx: list[Float], my: list[Float]) -> Float:
    """det(M Mᵀ) of two rows, as a sum of squares (Cauchy and Binet), which no cancellation makes negative."""
    pairs = ((0, 1), (0, 2), (1, 2))
    return np.asarray(sum((mx[i] * my[k] - mx[k] * my[i]) ** 2 for i, k in pairs))


def _overlaps_image(camera: Camera, u: Float, v: Float, wide: Float, high: Float) -> NDArray[np.bool_]:
    left, right, top, bottom = _compute_edges(camera, u, v, wide, high)
    return np.asarray((left < right) & (top < bottom))


def _compute_box(camera: Camera, u: Float, v: Float, wide: Float, high: Float) -> list[Int]:
    return [edge.astype(np.intp) for edge in _compute_edges(camera, u, v, wide, high)]


def _compute_edges(camera: Camera, u: Float, v: Float, wide: Float, high: Float) -> tuple[Float, Float, Float, Float]:
    """Pixels whose centres lie within a half width and height, rounding outwards."""
    wide, high = wide + BOX_MARGIN * (1.0 + wide + abs(u)), high + BOX_MARGIN * (1.0 + high + abs(v))
    return (
        np.maximum(np.ceil(u - wide - 0.5), 0.0),
        np.minimum(np.floor(u + wide - 0.5) + 1.0, camera.width),
        np.maximum(np.ceil(v - high - 0.5), 0.0),
        np.minimum(np.floor(v + high - 0.5) + 1.0, camera.height),
    )


def _dot(first: object, second: object) -> Float:
    """Of three entries, numbers or (N,), one after the other."""
    a, b = first, second
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])  # type: ignore[index]
