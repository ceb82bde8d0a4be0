"""Scale of a reconstruction in metres per unit, from one known length: images alone do not determine it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import UsageError

if TYPE_CHECKING:  # keeps the add-on's registration fast
    from numpy.typing import ArrayLike

MIN_LENGTH_M, MAX_LENGTH_M = 1e-4, 1e4
"""Accepted known lengths [m]."""
MIN_METRES_PER_UNIT, MAX_METRES_PER_UNIT = 1e-6, 1e6
"""Accepted scales [m per unit]."""


def compute_metric_scale(point_a: ArrayLike, point_b: ArrayLike, length_m: float) -> float:
    """Compute the metres per unit from two points and their distance.

    Parameters
    ----------
    point_a, point_b : array_like, shape (3,)
        Two points in units of the reconstruction.
    length_m : float
        Distance between them [m].

    Returns
    -------
    float
        Length of a unit [m].

    Raises
    ------
    UsageError
        If a point has not three finite numbers, the points coincide, or the length or the scale is out of range.
    """
    a, b = (np.asarray(point, dtype=np.float64) for point in (point_a, point_b))
    if a.shape != (3,) or b.shape != (3,) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise UsageError("a point is not three finite numbers.", remedy="Give x, y and z of both points.")
    if not MIN_LENGTH_M <= length_m <= MAX_LENGTH_M:
        raise UsageError(
            f"{length_m} m is no length to measure with.",
            remedy="Give the metres between the two points, from 0.1 mm to 10 km.",
        )
    units = float(np.linalg.norm(b / 2.0 - a / 2.0) * 2.0)
    spread = float(max(np.abs(a).max(), np.abs(b).max()))
    if units <= 1e-6 * spread or units == 0.0:
        raise UsageError("both points are the same.", remedy="Choose two points that lie apart.")
    scale = length_m / units
    if not MIN_METRES_PER_UNIT <= scale <= MAX_METRES_PER_UNIT:
        raise UsageError(
            f"a unit would be {scale:.3g} m.",
            remedy="Check the length and both points: they should be on the object, and the length in metres.",
        )
    return float(scale)
