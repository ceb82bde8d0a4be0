"""A scene reconstructed as 3-D Gaussians (Kerbl et al. 2023, 3D Gaussian Splatting).

A part of a scene's frame.

Colour of splats by the direction they are seen from: real spherical harmonics up to degree 3, with the constants,
signs and order of the INRIA code (Kerbl et al. 2023; Sloan 2013, Efficient Spherical Harmonic Evaluation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera import Camera

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


@dataclass(frozen=True)
class Box:
    """Along the axes of the splats' own frame, in their unit: every point from low to high, both included."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(N, 3) → (N,)."""
        points = np.asarray(points)
        return np.asarray(((points >= np.array(self.low)) & (points <= np.array(self.high))).all(axis=-1))


Floats = NDArray[np.floating[Any]]

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def compute_view_directions(means: Floats, camera: Camera) -> Floats:
    """(N, 3) unit vectors from the camera's centre to points (N, 3), in their frame and number type; for an
    orthographic camera its forward axis. Zero for a point in the camera's centre."""
    if camera.kind == "orthographic":
        return np.broadcast_to(camera.pose[:3, 2].astype(means.dtype), means.shape)
    offset = (means - camera.pose[:3, 3]).astype(means.dtype)
    length = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2 + offset[:, 2] ** 2)
    return np.asarray(offset / np.where(length > 0.0, length, 1.0)[:, None])


def evaluate_sh_basis(directions: Floats, degree: int) -> list[Floats]:
    """The (degree + 1)² harmonics of unit vectors (N, 3), each (N,)."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    found: list[Floats] = [np.full(len(directions), C0, dtype=directions.dtype)]
    if degree > 0:
        found += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        found += [
            C2[0] * x * y,
            C2[1] * y * z,
            C2[2] * (2.0 * zz - xx - yy),
            C2[3] * x * z,
            C2[4] * (xx - yy),
        ]
    if degree > 2:
        found += [
            C3[0] * y * (3.0 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4.0 * zz - xx - yy),
            C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            C3[4] * x * (4.0 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3.0 * yy),
        ]
    return found


def evaluate_sh_colours(harmonics: Floats, directions: Floats) -> Floats:
    """(N, 3) display-referred colour, 0.5 + Σ Y c and no less than 0, of coefficients (N, (L + 1)², 3) seen along unit
    vectors (N, 3). One coefficient after the other, so that a splat's colour does not depend on its neighbours."""
    degree = round(harmonics.shape[1] ** 0.5) - 1
    total = np.full((len(harmonics), 3), 0.5, dtype=harmonics.dtype)
    for k, value in enumerate(evaluate_sh_basis(directions, degree)):
        total += value[:, None] * harmonics[:, k]
    return np.maximum(total, 0.0)
