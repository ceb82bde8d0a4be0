"""What a ranking of materials says of mechanics, which no picture shows: a mean over the library, with its spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from .material import LibraryMaterial
from .prior import Suggestion

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PropertyEstimate:
    """value: geometric mean, so that a stiffness of 10³ and one of 10⁵ N/m meet at 10⁴. factor: one standard deviation,
    as a factor ≥ 1 to either side: how far the likely materials, and pieces of each, lie apart."""

    value: float
    factor: float


def get_probabilities(library: Sequence[LibraryMaterial], ranked: Sequence[Suggestion]) -> dict[str, float]:
    """Name → probability of every material that is ranked. Raises MaterialError where the library lacks one."""
    known = {material.name for material in library}
    missing = [each.name for each in ranked if each.name not in known]
    if missing:
        raise MaterialError(f"the ranking names materials that the library does not hold: {', '.join(missing)}.")
    return {each.name: each.probability for each in ranked}


def estimate_property(
    library: Sequence[LibraryMaterial], weights: Mapping[str, float], field: str, spread_within: float
) -> PropertyEstimate:
    """A mechanical property (a field of Mechanics) over the likely materials.

    weights: name → probability; need not sum to 1. within: standard deviation of the natural logarithm between pieces
    of one material. Materials that do not know the property, or have none of it, do not count: it has no logarithm.
    Raises MaterialError where none is left.
    """
    values, shares = [], []
    for material in library:
        value, share = getattr(material.mechanics, field), weights.get(material.name, 0.0)
        if value is not None and value > 0.0 and share > 0.0:
            values.append(float(np.log(value)))
            shares.append(share)
    if not values:
        raise MaterialError(f"no likely material knows its {field}.", remedy="Choose a material of the library.")
    logs, share = np.array(values), np.array(shares) / np.sum(shares)
    mean = float(share @ logs)
    between = float(share @ (logs - mean) ** 2)
    return PropertyEstimate(float(np.exp(mean)), float(np.exp(np.sqrt(between + spread_within**2))))
