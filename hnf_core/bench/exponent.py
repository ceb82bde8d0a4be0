"""How cost grows with size: the exponent p of cost ∝ sizeᵖ."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from .frame import Spread

FITTED_DECADES = 2.0
"""The upper part of a curve that is fitted: below it what a size costs is hidden in what everything costs."""


def fit_exponent(sizes: Sequence[float], costs: Sequence[float]) -> Spread | None:
    """The slopes log cost over log size between all pairs of sizes in the upper decades: their median is the fit.

    H. Theil, "A rank-invariant method of linear and polynomial regression analysis", 1950; P. K. Sen, "Estimates of the
    regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968. sizes, costs: positive; a size may
    come again. None where there are no two sizes.
    """
    if not sizes:
        return None
    least = max(sizes) / 10.0**FITTED_DECADES * (1.0 - 1e-9)
    upper = [(math.log(size), math.log(cost)) for size, cost in zip(sizes, costs, strict=True) if size >= least]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.combinations(upper, 2) if a[0] != b[0]]
    return Spread.from_values(slopes) if slopes else None
