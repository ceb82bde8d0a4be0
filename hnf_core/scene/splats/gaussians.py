"""3-D Gaussians of a splatting scene (Kerbl et al. 2023, 3D Gaussian Splatting), and their view-dependent colour.

Colour is real spherical harmonics up to degree 3, with the constants, signs and order of the INRIA code (Sloan 2013,
Efficient Spherical Harmonic Evaluation).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

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


# PlayCanvas's writer clips scales to e^±20 (4.9e8 and 2.1e-9 units) too. Within these limits the squares and products
# of rendering neither overflow nor vanish in float32.
MAX_LOG_SCALE = 20.0
MAX_VALUE = float(np.exp(MAX_LOG_SCALE))
MIN_QUATERNION_NORM = 1e-12
NOT_FINITE, TOO_LARGE, NO_ROTATION = "not finite", "too large", "no rotation"
DROP_REASONS = (NOT_FINITE, TOO_LARGE, NO_ROTATION)


@dataclass(frozen=True)
class RawSplats:
    """N Gaussians as a file stores them, not yet checked.

    Attributes
    ----------
    means, log_scales : ndarray, shape (N, 3)
        Centres, and natural logarithms of the standard deviations.
    rotations : ndarray, shape (N, 4)
        Quaternions w x y z of any length.
    opacities : ndarray, shape (N,)
        Opacities in [0, 1].
    harmonics : ndarray, shape (N, K, 3)
        Coefficients of the spherical harmonics of color, K = (degree + 1)².
    """

    means: Floats
    log_scales: Floats
    rotations: Floats
    opacities: Floats
    harmonics: Floats


@dataclass(frozen=True)
class ValidatedSplats:
    """Usable splats, and counts of the others.

    Attributes
    ----------
    splats : Splats
        Splats that can be rendered.
    total : int
        Number of Gaussians read.
    dropped : mapping of str to int
        Number of dropped splats for each of `DROP_REASONS`; each counts once, under the first reason.
    thickened : int
        Splats whose thinnest axis was raised to the minimum of 2.1e-9 units.
    """

    splats: Splats
    total: int
    dropped: Mapping[str, int]
    thickened: int


def validate_splats(raw: RawSplats) -> ValidatedSplats:
    """Return the Gaussians that can be rendered, in their order.

    Dropped are splats with a NaN, or an infinite number other than a log-scale of −∞; with a centre, scale or colour
    coefficient beyond 4.9e8; or with a quaternion shorter than 1e-12. A scale of 0 is a flat Gaussian: it stays, with
    the smallest scale allowed.
    """
    # Overflow is expected: a float64 beyond float32 becomes infinite, as does the length of a huge quaternion.
    with np.errstate(over="ignore", invalid="ignore"):
        total = len(raw.means)
        finite = ~np.isnan(raw.log_scales).any(axis=1) & ~np.isnan(raw.opacities)
        finite &= np.isfinite(raw.means).all(axis=1) & np.isfinite(raw.rotations).all(axis=1)
        finite &= np.isfinite(raw.harmonics).all(axis=(1, 2))
        in_range = (np.abs(raw.means) <= MAX_VALUE).all(axis=1) & (np.abs(raw.harmonics) <= MAX_VALUE).all(axis=(1, 2))
        in_range &= (raw.log_scales <= MAX_LOG_SCALE).all(axis=1)
        lengths = np.linalg.norm(raw.rotations.astype(np.float64), axis=1)
        has_rotation = (lengths >= MIN_QUATERNION_NORM) & np.isfinite(lengths)
        dropped = dict(
            zip(
                DROP_REASONS,
                map(_count_true, (~finite, finite & ~in_range, finite & in_range & ~has_rotation)),
                strict=True,
            )
        )
        usable = finite & in_range & has_rotation
        logs = raw.log_scales[usable].astype(np.float64)
        splats = Splats(
            means=np.ascontiguousarray(raw.means[usable], dtype=np.float32),
            scales=np.exp(np.maximum(logs, -MAX_LOG_SCALE)).astype(np.float32),
            rotations=(raw.rotations[usable] / lengths[usable, None]).astype(np.float32),
            opacities=raw.opacities[usable].astype(np.float32),
            harmonics=np.ascontiguousarray(raw.harmonics[usable], dtype=np.float32),
        )
    return ValidatedSplats(splats, total, dropped, _count_true((logs < -MAX_LOG_SCALE).any(axis=1)))


def _count_true(mask: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))


Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES: dict[str, Axis] = {"x": "x", "y": "y", "z": "z", "-x": "-x", "-y": "-y", "-z": "-z"}


@dataclass(frozen=True)
class UpAxis:
    """The axis of a file's frame that points up, with a sign, and the reason for that guess as a text."""

    axis: Axis
    reason: str

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector of the axis."""
        sign = -1.0 if self.axis.startswith("-") else 1.0
        x, y, z = (sign if name == self.axis[-1] else 0.0 for name in "xyz")
        return x, y, z


@dataclass(frozen=True)
class SplatSource:
    """An opened splat file of any layout, whose header was checked; its splats are read on demand.

    Attributes
    ----------
    count : int
        Number of splats that the file states.
    up : UpAxis
        Axis of the file's frame that points up.
    iter_raw : callable
        Takes a number of splats and yields blocks of up to so many.
    is_complete : bool
        True if the file is known to be as long as its count says.
    """

    count: int
    up: UpAxis
    iter_raw: Callable[[int], Iterator[RawSplats]]
    is_complete: bool = True


# Indices of the three stored components of a quaternion, by the index of the omitted one.
REMAINING_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def complete_rotations(stored: Floats, largest: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return unit quaternions (N, 4) of which three components (N, 3) are stored, in order.

    The omitted component, of index `largest` (N,), is positive.
    """
    rotations = np.empty((len(stored), 4))
    np.put_along_axis(rotations, REMAINING_COMPONENTS[largest], stored, axis=1)
    omitted = np.sqrt(np.maximum(0.0, 1.0 - np.square(stored).sum(axis=1)))
    np.put_along_axis(rotations, largest[:, None], omitted[:, None], axis=1)
    return rotations


def decode_colours(colours: Floats) -> Floats:
    """Return the constant harmonic (N, 3) of display-referred colors (N, 3) in [0, 1]."""
    return np.asarray((colours - 0.5) / C0)


def pad_harmonics(harmonics: Floats, count: int) -> Floats:
    """Return coefficients (N, count, 3): zeros for harmonics that are missing, the highest left out."""
    kept = harmonics[:, :count]
    return np.pad(kept, ((0, 0), (0, count - kept.shape[1]), (0, 0)))
