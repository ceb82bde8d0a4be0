"""The tactile map of a patch: the image that a vision-based touch sensor would give, its height and its route."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Route(str, Enum):
    """Origin of a property of a patch."""

    MEASURED = "measured"
    PREDICTED = "predicted"
    PRIOR = "prior"


class HeightMap(Protocol):
    """Part of a tactile map, or of a stored one, that height sampling needs; fields as in `TactileMap`."""

    @property
    def height(self) -> NDArray[np.float32] | None: ...
    @property
    def metres_per_pixel(self) -> float: ...
    @property
    def resolved_wavelength_m(self) -> float: ...


@dataclass(frozen=True)
class TactileMap:
    """A sensor image in the patch's tangent frame (column → +x tangent, row → −y, so that +y points up).

    Attributes
    ----------
    image : ndarray of float32, shape (H, W, 3)
        Linear sensor image.
    height : ndarray of float32, shape (H, W), or None
        Height above the mean plane [m]; None if unknown.
    mask : ndarray of bool, shape (H, W)
        True where the patch's own surface is visible.
    metres_per_pixel : float
        Pixel size [m].
    sensor : str
        Name in `optics.SENSORS`.
    resolved_wavelength_m : float
        Shortest wavelength that the source resolves, two texels [m]; inf if nothing is resolved.
    route : Route
        Origin of the map.
    height_source : str
        Origin of the metres, for the report ("bump node 'Bump', distance 0.001 m").
    """

    image: NDArray[np.float32]
    height: NDArray[np.float32] | None
    mask: NDArray[np.bool_]
    metres_per_pixel: float
    sensor: str
    resolved_wavelength_m: float
    route: Route
    height_source: str = ""
