"""Pinhole and orthographic cameras: intrinsics, pose, projection and back. Axes: +x right, +y down, +z forward.

A `Patch` is the square of surface that a touch sensor covers, with its tangent frame and its close-up camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole or orthographic camera; pixel centres lie at +0.5.

    Attributes
    ----------
    kind : {"perspective", "orthographic"}
        Projection; a perspective camera divides by z, an orthographic one does not.
    width, height : int
        Size of the image [pixels].
    intrinsics : ndarray of float64, shape (3, 3)
        Focal lengths and principal point [pixels]; for an orthographic camera the focal entries are pixels per metre.
    pose : ndarray of float64, shape (4, 4)
        Rigid transform from camera to world [m].
    clip_start, clip_end : float
        Visible range along +z [m].
    whole : tuple of 4 floats or None
        Left, top, right and bottom of the image that this one was cropped from, in this one's pixels; None if it was
        not cropped.
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
        """Left, top, right and bottom of the uncropped image, in pixels of this one."""
        return self.whole or (0.0, 0.0, float(self.width), float(self.height))

    def project(self, points: ArrayLike) -> tuple[Float, Float]:
        """Project world points (..., 3) to pixel coordinates (..., 2) and planar depth z (...,) [m]."""
        points = np.asarray(points, dtype=np.float64)
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        z = local[..., 2]
        flat = local[..., :2] if self.kind == "orthographic" else local[..., :2] / z[..., None]
        uv = flat @ self.intrinsics[:2, :2].T + self.intrinsics[:2, 2]
        return uv, z

    def unproject(self, uv: ArrayLike, z: ArrayLike) -> Float:
        """Return the world points (..., 3) of pixel coordinates (..., 2) at planar depth (...,) [m]."""
        uv, z = np.asarray(uv, dtype=np.float64), np.asarray(z, dtype=np.float64)
        flat = (uv - self.intrinsics[:2, 2]) @ np.linalg.inv(self.intrinsics[:2, :2]).T
        if self.kind == "perspective":
            flat = flat * z[..., None]
        local = np.concatenate([flat, z[..., None]], axis=-1)
        return np.asarray(local @ self.pose[:3, :3].T + self.pose[:3, 3])

    def pixel_centres(self, rows: slice = slice(None)) -> Float:
        """Return the pixel coordinates (u, v) of the pixel centres, (H, W, 2), of a range of image rows."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height)[rows] + 0.5)
        return np.stack([x, y], axis=-1)

    def pixel_rays(self, rows: slice = slice(None)) -> tuple[Float, Float]:
        """Return the world-space ray origins and directions, (H, W, 3) each, of the pixels in a range of image rows.

        Directions have camera z = 1, so that a hit's ray parameter is its planar depth.
        """
        centres = self.pixel_centres(rows)
        origins = self.unproject(centres, np.zeros(centres.shape[:2]))
        directions = self.unproject(centres, np.ones(centres.shape[:2])) - origins
        return origins, directions

    def crop(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera of a rectangle of this one's pixels: the same rays, fewer of them.

        Raises ValueError for a rectangle that is empty or leaves the image.
        """
        if width < 1 or height < 1 or left < 0 or top < 0 or left + width > self.width or top + height > self.height:
            raise ValueError(f"{width} x {height} at {left}, {top} is no part of {self.width} x {self.height} pixels")
        intrinsics = self.intrinsics - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        x0, y0, x1, y1 = self.frame
        uncropped = (x0 - left, y0 - top, x1 - left, y1 - top)
        return replace(self, width=width, height=height, intrinsics=intrinsics, whole=uncropped)


def orthographic(
    centre: ArrayLike, x_axis: ArrayLike, normal: ArrayLike, size_m: float, pixels: int, distance_m: float
) -> Camera:
    """Make a square close-up camera that looks along -normal at `centre`.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Point in the middle of the image [m].
    x_axis : array_like, shape (3,)
        Direction of the image's +x; its part along `normal` is removed.
    normal : array_like, shape (3,)
        Direction towards the camera, of any length.
    size_m : float
        Side of the field of view [m].
    pixels : int
        Side of the image [pixels].
    distance_m : float
        Height of the camera above `centre` [m]; the clip range is 0 to twice that.

    Returns
    -------
    Camera
        The camera.
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


PATCH_SIZE_M = 20e-3
"""Field of view of a GelSight sensor [m]."""
CAMERA_DISTANCE_M = 10e-3
"""Height of the close-up camera above the patch [m]; its clip range reaches as far below."""


@dataclass(frozen=True)
class Patch:
    """A square of surface with its tangent frame.

    The direction of a stroke on it is an angle in the tangent plane, counted from `x_axis` towards `y_axis`.

    Attributes
    ----------
    centre, x_axis, normal : ndarray of float64, shape (3,)
        Centre [m] and axes in the frame of the mesh. `x_axis` is the surface's tangent (∂p/∂u if it has UVs),
        orthogonal to `normal`.
    slot : int
        Material slot of the object, as in Blender.
    size_m : float
        Side of the square [m].
    """

    centre: NDArray[np.float64]
    x_axis: NDArray[np.float64]
    normal: NDArray[np.float64]
    slot: int
    size_m: float = PATCH_SIZE_M

    @property
    def y_axis(self) -> NDArray[np.float64]:
        """Second tangent, normal × x_axis."""
        return np.cross(self.normal, self.x_axis)

    @property
    def reach_m(self) -> float:
        """Radius of the sphere around the patch's centre that contains all its close-up camera can see [m]."""
        return float(np.hypot(CAMERA_DISTANCE_M, self.size_m * np.sqrt(0.5)))

    def camera(self, pixels: int) -> Camera:
        """Return the close-up camera of the patch."""
        return orthographic(self.centre, self.x_axis, self.normal, self.size_m, pixels, CAMERA_DISTANCE_M)

    def to_plane(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points (..., 3) in the mesh's frame to tangent-plane coordinates (..., 2) [m]; centre = 0, +y up."""
        local = points - self.centre
        return np.stack([local @ self.x_axis, local @ self.y_axis], axis=-1)
