"""The tactile map of a surface patch: the image that a vision-based touch sensor would give, its height and origin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Route(str, Enum):
    """Origin of a property of a patch: measured relief, prediction from an image, or a library material as prior.

    LEARNED is only said of materials with a field of their own, for which none of these counts.
    """

    MEASURED = "measured"
    PREDICTED = "predicted"
    PRIOR = "prior"
    LEARNED = "learned"


class HeightMap(Protocol):
    """Interface of the part of a `TactileMap` that height sampling needs: height, pixel size, resolved wavelength."""

    @property
    def height(self) -> NDArray[np.float32] | None: ...
    @property
    def metres_per_pixel(self) -> float: ...
    @property
    def resolved_wavelength_m(self) -> float: ...


@dataclass(frozen=True)
class TactileMap:
    """An image that a touch sensor would give, in the patch's tangent frame (column → +x, row → −y, so +y points up).

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
        Origin of the map: measured or predicted.
    height_source : str
        Text for the report that tells where the height scale comes from ("bump node 'Bump', distance 0.001 m").
    """

    image: NDArray[np.float32]
    height: NDArray[np.float32] | None
    mask: NDArray[np.bool_]
    metres_per_pixel: float
    sensor: str
    resolved_wavelength_m: float
    route: Route
    height_source: str = ""
