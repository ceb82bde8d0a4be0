"""Units as data files write them → factor into SI; and which numbers can be a measurement at all."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..units import STANDARD_GRAVITY

_UNIT_FACTORS = {
    "acceleration": {
        "m/s2": 1.0, "m/s/s": 1.0, "ms-2": 1.0, "mm/s2": 1e-3, "g": STANDARD_GRAVITY, "g0": STANDARD_GRAVITY,
        "mg": 1e-3 * STANDARD_GRAVITY, "gravity": STANDARD_GRAVITY,
    },
    "speed": {"m/s": 1.0, "ms-1": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "in/s": 25.4e-3},
    "force": {
        "n": 1.0, "newton": 1.0, "newtons": 1.0, "mn": 1e-3, "gf": 1e-3 * STANDARD_GRAVITY, "kgf": STANDARD_GRAVITY,
    },
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 25.4e-3},
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6},
    "rate": {"hz": 1.0, "khz": 1e3, "samples/s": 1.0},
}  # fmt: skip

MAX_MEASURABLE = 1e12
"""No sensor of touch gives such a number, in whatever unit; its square would overflow."""


def is_measurable(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Finite and below BEYOND, element by element."""
    return np.abs(values) < MAX_MEASURABLE  # False for NaN


def parse_unit_factor(quantity: str, written: str, where: str) -> float:
    """What a number in the written unit is multiplied by to be SI; case, blanks, ^ and brackets do not count.

    quantity: acceleration, speed, force, position, time or rate. Raises FileError for a unit that is not one of these.
    """
    known = _UNIT_FACTORS[quantity]
    plain = re.sub(r"[\s^*\[\](){}·]", "", written.replace("²", "2").replace("µ", "u").replace("μ", "u")).lower()
    if plain not in known:
        raise FileError(
            f"{written.strip()!r} is no unit of {quantity} known here.",
            where=where,
            remedy=f"Known are {', '.join(known)}.",
        )
    return known[plain]
