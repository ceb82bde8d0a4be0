"""Optics models fitted to ball presses: the project's linear model, and Taxim's polynomial table.

Frame as in hnf_core.tactile.optics: column → +x, row → −y. The polynomial table (Si & Yuan 2022, section III-B) is
read, applied, inverted and fitted. polycalib.npz: bins, grad_r, grad_g, grad_b (bins, bins, 6), in the order blue,
green, red despite their names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.ball_calibration import REMEDY, BallPixels, read_npz_arrays
from hnf_core.errors import FileError, UsageError
from hnf_core.tactile.optics import SENSORS, Sensor, decode_gradients, shade
from hnf_core.tactile.photometric_stereo import SATURATION_VALUE

Float = NDArray[np.float64]
Form = Literal["frame", "difference", "ratio"]

PIXEL_PITCH_M = {"objectfolder": 0.1245e-3, "taxim": 0.0295e-3}
"""Pixel pitch by data set [m]."""


@dataclass(frozen=True)
class LinearOptics:
    """The project's own optics (hnf_core.tactile.optics) with fitted parameters.

    form: quantity that is linear in the normal. "frame": the frame itself. "difference": frame − background, so ambient
    light may vary over the window. "ratio": frame / background, so the lamps' strength may vary.
    """

    sensor: Sensor
    form: Form

    def predict(self, pixels: BallPixels) -> Float:
        """Return (m, 3) code values, clipped to 0…1."""
        gx, gy = compute_slopes(pixels.normal)
        light = shade(gx, gy, self.sensor).astype(np.float64)
        return np.asarray(np.clip(_to_frame(light, pixels.background, self.form), 0.0, 1.0))

    def decode(self, pixels: BallPixels) -> Float:
        """Return (m, 3) unit normals by hnf_core.tactile.optics.decode_gradients."""
        gx, gy = decode_gradients(_to_light(pixels.colour, pixels.background, self.form), self.sensor)
        return np.asarray(np.stack([-gx, -gy, np.ones_like(gx)], axis=-1) / np.sqrt(1.0 + gx**2 + gy**2)[..., None])


def fit_linear_optics(pixels: BallPixels, form: Form) -> LinearOptics:
    """Fit light = ambient + S n by least squares, twelve parameters; saturated values are excluded per channel.

    Raises
    ------
    UsageError
        If the normals do not span all directions.
    """
    light = _to_light(pixels.colour, pixels.background, form)
    terms = np.concatenate([pixels.normal, np.ones((len(pixels.normal), 1))], axis=1)
    solution = np.empty((4, 3))
    for channel in range(3):
        valid = pixels.colour[:, channel] < SATURATION_VALUE
        solution[:, channel], _, rank, _ = np.linalg.lstsq(terms[valid], light[valid, channel], rcond=None)
        if rank < 4:
            raise UsageError("the normals under the balls do not tell the lamps apart.")
    return LinearOptics(make_sensor(solution[:3].T, solution[3]), form)


def make_sensor(shading: Float, ambient: Float) -> Sensor:
    """Make a sensor with this S (3, 3) and ambient light (3,).

    Gel and lamp directions are the nominal GelSight's; all differences are in the crosstalk.
    """
    nominal = SENSORS["gelsight"]
    lamps = np.linalg.solve(np.asarray(nominal.crosstalk) * np.asarray(nominal.intensity), nominal.shading)
    crosstalk = shading @ np.linalg.inv(lamps)
    return replace(
        nominal,
        name="fitted",
        intensity=(1.0, 1.0, 1.0),
        crosstalk=tuple(map(tuple, crosstalk)),
        ambient=tuple(ambient),
    )


def compute_slopes(normal: Float) -> tuple[Float, Float]:
    """Return (∂h/∂x, ∂h/∂y) of surfaces with these unit normals (…, 3)."""
    return -normal[..., 0] / normal[..., 2], -normal[..., 1] / normal[..., 2]


def mount_sensor(sensor: Sensor, angle_rad: float, mirrored: bool, channels: tuple[int, ...]) -> Sensor:
    """Return the sensor rotated in its plane, mirrored, and with reordered channels."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    mount = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ np.diag(
        [-1.0 if mirrored else 1.0, 1.0, 1.0]
    )
    order = list(channels)
    mounted = make_sensor((sensor.shading @ mount)[order], np.asarray(sensor.ambient)[order])
    return replace(mounted, name=sensor.name)


def _to_light(colour: Float, background: Float, form: Form) -> Float:
    if form == "difference":
        return colour - background
    return colour / np.maximum(background, 1.0 / 255.0) if form == "ratio" else colour


def _to_frame(light: Float, background: Float, form: Form) -> Float:
    if form == "difference":
        return light + background
    return light * np.maximum(background, 1.0 / 255.0) if form == "ratio" else light


ROWS_PER_CHUNK = 256


@dataclass(frozen=True, eq=False)
class PolynomialTable:
    """Taxim's optics: change of colour against the background by the membrane's normal, as polynomials of the position.

    Attributes
    ----------
    coefficients : ndarray, shape (bins, bins, 3, 6)
        By the normal's tilt (0 to π/2) and direction (−π to π), for red, green, blue: coefficients of x², y², xy, x, y
        and 1 [pixels], in code values / 255.
    """

    coefficients: Float


