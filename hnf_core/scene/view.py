"""What a camera sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .camera import Camera


@dataclass(frozen=True)
class RgbdView:
    """One rendered view.

    rgb: (H, W, 3) float32 linear. depth: (H, W) float32 planar z in metres, sky = inf.
    face_id: (H, W) int32, -1 = none. normal: (H, W, 3) float32 world shading normal (micro-normals included),
    zero where nothing is hit; None where the pass was not rendered. channels: further (H, W) or (H, W, 3) float32
    passes by name.
    """

    camera: Camera
    rgb: NDArray[np.float32]
    depth: NDArray[np.float32]
    face_id: NDArray[np.int32]
    normal: NDArray[np.float32] | None = None
    channels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
