"""Depth pictures that can be asked about any point: how far in front of the seen surface it lies.

Orthographic cameras all around a cloud, each as large as what it sees.
"""

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
"""Pixels by which expected and median depth may differ where the light stops at one surface."""


@dataclass(frozen=True)
class DepthView:
    """An orthographic depth picture, prepared for questions; lengths in pixels' sides.

    depth: (H, W) float32, inf = nothing. slope: (H, W, 2) depth's growth per pixel to the right and down, the flatter
    of the two one-sided ones: none across an edge. cosine: (H, W) of the angle between view and surface. opacity:
    (H, W). rgb: (H, W, 3) linear colour, as if opaque.
    """

    camera: Camera
    depth: Single
    slope: Single
    cosine: Single
    opacity: Single
    rgb: Single

    def min_depth_within(self, reach: int) -> Single:
        """(H, W) the least depth among the pixels at most reach away along both axes."""
        least = self.depth
        for axis in (0, 1):
            length = least.shape[axis]
            border = [(reach, reach) if each == axis else (0, 0) for each in (0, 1)]
            wide = np.pad(least, border, constant_values=np.inf)
            shifted = [np.take(wide, range(by, by + length), axis=axis) for by in range(2 * reach + 1)]
            least = np.minimum.reduce(shifted)
        return least


@dataclass(frozen=True)
class PointSample:
    """What one sight says of n points. pixel: (n,) flat number of the pixel, -1 outside the picture. ahead: (n,) how
    far the point lies in front of the surface there along the view, inf = no surface. depth: (n,) of the point."""

    pixel: NDArray[np.intp]
    ahead: Single
    depth: Single


def make_depth_view(view: SplatView, *, kind: str = "mixed") -> DepthView:
    """Of an orthographic view with square pixels of side 1.

    The surface lies at the median depth where the light stops at several surfaces (at an outline, the expected depth
    lies between them), and at the expected depth where it stops at one, which is smoother than the depth of a single
    splat. kind: "mixed", or one of the two alone ("median", "expected").
    """
    expected, median = view.depth.astype(np.float32), view.median.astype(np.float32)
    seen = (view.opacity >= MIN_SURFACE_OPACITY) & np.isfinite(median)
    with np.errstate(invalid="ignore"):
        one = np.abs(expected - median) <= MAX_DEPTH_DIFFERENCE
    chosen = {"mixed": np.where(one, expected, median), "median": median, "expected": expected}[kind]
    depth = np.where(seen, chosen, np.float32(np.inf)).astype(np.float32)
    slope = np.stack([_compute_slope(depth, 1), _compute_slope(depth, 0)], axis=-1)
    cosine = 1.0 / np.sqrt(1.0 + np.sum(slope * slope, axis=-1))
    return DepthView(view.camera, depth, slope, cosine, view.opacity.astype(np.float32), compute_linear_colour(view))


def compute_linear_colour(view: SplatView) -> Single:
    """(H, W, 3) linear colour of what is seen, 0 to 1, without the black behind it; 0 where nothing is."""
    opacity = np.asarray(view.opacity, dtype=np.float32)[..., None]
    return srgb_to_linear(np.clip(view.rgb / np.maximum(opacity, np.float32(1e-6)), 0.0, 1.0)).astype(np.float32)


def sample_points(view: DepthView, points: NDArray[np.floating[Any]]) -> PointSample:
    """points: (n, 3) in the camera's frame."""
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
    """The smaller of the differences to both neighbours, zero where neither is a number."""
    with np.errstate(invalid="ignore"):
        step = np.diff(depth, axis=axis)
    nothing = np.full_like(np.take(step, [0], axis=axis) if step.size else np.take(depth, [0], axis=axis), np.inf)
    step = np.where(np.isfinite(step), step, np.float32(np.inf))
    before, after = np.concatenate([nothing, step], axis=axis), np.concatenate([step, nothing], axis=axis)
    flatter = np.where(np.abs(before) < np.abs(after), before, after)
    return np.where(np.isfinite(flatter), flatter, np.float32(0.0)).astype(np.float32)


Float = NDArray[np.float64]

GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)


def make_sphere_directions(count: int) -> Float:
    """(count, 3) unit vectors, evenly over the sphere: a Fibonacci lattice (Swinbank & Purser 2006)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    around, radius = GOLDEN_ANGLE * np.arange(count), np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=1)


def fit_orthographic_camera(direction: ArrayLike, means: Float, reach: Float, pixel: float) -> Camera:
    """The orthographic camera that looks along a unit direction (3,) from outside and sees balls of radius reach (n,)
    around means (n, 3) whole, with pixels of side pixel. Its depths start at 0."""
    forward = np.asarray(direction, dtype=np.float64)
    aside = np.eye(3)[np.argmin(np.abs(forward))]
    right = np.cross(aside, forward)
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
    """That camera for each of sphere_directions(count)."""
    return [fit_orthographic_camera(-direction, means, reach, pixel) for direction in make_sphere_directions(count)]
