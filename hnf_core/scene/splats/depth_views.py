"""Orthographic depth images of splats from all around, and the depth of any point relative to the visible surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...units import srgb_to_linear
from ..camera import Camera
from .rasterize import SplatView

Single = NDArray[np.float32]
Bool = NDArray[np.bool_]

MIN_SURFACE_OPACITY = 0.5
"""Opacity from which a pixel shows a surface."""
MAX_DEPTH_DIFFERENCE = 3.0
"""Largest difference between expected and median depth of a pixel that shows a single surface [pixels]."""


@dataclass(frozen=True)
class DepthView:
    """An orthographic depth image with slopes, in which points are looked up; lengths in pixels.

    Attributes
    ----------
    camera : Camera
        Orthographic camera with square pixels of side 1.
    depth : ndarray of float32, shape (H, W)
        Depth, inf if no surface.
    slope : ndarray of float32, shape (H, W, 2)
        Growth of depth per pixel to the right and down: the smaller one-sided difference, so that none crosses an edge.
    cosine : ndarray of float32, shape (H, W)
        Cosine of the angle between view and surface normal.
    opacity : ndarray of float32, shape (H, W)
        Accumulated opacity.
    rgb : ndarray of float32, shape (H, W, 3)
        Linear color, divided by the opacity.
    """

    camera: Camera
    depth: Single
    slope: Single
    cosine: Single
    opacity: Single
    rgb: Single

    def min_depth_within(self, reach: int) -> Single:
        """Return the least depth (H, W) among the pixels at most `reach` away along both axes."""
        minimum = self.depth
        for axis in (0, 1):
            length = minimum.shape[axis]
            border = [(reach, reach) if current == axis else (0, 0) for current in (0, 1)]
            padded = np.pad(minimum, border, constant_values=np.inf)
            shifted = [np.take(padded, range(by, by + length), axis=axis) for by in range(2 * reach + 1)]
            minimum = np.minimum.reduce(shifted)
        return minimum


@dataclass(frozen=True)
class PointSample:
    """Result of looking up n points in one depth view.

    Attributes
    ----------
    pixel : ndarray of int, shape (n,)
        Flat index of the pixel, -1 outside the image.
    ahead : ndarray of float32, shape (n,)
        Distance of the point in front of the surface along the view, inf if no surface.
    depth : ndarray of float32, shape (n,)
        Depth of the point.
    """

    pixel: NDArray[np.intp]
    ahead: Single
    depth: Single


def make_depth_view(view: SplatView) -> DepthView:
    """Make a depth view from a rendered orthographic view with square pixels of side 1.

    The depth is the expected depth where a pixel shows a single surface, since it is smoother than the depth of
    one splat, and the median depth elsewhere, since at an outline the expected depth lies between two surfaces.

    Parameters
    ----------
    view : SplatView
        The rendered view.

    Returns
    -------
    DepthView
        The depth view.
    """
    expected, median = view.depth.astype(np.float32), view.median.astype(np.float32)
    is_surface = (view.opacity >= MIN_SURFACE_OPACITY) & np.isfinite(median)
    with np.errstate(invalid="ignore"):
        single_surface = np.abs(expected - median) <= MAX_DEPTH_DIFFERENCE
    depth = np.where(is_surface, np.where(single_surface, expected, median), np.float32(np.inf)).astype(np.float32)
    slope = np.stack([_compute_slope(depth, 1), _compute_slope(depth, 0)], axis=-1)
    cosine = 1.0 / np.sqrt(1.0 + np.sum(slope * slope, axis=-1))
    return DepthView(view.camera, depth, slope, cosine, view.opacity.astype(np.float32), compute_linear_colour(view))


def compute_linear_colour(view: SplatView) -> Single:
    """Return the linear colour (H, W, 3), 0 to 1, without the black background; 0 if nothing is visible."""
    opacity = np.asarray(view.opacity, dtype=np.float32)[..., None]
    return srgb_to_linear(np.clip(view.rgb / np.maximum(opacity, np.float32(1e-6)), 0.0, 1.0)).astype(np.float32)


def sample_points(view: DepthView, points: NDArray[np.floating[Any]]) -> PointSample:
    """Look up points (n, 3), in the camera's world frame, in a depth view."""
    axes = view.camera.pose[:3, :3].astype(np.float32)
    local = np.asarray(points, dtype=np.float32) @ axes - (view.camera.pose[:3, 3] @ view.camera.pose[:3, :3]).astype(
        np.float32
    )
    u = local[:, 0] + np.float32(view.camera.intrinsics[0, 2])
    v = local[:, 1] + np.float32(view.camera.intrinsics[1, 2])
    column, row = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    height, width = view.depth.shape
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel = np.where(within, row * width + column, 0)
    slope = view.slope.reshape(-1, 2)[pixel]
    surface = view.depth.reshape(-1)[pixel]
    surface = surface + slope[:, 0] * (u - column - np.float32(0.5)) + slope[:, 1] * (v - row - np.float32(0.5))
    ahead = np.where(within, surface - local[:, 2], np.float32(np.inf))
    return PointSample(np.where(within, pixel, -1), ahead, local[:, 2])


