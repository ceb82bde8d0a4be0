"""A scene reconstructed as 3-D Gaussians (Kerbl et al. 2023, 3D Gaussian Splatting)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Splats:
    """N Gaussians, in the file's own frame and unit.

    means: (N, 3) float32 centres. scales: (N, 3) float32 > 0, standard deviations along the Gaussian's own axes.
    rotations: (N, 4) float32 unit quaternions w x y z, own axes → frame. opacities: (N,) float32 in [0, 1].
    harmonics: (N, (L + 1)², 3) float32 coefficients of display-referred (sRGB) colour, the constant one first;
    L = 0 … 3: colour = 0.5 + Σ Y · c, clipped at 0.
    """

    means: Single
    scales: Single
    rotations: Single
    opacities: Single
    harmonics: Single

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """L of the spherical harmonics."""
        return math.isqrt(self.harmonics.shape[1]) - 1

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Splats:
        """Those of a mask (N,) or of indices (K,)."""
        return Splats(
            self.means[which], self.scales[which], self.rotations[which], self.opacities[which], self.harmonics[which]
        )
