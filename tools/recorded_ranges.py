"""What recorded textures feel like: HaTT's ranges per category, from the published AR models of its 100 textures.

H. Culbertson et al. 2014, "One hundred data-driven haptic texture models and open-source methods for rendering on 3D
objects", IEEE Haptics Symposium.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.simulation.feel import TextureStatistics

Range = tuple[float, float]


@dataclass(frozen=True)
class CategoryRanges:
    """One category: textures, medians, and 5–95 % ranges (of RMS: the whole range). RMS [m/s²] and centroid [Hz] at
    100 mm/s, 1 N. f_exponent is one number, no range, for carbon fibre."""

    count: int
    rms_median: float
    rms: Range
    centroid_median: float
    centroid_hz: Range
    below_1k: Range
    v_exponent: Range
    f_exponent: Range | None


HATT_RANGES = {
    "Carbon fibre": CategoryRanges(2, 1.78, (1.57, 2.00), 271, (241, 301), (0.98, 0.99), (1.31, 1.48), None),
    "Carpet": CategoryRanges(5, 2.86, (2.05, 6.84), 61, (50, 117), (0.99, 1.00), (0.02, 1.64), (0.32, 0.85)),
    "Fabric": CategoryRanges(30, 0.55, (0.24, 3.44), 256, (67, 754), (0.72, 1.00), (0.51, 1.55), (-0.11, 0.83)),
    "Foam": CategoryRanges(6, 0.97, (0.71, 1.47), 187, (73, 319), (0.96, 0.99), (0.42, 0.95), (0.15, 0.31)),
    "Metal": CategoryRanges(6, 1.71, (0.38, 6.24), 466, (234, 695), (0.89, 0.99), (0.06, 0.97), (-0.40, 0.62)),
    "Paper": CategoryRanges(22, 0.79, (0.33, 7.51), 261, (149, 601), (0.87, 1.00), (0.29, 1.37), (-0.07, 0.89)),
    "Plastic": CategoryRanges(10, 0.98, (0.22, 3.30), 209, (137, 771), (0.72, 1.00), (0.73, 1.36), (-0.14, 0.57)),
    "Stone": CategoryRanges(7, 5.29, (1.05, 13.8), 513, (407, 579), (0.85, 0.98), (0.50, 1.31), (-0.37, 0.27)),
    "Tile": CategoryRanges(7, 1.68, (0.69, 4.14), 169, (131, 196), (0.97, 1.00), (0.70, 1.36), (0.10, 0.56)),
    "Wood": CategoryRanges(5, 0.79, (0.49, 1.47), 282, (144, 345), (0.95, 0.99), (0.55, 1.49), (0.05, 0.49)),
}
PUBLISHED_DECIMALS = {"rms": 2, "centroid_hz": 0, "below_1k": 2, "v_exponent": 2, "f_exponent": 2}
"""Decimals to which the ranges are published: a value counts as inside when it is so after the same rounding."""


NOISE_FLOOR_M_S2_PER_ROOT_HZ = 0.9e-3
LINE_HZ = 1915.0
LINE_RMS_M_S2 = 0.107
"""What HaTT's instrument adds. Above 1.3 kHz eleven soft textures of twenty at hand (silk, velvet, cork, foam, …) have
one and the same spectrum, at 50, 100 and 150 mm/s alike: a flat floor and a line, together 0.115–0.126 m/s² (medians).
No contact does that. In silk it is a tenth of the power, and it is what keeps foam's share below 1 kHz under 1."""


def compute_instrument_noise(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power density [(m/s²)²/Hz] of that noise; the line 20 Hz wide."""
    width = 20.0
    line = LINE_RMS_M_S2**2 / (width * np.sqrt(np.pi)) * np.exp(-np.square((frequency_hz - LINE_HZ) / width))
    return np.asarray(NOISE_FLOOR_M_S2_PER_ROOT_HZ**2 + line)


def check_ranges(statistics: TextureStatistics, category: str) -> dict[str, bool]:
    """For each number that the category has a range of: does it lie inside? Empty for a category never recorded."""
    if category not in HATT_RANGES:
        return {}
    found = {}
    for name, digits in PUBLISHED_DECIMALS.items():
        limits = getattr(HATT_RANGES[category], name)
        if limits is not None:
            found[name] = limits[0] <= round(getattr(statistics, name), digits) <= limits[1]
    return found
