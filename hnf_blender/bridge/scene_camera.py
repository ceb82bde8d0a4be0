"""Camera records of Blender's cameras, and a camera where the scene has none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera

Float = NDArray[np.float64]

FIELD_OF_VIEW_RAD = np.radians(40.0)
"""Of the camera that is supplied, across the image."""


def read_camera(scene: Any, camera_object: Any, metres_per_unit: float, matrix_world: Any = None) -> Camera:
    """The camera that scene renders camera_object with: resolution and its percentage, pixel aspect, sensor fit and
    shift counted; a render border is not (the whole frame is meant).

    matrix_world: (4, 4) evaluated matrix where the camera is animated, else as it stands. Raises SceneError for a
    panoramic camera.
    """
    data, render = camera_object.data, scene.render
    if data.type not in {"PERSP", "ORTHO"}:
        raise SceneError(
            "it is a panoramic camera, which has no flat picture.",
            where=f"camera '{camera_object.name}'",
            remedy="Choose Perspective or Orthographic as its type.",
        )
    width = max(1, render.resolution_x * render.resolution_percentage // 100)
    height = max(1, render.resolution_y * render.resolution_percentage // 100)
    frame = np.array([list(corner) for corner in data.view_frame(scene=scene)], dtype=np.float64)
    (left, bottom, _), (right, top, _) = frame.min(axis=0), frame.max(axis=0)
    # view_frame answers on a plane in front of the camera; a perspective image scales with its distance.
    reach = -frame[0, 2] if data.type == "PERSP" else 1.0 / metres_per_unit
    scale_x, scale_y = width / (right - left), height / (top - bottom)
    intrinsics = np.array([[scale_x * reach, 0.0, -left * scale_x], [0.0, scale_y * reach, top * scale_y], [0, 0, 1]])
    matrix = camera_object.matrix_world if matrix_world is None else matrix_world
    pose = np.array([list(row) for row in matrix], dtype=np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    pose[:3, 3] *= metres_per_unit
    return Camera(
        "perspective" if data.type == "PERSP" else "orthographic",
        width,
        height,
        intrinsics,
        pose @ np.diag([1.0, -1.0, -1.0, 1.0]),
        data.clip_start * metres_per_unit,
        data.clip_end * metres_per_unit,
    )


def make_overview_camera(
    points: ArrayLike, outward: ArrayLike, radius_m: float, width: int = 960, height: int = 540
) -> Camera:
    """A perspective camera that shows points (n, 3) (world metres, z up) at three-quarter view from the side that
    outward (3,) points to, with radius_m around their middle in the picture."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    normal = np.asarray(outward, dtype=np.float64)
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, normal)
    level = np.linalg.norm(side) < 0.2  # a table top or a ceiling: come from the front
    lean = np.array([0.45, -0.8, 0.0]) if level else 0.5 * side / np.linalg.norm(side) + 0.35 * up
    back = normal + lean
    back = back / np.linalg.norm(back)
    reach = max(float(np.linalg.norm(points - middle, axis=-1).max(initial=0.0)), radius_m, 1e-6)
    focal = width / (2.0 * np.tan(FIELD_OF_VIEW_RAD / 2.0))
    distance = 1.1 * reach * np.hypot(focal, min(width, height) / 2.0) / (min(width, height) / 2.0)
    right = np.cross(up, back)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(-back, right), -back
    pose[:3, 3] = middle + distance * back
    intrinsics = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    return Camera("perspective", width, height, intrinsics, pose, distance * 1e-3, distance * 1e3)
