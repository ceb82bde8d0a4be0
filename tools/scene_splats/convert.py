"""Objects → flat, opaque Gaussians on their surface, as large as their spacing, in world metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_blender.bridge.meshes import Surface
from hnf_core.export.srgb import linear_to_srgb
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.patch import PATCH_SIZE_M, Patch
from hnf_core.scene.splats.cloud import Splats
from hnf_core.scene.splats.inria import Y_00

from .colours import make_patch_camera, make_surrounding_cameras, render_unlit_colours
from .sampling import Samples, sample_mesh

Float = NDArray[np.float64]

RADIUS_SPACINGS, THICKNESS_SPACINGS = 0.65, 0.06
"""Standard deviations along and across the surface, in spacings."""
OPACITY = 0.95
FINE_RADIUS_M = 0.8 * PATCH_SIZE_M
"""Splats are fine so far around a place: half of a patch's diagonal, and a little more."""
PIXELS_PER_SPACING = 2.0


def sample_object(
    mesh: TriangleMesh, spacing_m: float, seed: int, patches: Sequence[Patch] = (), fine_m: float | None = None
) -> Samples:
    """Points of one object, fine_m apart around the patches. All in the surface frame."""
    return sample_mesh(
        mesh, spacing_m, seed, centres=[patch.centre for patch in patches], reach_m=FINE_RADIUS_M, fine_m=fine_m
    )


def make_object_splats(
    obj: Any,
    surface: Surface,
    spacing_m: float,
    seed: int,
    metres_per_unit: float,
    patches: Sequence[Patch] = (),
    fine_m: float | None = None,
    in_world: bool = True,
) -> Splats:
    """One object as splats of degree 0, in metres of the world, or of the surface frame."""
    samples = sample_object(surface.mesh, spacing_m, seed, patches, fine_m)
    cameras = list(make_surrounding_cameras(surface.mesh.vertices, spacing_m / PIXELS_PER_SPACING))
    if fine_m is not None:
        cameras += [
            make_patch_camera(each.centre, each.normal, FINE_RADIUS_M, fine_m / PIXELS_PER_SPACING) for each in patches
        ]
    return make_flat_splats(
        samples,
        render_unlit_colours(obj, surface, samples, cameras, metres_per_unit),
        surface.rigid if in_world else np.eye(4),
    )


def make_flat_splats(samples: Samples, linear: NDArray[np.float32], rigid: Float) -> Splats:
    """Discs on the points, of linear colour (n, 3); rigid: (4, 4) world ← the samples' frame."""
    count = len(samples)
    scales = samples.spacing[:, None] * np.array([RADIUS_SPACINGS, RADIUS_SPACINGS, THICKNESS_SPACINGS])
    harmonics = (linear_to_srgb(linear) - 0.5) / Y_00
    return Splats(
        means=(samples.position @ rigid[:3, :3].T + rigid[:3, 3]).astype(np.float32),
        scales=scales.astype(np.float32),
        rotations=compute_rotations_from_z(samples.normal @ rigid[:3, :3].T).astype(np.float32),
        opacities=np.full(count, OPACITY, dtype=np.float32),
        harmonics=harmonics[:, None, :].astype(np.float32),
    )


def compute_rotations_from_z(normals: Float) -> Float:
    """(n, 4) unit quaternions w x y z of the shortest turn from +z to unit normals (n, 3)."""
    x, y, z = normals.T
    turn = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    turn[1.0 + z < 1e-12] = [0.0, 1.0, 0.0, 0.0]
    return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True))


def concatenate_splats(clouds: Sequence[Splats]) -> Splats:
    return Splats(*(np.concatenate([getattr(part, name) for part in clouds])
                    for name in ("means", "scales", "rotations", "opacities", "harmonics")))  # fmt: skip
