"""Clouds of flat Gaussians laid on shapes that are known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.splats.depth_views import make_sphere_directions
from hnf_core.scene.splats.gaussians import Splats

Float = NDArray[np.float64]
Y00 = 0.28209479177387814


def facing(normals: Float) -> NDArray[np.float32]:
    """Quaternions (n, 4) w x y z that turn +Z to unit normals (n, 3)."""
    z = np.array([0.0, 0.0, 1.0])
    turn = np.concatenate([1.0 + normals @ z[:, None], np.cross(z, normals)], axis=1)
    turn[turn[:, 0] < 1e-6] = (0.0, 1.0, 0.0, 0.0)
    return (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32)


def discs(points: Float, normals: Float, sigma: float, colour: Float | None = None, opacity: float = 0.9) -> Splats:
    """Discs of standard deviation sigma, a tenth as thick. colour: (n, 3) display-referred, 0.5 where not given."""
    count = len(points)
    harmonics = np.zeros((count, 1, 3)) if colour is None else ((colour - 0.5) / Y00)[:, None, :]
    return Splats(
        points.astype(np.float32),
        np.tile(np.array([sigma, sigma, sigma / 10.0], dtype=np.float32), (count, 1)),
        facing(normals),
        np.full(count, opacity, dtype=np.float32),
        harmonics.astype(np.float32),
    )


def sphere(count: int = 1500, radius: float = 1.0, **more: Float) -> Splats:
    """About the origin."""
    directions = make_sphere_directions(count)
    return discs(radius * directions, directions, 0.8 * radius * (4.0 * np.pi / count) ** 0.5, **more)


def torus(around: int = 80, across: int = 30, large: float = 0.7, small: float = 0.3) -> Splats:
    """About the Z axis."""
    u, v = (
        each.reshape(-1) + 0.0
        for each in np.meshgrid(2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across)
    )
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=1)
    ring = np.stack([np.cos(u), np.sin(u), 0.0 * u], axis=1)
    return discs(large * ring + small * normals, normals, 2 * np.pi * large / around * 0.8)


def sheet(side: int = 30) -> Splats:
    """The square −1 … 1 in z = 0."""
    x, y = (each.reshape(-1) for each in np.meshgrid(*[np.linspace(-1.0, 1.0, side)] * 2))
    points = np.stack([x, y, 0.0 * x], axis=1)
    return discs(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), 1.6 / side)


def fog(count: int = 2000, seed: int = 0) -> Splats:
    """Balls anywhere in a cube, some of them opaque."""
    random = np.random.default_rng(seed)
    points = random.uniform(-1.0, 1.0, (count, 3))
    made = discs(points, np.tile([0.0, 0.0, 1.0], (count, 1)), 0.03)
    opacities = random.uniform(0.05, 1.0, count).astype(np.float32)
    return replace(made, scales=np.full((count, 3), 0.03, dtype=np.float32), opacities=opacities)


def joined(*clouds: Splats) -> Splats:
    """All of them."""
    names = ("means", "scales", "rotations", "opacities", "harmonics")
    return Splats(*(np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names))


def moved(cloud: Splats, scale: float = 1.0, by: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Splats:
    """Scaled about the origin, then shifted."""
    means = (cloud.means * np.float32(scale) + np.array(by, dtype=np.float32)).astype(np.float32)
    return replace(cloud, means=means, scales=cloud.scales * np.float32(scale))