def _compute_slope(depth: Single, axis: int) -> Single:
    """Return the smaller of the depth differences to the two neighbors along an axis, zero if neither is finite."""
    with np.errstate(invalid="ignore"):
        step = np.diff(depth, axis=axis)
    nothing = np.full_like(np.take(step, [0], axis=axis) if step.size else np.take(depth, [0], axis=axis), np.inf)
    step = np.where(np.isfinite(step), step, np.float32(np.inf))
    before, after = np.concatenate([nothing, step], axis=axis), np.concatenate([step, nothing], axis=axis)
    flatter = np.where(np.abs(before) < np.abs(after), before, after)
    return np.where(np.isfinite(flatter), flatter, np.float32(0.0)).astype(np.float32)


Float = NDArray[np.float64]

GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)
"""Angle between consecutive points of a Fibonacci lattice [rad]."""


def make_sphere_directions(count: int) -> Float:
    """Return unit vectors (count, 3), evenly over the sphere: a Fibonacci lattice (Swinbank & Purser 2006)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle, radius = GOLDEN_ANGLE * np.arange(count), np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def fit_orthographic_camera(direction: ArrayLike, means: Float, reach: Float, pixel: float) -> Camera:
    """Fit an orthographic camera around spheres, so that it sees all of them.

    Parameters
    ----------
    direction : array_like, shape (3,)
        Unit viewing direction.
    means : ndarray, shape (n, 3)
        Centers of the spheres.
    reach : ndarray, shape (n,)
        Radii of the spheres.
    pixel : float
        Side of a pixel, in the unit of `means`.

    Returns
    -------
    Camera
        The camera; its depths start at 0.
    """
    forward = np.asarray(direction, dtype=np.float64)
    least_aligned = np.eye(3)[np.argmin(np.abs(forward))]
    right = np.cross(least_aligned, forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    local = means @ axes
    low, high = (local - reach[:, None]).min(axis=0), (local + reach[:, None]).max(axis=0)
    width, height = (max(1, int(side)) for side in np.ceil((high - low)[:2] / pixel))
    pose = np.eye(4)
    pose[:3, :3] = axes
    pose[:3, 3] = axes @ np.array([*(low + high)[:2] / 2.0, low[2] - pixel])
    intrinsics = np.array([[1.0 / pixel, 0.0, width / 2.0], [0.0, 1.0 / pixel, height / 2.0], [0.0, 0.0, 1.0]])
    return Camera("orthographic", width, height, intrinsics, pose, 0.0, float(high[2] - low[2] + 2.0 * pixel))


def make_surrounding_cameras(means: Float, reach: Float, count: int, pixel: float) -> list[Camera]:
    """Fit orthographic cameras around spheres (centers `means`, radii `reach`) in `count` evenly spread directions."""
    return [fit_orthographic_camera(-direction, means, reach, pixel) for direction in make_sphere_directions(count)]
