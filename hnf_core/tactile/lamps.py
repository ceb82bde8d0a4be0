"""Sensors of one make differ: the same gel under other lamps, so that no network learns one lamp's colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .optics import Sensor

AZIMUTH_SCATTER_DEG = 8.0
ELEVATION_SCATTER_DEG = (-3.0, 6.0)
INTENSITY_SCATTER = 0.15
CROSSTALK_SCATTER = 0.05
AMBIENT_SCATTER = 0.03
"""Half-widths of uniform scatter. Elevation leans upwards: lower lamps would leave the steepest slopes dark."""


def perturb_sensor(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """Another piece of the same sensor: lamps turned and lifted, brighter or darker, more or less cross-talk and
    ambient light. Its gel (sigma, slope limit) and name stay, and every lamp reaches the slope limit still."""
    lowest = float(np.degrees(np.arctan(sensor.max_slope))) + 0.5
    off_diagonal = 1.0 - np.eye(3)
    scatter = rng.uniform(-CROSSTALK_SCATTER, CROSSTALK_SCATTER, (3, 3)) * off_diagonal
    crosstalk = np.clip(np.asarray(sensor.crosstalk) + scatter, 0.0, None)
    return replace(
        sensor,
        azimuth_deg=_to_triple(
            np.asarray(sensor.azimuth_deg) + rng.uniform(-AZIMUTH_SCATTER_DEG, AZIMUTH_SCATTER_DEG, 3)
        ),
        elevation_deg=max(lowest, sensor.elevation_deg + float(rng.uniform(*ELEVATION_SCATTER_DEG))),
        intensity=_to_triple(
            np.asarray(sensor.intensity) * (1.0 + rng.uniform(-INTENSITY_SCATTER, INTENSITY_SCATTER, 3))
        ),
        crosstalk=tuple(_to_triple(row) for row in crosstalk),
        ambient=_to_triple(
            np.clip(np.asarray(sensor.ambient) + rng.uniform(-AMBIENT_SCATTER, AMBIENT_SCATTER, 3), 0.0, None)
        ),
    )


def _to_triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
