"""The frame of a cloud of splats beside the surface frame in which strokes, patches and cameras live."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera

from .splat_cloud import get_cloud_placement

Float = NDArray[np.float64]

SCALE_TOLERANCE = 1e-4
"""Relative difference between the scales along three axes that still counts as none: Blender's own are float32."""


@dataclass(frozen=True)
class CloudFrame:
    """metres: of a unit of the cloud. turn: (3, 3) rotation, surface frame ← cloud. shift: (3,) m, of the cloud's
    origin in the surface frame."""

    metres_per_unit: float
    rotation: Float
    translation: Float

    def to_surface(self, points: NDArray[np.floating[Any]]) -> Float:
        """(n, 3) points of the cloud → metres in the surface frame."""
        return np.asarray(points, dtype=np.float64) @ (self.metres_per_unit * self.rotation).T + self.translation

    def to_cloud_camera(self, camera: Camera) -> Camera:
        """A camera in the surface frame (metres) → the same one in the cloud's own frame and unit."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation.T @ camera.pose[:3, :3]
        pose[:3, 3] = self.rotation.T @ (camera.pose[:3, 3] - self.translation) / self.metres_per_unit
        intrinsics = camera.intrinsics * np.array([[self.metres_per_unit], [self.metres_per_unit], [1.0]])
        intrinsics[:2, 2] = camera.intrinsics[:2, 2]
        return replace(
            camera,
            intrinsics=intrinsics if camera.kind == "orthographic" else camera.intrinsics,
            pose=pose,
            clip_start=camera.clip_start / self.metres_per_unit,
            clip_end=camera.clip_end / self.metres_per_unit,
        )


def compute_cloud_frame(obj: Any, cloud: Any, stretch: Float) -> CloudFrame:
    """Where a surface's splats stand in its surface frame. stretch: Surface's. Raises SceneError where they are scaled
    unevenly or mirrored."""
    place = get_cloud_placement(obj, cloud)
    linear = stretch @ place[:3, :3]
    metres = get_uniform_scale(linear, f"object '{obj.name}'")
    # The last bits of a turned object's stretch are rounding, and could put another of two splats in front.
    turn = np.round(linear / metres, 6) + 0.0
    return CloudFrame(float(f"{metres:.7g}"), turn, stretch @ place[:3, 3])


def get_uniform_scale(matrix: Float, where: str) -> float:
    """k of a matrix (3, 3) = k · rotation. Raises SceneError for any other: a Gaussian seen through a stretched or
    mirrored cloud is not what was trained."""
    left, sizes, right = np.linalg.svd(matrix)
    if not np.isfinite(matrix).all() or sizes[2] <= 0.0 or sizes[0] > (1.0 + SCALE_TOLERANCE) * sizes[2]:
        raise SceneError(
            f"its splats are scaled by {sizes[0]:.3g}, {sizes[1]:.3g} and {sizes[2]:.3g} along three axes.",
            where=where,
            remedy="Give the object one scale along all axes (N panel > Item > Scale).",
        )
    if np.linalg.det(left @ right) < 0.0:
        raise SceneError("its splats are mirrored.", where=where, remedy="Make the object's scale positive.")
    return float(np.mean(sizes))