def read_polynomial_table(path: Path) -> PolynomialTable:
    """Read the colour table from a polycalib.npz, without pickle; raise FileError if it cannot be used."""
    names = ("grad_r", "grad_g", "grad_b")
    channels = list(read_npz_arrays(path, names).values())
    shape = channels[0].shape
    if len(shape) != 3 or shape[0] != shape[1] or shape[2] != 6 or any(channel.shape != shape for channel in channels):
        raise FileError(
            f"{', '.join(names)} are {[channel.shape for channel in channels]}.", where=str(path), remedy=REMEDY
        )
    values = np.stack(channels[::-1], axis=2).astype(np.float64)
    if not np.isfinite(values).all():
        raise FileError("a coefficient is not finite.", where=str(path), remedy=REMEDY)
    return PolynomialTable(values / 255.0)


def predict_polynomial(table: PolynomialTable, pixels: BallPixels) -> Float:
    """Return (m, 3) code values, clipped to 0…1: background plus the polynomial of the normal's cell."""
    return np.asarray(np.clip(pixels.background + compute_polynomial_change(table, pixels), 0.0, 1.0))


def compute_polynomial_change(table: PolynomialTable, pixels: BallPixels) -> Float:
    """Return the (m, 3) change that the table adds to the background."""
    tilt, direction = _locate_cells(pixels.normal, len(table.coefficients))
    return np.asarray(np.einsum("mkt,mt->mk", table.coefficients[tilt, direction], _compute_terms(pixels)))


def decode_polynomial(table: PolynomialTable, pixels: BallPixels, steepest_rad: float) -> Float:
    """Return (m, 3) unit normals: the cell up to steepest_rad whose colour at that position is nearest."""
    bins = len(table.coefficients)
    tilt, direction = (index.ravel() for index in np.mgrid[:bins, :bins])
    angle, azimuth = (tilt + 0.5) * _compute_tilt_step(bins), (direction + 0.5) * _compute_direction_step(bins) - np.pi
    known = (angle <= steepest_rad) & (direction < bins - 1)
    tilt, direction, angle, azimuth = tilt[known], direction[known], angle[known], azimuth[known]
    # Taxim's direction is the gradient's in the image, rows downwards: the normal's is its negative.
    normal = np.stack([-np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
    cells, terms, observed = (
        table.coefficients[tilt, direction],
        _compute_terms(pixels),
        pixels.colour - pixels.background,
    )
    normals = np.empty_like(pixels.normal)
    for start in range(0, len(terms), ROWS_PER_CHUNK):
        rows = slice(start, start + ROWS_PER_CHUNK)
        colours = np.tensordot(terms[rows], cells, axes=(1, 2))
        normals[rows] = normal[np.argmin(np.sum((colours - observed[rows, None]) ** 2, axis=2), axis=1)]
    return normals


def fit_polynomial_table(pixels: BallPixels, bins: int) -> PolynomialTable:
    """Fit a table as Taxim does: each press fills it by nearest cells; each cell is fitted over presses."""
    term_sets, changes = [], []
    rows, columns = np.mgrid[:bins, :bins]
    grid = np.stack([rows.ravel(), columns.ravel()], axis=1).astype(np.float64)
    for press in np.unique(pixels.press):
        press_pixels = pixels.select(pixels.press == press)
        cells = np.stack(_locate_cells(press_pixels.normal, bins), axis=1).astype(np.float64)
        nearest = np.concatenate(
            [
                _find_nearest_cells(grid[start : start + ROWS_PER_CHUNK], cells)
                for start in range(0, len(grid), ROWS_PER_CHUNK)
            ]
        )
        term_sets.append(_compute_terms(press_pixels)[nearest])
        changes.append((press_pixels.colour - press_pixels.background)[nearest])
    terms, observed = np.stack(term_sets, axis=1), np.stack(changes, axis=1)
    scale = np.maximum(np.abs(terms).max(axis=(0, 1)), 1.0)
    solution = np.linalg.pinv(terms / scale) @ observed / scale[:, None]
    return PolynomialTable(np.moveaxis(solution.reshape(bins, bins, 6, 3), 2, 3))


def _find_nearest_cells(cells: Float, known: Float) -> NDArray[np.int64]:
    return np.asarray(np.argmin(np.sum((cells[:, None] - known) ** 2, axis=2), axis=1))


def _locate_cells(normal: Float, bins: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    tilt = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    towards = np.arctan2(normal[:, 1], -normal[:, 0])
    return (tilt / _compute_tilt_step(bins)).astype(np.int64), (
        (towards + np.pi) / _compute_direction_step(bins)
    ).astype(np.int64)


def _compute_tilt_step(bins: int) -> float:
    return 0.5 * np.pi / (bins - 1)


def _compute_direction_step(bins: int) -> float:
    return 2.0 * np.pi / (bins - 1)


def _compute_terms(pixels: BallPixels) -> Float:
    x, y = pixels.column, pixels.row
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1)
