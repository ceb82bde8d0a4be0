"""3-D Gaussians of a splatting scene (Kerbl et al. 2023, 3D Gaussian Splatting), and their view-dependent colour.

Colour is real spherical harmonics up to degree 3, with the constants, signs and order of the INRIA code (Sloan 2013,
Efficient Spherical Harmonic Evaluation).
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
    """N Gaussians of a splatting scene, in the file's own frame and unit.

    Colour is 0.5 + Σ Y · c, clipped at 0, with spherical harmonics Y of degree L = 0 … 3.

    Attributes
    ----------
    means : ndarray of float32, shape (N, 3)
        Centres.
    scales : ndarray of float32, shape (N, 3)
        Standard deviations along the principal axes, positive.
    rotations : ndarray of float32, shape (N, 4)
        Unit quaternions w x y z from principal axes to the frame.
    opacities : ndarray of float32, shape (N,)
        Opacities in [0, 1].
    harmonics : ndarray of float32, shape (N, (L + 1)², 3)
        Coefficients of display-referred (sRGB) colour, the constant one first.
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
        """Degree L of the spherical harmonics."""
        return math.isqrt(self.harmonics.shape[1]) - 1

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Splats:
        """Return the splats selected by a mask (N,) or by indices (K,)."""
        return Splats(
            self.means[which], self.scales[which], self.rotations[which], self.opacities[which], self.harmonics[which]
        )


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the splats' frame and unit; points on its faces are inside."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask (N,) of the points (N, 3) inside the box."""
        points = np.asarray(points)
        return np.asarray(((points >= np.array(self.low)) & (points <= np.array(self.high))).all(axis=-1))


Floats = NDArray[np.floating[Any]]

C0 = 0.28209479177387814
"""Constant of the harmonic of degree 0."""
C1 = 0.4886025119029199
"""Constant of the harmonics of degree 1."""
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
"""Constants of the harmonics of degree 2."""
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
"""Constants of the harmonics of degree 3."""


def compute_view_directions(means: Floats, camera: Camera) -> Floats:
    """Return unit vectors (N, 3) from the camera's centre to points (N, 3), in their frame and number type.

    For an orthographic camera they are its forward axis; for a point in the camera's centre, zero.
    """
    if camera.kind == "orthographic":
        return np.broadcast_to(camera.pose[:3, 2].astype(means.dtype), means.shape)
    offset = (means - camera.pose[:3, 3]).astype(means.dtype)
    length = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2 + offset[:, 2] ** 2)
    return np.asarray(offset / np.where(length > 0.0, length, 1.0)[:, None])


def evaluate_sh_basis(directions: Floats, degree: int) -> list[Floats]:
    """Evaluate the (degree + 1)² spherical harmonics, (N,) each, of unit vectors (N, 3)."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    basis: list[Floats] = [np.full(len(directions), C0, dtype=directions.dtype)]
    if degree > 0:
        basis += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        basis += [
            C2[0] * x * y,
            C2[1] * y * z,
            C2[2] * (2.0 * zz - xx - yy),
            C2[3] * x * z,
            C2[4] * (xx - yy),
        ]
    if degree > 2:
        basis += [
            C3[0] * y * (3.0 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4.0 * zz - xx - yy),
            C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            C3[4] * x * (4.0 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3.0 * yy),
        ]
    return basis


def evaluate_sh_colours(harmonics: Floats, directions: Floats) -> Floats:
    """Evaluate display-referred colours (N, 3), max(0, 0.5 + Σ Y c).

    Terms are added one after the other, so that a splat's color does not depend, by rounding, on the other splats.

    Parameters
    ----------
    harmonics : ndarray, shape (N, (L + 1)², 3)
        Coefficients.
    directions : ndarray, shape (N, 3)
        Unit viewing directions.

    Returns
    -------
    ndarray, shape (N, 3)
        The colours.
    """
    degree = round(harmonics.shape[1] ** 0.5) - 1
    total = np.full((len(harmonics), 3), 0.5, dtype=harmonics.dtype)
    for k, value in enumerate(evaluate_sh_basis(directions, degree)):
        total += value[:, None] * harmonics[:, k]
    return np.maximum(total, 0.0)
