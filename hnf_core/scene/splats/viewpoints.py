"""Orthographic cameras all around a cloud, each as large as what it sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera import Camera

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
