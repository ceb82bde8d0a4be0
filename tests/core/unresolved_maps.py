"""The map of a patch of which no texture says anything."""

from __future__ import annotations

import numpy as np

from hnf_core.tactile.optics import get_sensor
from hnf_core.tactile.tactile_map import Route, TactileMap


def unresolved_tactile_map(shape: tuple[int, int], metres_per_pixel: float, sensor: str = "gelsight") -> TactileMap:
    """Background colour, no height, nothing resolved, prior route."""
    image = np.broadcast_to(get_sensor(sensor).background.astype(np.float32), (*shape, 3)).copy()
    return TactileMap(image, None, np.ones(shape, dtype=bool), metres_per_pixel, sensor, float("inf"), Route.PRIOR, "")
