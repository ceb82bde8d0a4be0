"""A view cut open: a stroke that something stands before is looked at past it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.camera import Camera

Float = NDArray[np.float64]

OCCLUSION_DEPTH_M = 3e-3
"""A contact point this far behind what the picture shows there is hidden."""


def sample_depth(image: NDArray[np.float32], uv: Float) -> Float:
    """(n,) what a depth picture (H, W) holds at pixels (n, 2), counted from its upper left corner; outside, what is
    nearest there."""
    height, width = image.shape
    column = np.clip(uv[:, 0].astype(int), 0, width - 1)
    row = np.clip(uv[:, 1].astype(int), 0, height - 1)
    return np.asarray(image[row, column], dtype=np.float64)


def clip_obstacles(camera: Camera, depth: Float, visible_depth: Float, clearance_m: float) -> Camera | None:
    """camera, seeing nothing of what stands before a stroke; None where that stands beside the stroke instead, so that
    no cut parts them.

    depth: (n,) of the stroke's points, shown: (n,) what a picture by camera shows there, planar metres. room_m: this
    much before the stroke is kept where the obstacle is farther away.
    """
    nearest = float(depth.min())
    before = visible_depth[(visible_depth < depth - OCCLUSION_DEPTH_M) & (visible_depth < nearest - OCCLUSION_DEPTH_M)]
    if not len(before):
        return None
    return replace(camera, clip_start=max(nearest - clearance_m, (float(before.max()) + nearest) / 2.0))
