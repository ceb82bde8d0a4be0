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

from .colours import unlit_colours, view_of_place, views_around
from .sampling import Samples, sample_mesh

Float = NDArray[np.float64]

ACROSS, THICK = 0.65, 0.06
"""Standard deviations along and across the surface, in spacings."""
OPACITY = 0.95
REACH_M = 0.8 * PATCH_SIZE_M
"""Splats are fine so far around a place: half of a patch's diagonal, and a little more."""
PIXELS_A_SPACING = 2.0


def object_samples(
    mesh: TriangleMesh, spacing_m: float, seed: int, patches: Sequence[Patch] = (), fine_m: float | None = None
) -> Samples:
    """Points of one object, fine_m apart around the patches. All in the surface frame."""
    return sample_mesh(
        mesh, spacing_m, seed, places=[patch.centre for patch in patches], reach_m=REACH_M, fine_m=fine_m
    )


def object_splats(
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
    samples = object_samples(surface.mesh, spacing_m, seed, patches, fine_m)
    cameras = list(views_around(surface.mesh.vertices, spacing_m / PIXELS_A_SPACING))
    if fine_m is not None:
        cameras += [view_of_place(each.centre, each.normal, REACH_M, fine_m / PIXELS_A_SPACING) for each in patches]
    return flat_splats(
        samples,
        unlit_colours(obj, surface, samples, cameras, metres_per_unit),
        surface.rigid if in_world else np.eye(4),
    )


def flat_splats(samples: Samples, linear: NDArray[np.float32], rigid: Float) -> Splats:
    """Discs on the points, of linear colour (n, 3); rigid: (4, 4) world ← the samples' frame."""
    count = len(samples)
    scales = samples.spacing[:, None] * np.array([ACROSS, ACROSS, THICK])
    harmonics = (linear_to_srgb(linear) - 0.5) / Y_00
    return Splats(
        means=(samples.position @ rigid[:3, :3].T + rigid[:3, 3]).astype(np.float32),
        scales=scales.astype(np.float32),
        rotations=turned_from_z(samples.normal @ rigid[:3, :3].T).astype(np.float32),
        opacities=np.full(count, OPACITY, dtype=np.float32),
        harmonics=harmonics[:, None, :].astype(np.float32),
    )


def turned_from_z(normals: Float) -> Float:
    """(n, 4) unit quaternions w x y z of the shortest turn from +z to unit normals (n, 3)."""
    x, y, z = normals.T
    turn = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    turn[1.0 + z < 1e-12] = [0.0, 1.0, 0.0, 0.0]
    return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True))


def joined(parts: Sequence[Splats]) -> Splats:
    return Splats(*(np.concatenate([getattr(part, name) for part in parts])
                    for name in ("means", "scales", "rotations", "opacities", "harmonics")))  # fmt: skip
