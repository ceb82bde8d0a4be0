"""Camera records: intrinsics, pose, projection and back. +x right, +y down, +z forward."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole or orthographic camera.

    width, height: pixels. intrinsics: (3, 3) float64; a perspective camera divides by z, an orthographic one
    does not (its focal entries are pixels per metre). pose: (4, 4) camera→world, rigid, metres.
    clip_start, clip_end: metres along +z. Pixel centres lie at +0.5. whole: left, top, right and bottom of the picture
    that this one was cropped from, in pixels of this one; None: it is whole.
    """

    kind: Literal["perspective", "orthographic"]
    width: int
    height: int
    intrinsics: Float
    pose: Float
    clip_start: float = 0.0
    clip_end: float = float("inf")
    whole: tuple[float, float, float, float] | None = None

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the whole picture, in pixels of this one."""
        return self.whole or (0.0, 0.0, float(self.width), float(self.height))

    def project(self, points: ArrayLike) -> tuple[Float, Float]:
        """World points (..., 3) → pixel coordinates (..., 2) and planar depth z (...,)."""
        points = np.asarray(points, dtype=np.float64)
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        z = local[..., 2]
        flat = local[..., :2] if self.kind == "orthographic" else local[..., :2] / z[..., None]
        uv = flat @ self.intrinsics[:2, :2].T + self.intrinsics[:2, 2]
        return uv, z

    def unproject(self, uv: ArrayLike, z: ArrayLike) -> Float:
        """Pixel coordinates (..., 2) and planar depth (...,) → world points (..., 3)."""
        uv, z = np.asarray(uv, dtype=np.float64), np.asarray(z, dtype=np.float64)
        flat = (uv - self.intrinsics[:2, 2]) @ np.linalg.inv(self.intrinsics[:2, :2]).T
        if self.kind == "perspective":
            flat = flat * z[..., None]
        local = np.concatenate([flat, z[..., None]], axis=-1)
        return np.asarray(local @ self.pose[:3, :3].T + self.pose[:3, 3])

    def pixel_centres(self, rows: slice = slice(None)) -> Float:
        """(H, W, 2) pixel coordinates of every pixel centre in rows."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height)[rows] + 0.5)
        return np.stack([x, y], axis=-1)

    def pixel_rays(self, rows: slice = slice(None)) -> tuple[Float, Float]:
        """Origins and directions (H, W, 3) in the world, of pixels in rows; directions have camera z = 1, so a hit's
        ray parameter is its planar depth."""
        centres = self.pixel_centres(rows)
        origins = self.unproject(centres, np.zeros(centres.shape[:2]))
        directions = self.unproject(centres, np.ones(centres.shape[:2])) - origins
        return origins, directions

    def crop(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a rectangle of this one's pixels: the same rays, fewer of them. Raises ValueError for a
        rectangle that is empty or leaves the picture."""
        if width < 1 or height < 1 or left < 0 or top < 0 or left + width > self.width or top + height > self.height:
            raise ValueError(f"{width} x {height} at {left}, {top} is no part of {self.width} x {self.height} pixels")
        intrinsics = self.intrinsics - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        x0, y0, x1, y1 = self.frame
        whole = (x0 - left, y0 - top, x1 - left, y1 - top)
        return replace(self, width=width, height=height, intrinsics=intrinsics, whole=whole)


def orthographic(
    centre: ArrayLike, x_axis: ArrayLike, normal: ArrayLike, size_m: float, pixels: int, distance_m: float
) -> Camera:
    """A square close-up camera that looks along -normal at centre, image +x along x_axis.

    size_m: side of the field of view; distance_m: camera height above centre (clip range: 0 … 2 × distance).
    """
    normal = np.asarray(normal, dtype=np.float64)
    forward = -normal / np.linalg.norm(normal)
    right = np.asarray(x_axis, dtype=np.float64)
    right = right - forward * (right @ forward)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = np.asarray(centre, dtype=np.float64) - distance_m * forward
    scale = pixels / size_m
    intrinsics = np.array([[scale, 0.0, pixels / 2], [0.0, scale, pixels / 2], [0.0, 0.0, 1.0]])
    return Camera("orthographic", pixels, pixels, intrinsics, pose, 0.0, 2.0 * distance_m)
