"""Frames of a drawn touch sensor: a ball pressed at several places, a relief, and the untouched sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from picture_files import image

from hnf_core.tactile.optics import SENSORS, Sensor, render_sensor_image

SHAPE, PIXEL_M, BALL_M = (120, 160), 0.1e-3, 2e-3


def draw_ball(sensor: Sensor, column: float, row: float) -> np.ndarray:
    y, x = np.indices(SHAPE)
    radius = BALL_M / PIXEL_M
    ball = np.sqrt(np.maximum(radius**2 - (x - column) ** 2 - (y - row) ** 2, 0.0)) - 0.75 * radius
    return render_sensor_image(np.maximum(ball, 0.0) * PIXEL_M, PIXEL_M, sensor)


def make_relief(height_m: float = 40e-6) -> np.ndarray:
    """Waves of 3 to 0.3 mm in all directions, as high as they are long."""
    rng, (y, x) = np.random.default_rng(0), np.indices(SHAPE) * PIXEL_M
    lengths = np.geomspace(3e-3, 0.3e-3, 60)
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(lengths)))
    along = x[..., None] * np.cos(angle) + y[..., None] * np.sin(angle)
    waves = np.sum(lengths * np.sin(2.0 * np.pi * along / lengths + phase), axis=-1)
    return height_m * waves / waves.std()


def draw_relief(sensor: Sensor, height_m: float = 40e-6) -> np.ndarray:
    return render_sensor_image(make_relief(height_m), PIXEL_M, sensor)


def write_frame(path: Path, frame: np.ndarray) -> Path:
    image.fromarray(np.rint(255.0 * np.clip(frame, 0.0, 1.0)).astype(np.uint8)).save(path)
    return path


def write_presses(folder: Path, sensor_name: str) -> list[tuple[float, float]]:
    """Pictures of a ball at nine places and of the background; the centres, in the order of the files' names."""
    sensor, centres = SENSORS[sensor_name], [(x, y) for x in (35.0, 80.5, 124.0) for y in (30.0, 60.25, 88.0)]
    folder.mkdir(parents=True, exist_ok=True)
    for number, centre in enumerate(centres):
        write_frame(folder / f"press_{number}.png", draw_ball(sensor, *centre))
    write_frame(folder / "background.png", np.broadcast_to(sensor.background, (*SHAPE, 3)))
    return centres
