"""How long a unit of a reconstruction is: nothing in its pictures says so, but an artist knows one length in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import UsageError

if TYPE_CHECKING:  # the add-on is switched on without it
    from numpy.typing import ArrayLike

MIN_LENGTH_M, MAX_LENGTH_M = 1e-4, 1e4
"""Of a length that can be told: 0.1 mm to 10 km."""
MIN_METRES_PER_UNIT, MAX_METRES_PER_UNIT = 1e-6, 1e6
"""Metres per unit that make sense."""


def compute_metric_scale(point_a: ArrayLike, point_b: ArrayLike, length_m: float) -> float:
    """Metres per unit, from two points in units and the metres that lie between them.

    Raises UsageError where a point has not three finite numbers, both points are the same, the length is not one from
    SHORTEST_M to LONGEST_M, or the scale not one from SMALLEST to LARGEST.
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
