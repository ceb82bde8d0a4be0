"""What a camera sees of splats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera


@dataclass(frozen=True)
class SplatView:
    """One view of splats, in the unit of its camera.

    rgb: (H, W, 3) display-referred (sRGB) colour over black, Σ w c: the space splats are trained in. depth: (H, W)
    expected planar depth, Σ w z / Σ w, inf where opacity is 0. median: (H, W) planar depth of the splat at which half
    of the light is gone, inf where opacity stays below one half. opacity: (H, W) in [0, 1], Σ w. All float32 (the
    reference: float64). drawn: splats that met the picture. pairs: Gaussians evaluated at a pixel.
    """

    camera: Camera
    rgb: NDArray[np.floating[Any]]
    depth: NDArray[np.floating[Any]]
    median: NDArray[np.floating[Any]]
    opacity: NDArray[np.floating[Any]]
    drawn: int
    pairs: int
