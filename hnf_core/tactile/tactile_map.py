"""Tactile maps: what a vision-based touch sensor pressed on a patch would show, and how it is known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Route(str, Enum):
    """How a property of a patch came to be known."""

    MEASURED = "measured"
    PREDICTED = "predicted"
    PRIOR = "prior"


class HeightMap(Protocol):
    """What of a tactile map, or of any record of one, a path over it needs; fields as TactileMap has them."""

    @property
    def height(self) -> NDArray[np.float32] | None: ...
    @property
    def metres_per_pixel(self) -> float: ...
    @property
    def resolved_wavelength_m(self) -> float: ...


@dataclass(frozen=True)
class TactileMap:
    """A sensor image in the patch's tangent frame (column → +x tangent, row → −y, i.e. +y points up).

    image: (H, W, 3) float32 linear. height: (H, W) float32 metres above the mean plane, or None where unknown.
    mask: (H, W) bool, True where the patch's own surface was seen. metres_per_pixel: m. sensor: name in
    tactile.optics.SENSORS. resolved_wavelength_m: shortest wavelength the source resolves (two texels); inf where
    nothing is resolved. height_source: where the metres come from, for the report ("bump node 'Bump', distance
    0.001 m").
    """

    image: NDArray[np.float32]
    height: NDArray[np.float32] | None
    mask: NDArray[np.bool_]
    metres_per_pixel: float
    sensor: str
    resolved_wavelength_m: float
    route: Route
    height_source: str = ""
