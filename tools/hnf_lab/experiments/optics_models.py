"""A ball of known size pressed on a touch sensor: the true normal of every pixel under it, and optics fitted to that.

W. Yuan, S. Dong & E. Adelson (2017), "GelSight: high-resolution robot tactile sensors", Sensors 17(12), calibrate so.
Frame as in tactile.optics: column → +x, row → −y.

The rival: Taxim's table of polynomials, applied, read backwards, and fitted anew (Si & Yuan 2022, section III-B).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.ball_calibration import BallPresses, PolynomialTable
from hnf_core.errors import UsageError
from hnf_core.tactile.optics import SENSORS, Sensor, decode_gradients, shade

Float = NDArray[np.float64]
Form = Literal["frame", "difference", "ratio"]

SATURATION_VALUE = 250.0 / 255.0
"""Code values from here on are clipped, and say nothing of the light."""


@dataclass(frozen=True, eq=False)
class BallPixels:
    """(m, …) pixels under balls. normal: (m, 3) unit. colour, background: (m, 3). column, row: (m,). press: (m,)."""

    normal: Float
    colour: Float
    background: Float
    column: Float
    row: Float
    press: NDArray[np.int64]

    def select(self, wanted: NDArray[np.bool_]) -> BallPixels:
        return BallPixels(*(getattr(self, name)[wanted] for name in self.__dataclass_fields__))

    @property
    def tilt(self) -> Float:
        """(m,) angle between normal and gel, rad."""
        return np.asarray(np.arccos(np.clip(self.normal[:, 2], -1.0, 1.0)))


def find_contact_radius_px(presses: BallPresses) -> float:
    """Where the frames differ most from the background, as the mean over all presses and directions, in whole pixels.

    Under a ball the slope grows outwards; beyond the contact's edge the membrane leaves it and flattens.
    """
    change = np.abs(presses.frames - presses.background).mean(axis=-1)
    distance = np.hypot(*compute_offsets_px(presses))
    rings = [change[(distance >= r - 0.5) & (distance < r + 0.5)] for r in range(1, int(presses.ball_radius_px) + 1)]
    return 1.0 + float(np.argmax([ring.mean() if ring.size else 0.0 for ring in rings]))


def select_pixels_under(presses: BallPresses, radius_px: float) -> BallPixels:
    """Pixels less than radius_px from a ball's centre, press by press. Raises UsageError where the ball is smaller."""
    if not 0.0 < radius_px < presses.ball_radius_px:
        raise UsageError(f"{radius_px:g} pixels are no part of a ball of {presses.ball_radius_px:g}.")
    x, y = compute_offsets_px(presses)
    press, row, column = np.nonzero(np.hypot(x, y) < radius_px)
    flat = np.stack([x[press, row, column], y[press, row, column]], axis=1) / presses.ball_radius_px
    return BallPixels(
        normal=np.concatenate([flat, np.sqrt(1.0 - np.sum(flat**2, axis=1, keepdims=True))], axis=1),
        colour=presses.frames[press, row, column],
        background=presses.background[row, column],
        column=column.astype(np.float64),
        row=row.astype(np.float64),
        press=press,
    )


def compute_offsets_px(presses: BallPresses) -> tuple[Float, Float]:
    """(n, H, W) each: how far a pixel is to the right of a ball's centre, and above it."""
    rows, columns = presses.background.shape[:2]
    x = np.arange(columns)[None, None, :] - presses.centre_px[:, 0, None, None]
    y = presses.centre_px[:, 1, None, None] - np.arange(rows)[None, :, None]
    whole_x, whole_y = np.broadcast_arrays(x, y)
    return whole_x, whole_y


@dataclass(frozen=True)
class LinearOptics:
    """The project's own optics (tactile.optics) with fitted numbers.

    form: what is linear in the normal: the frame itself; its difference from the background, so that ambient light
    may vary over the window; or its ratio to it, so that the lamps' strength may.
    """

    sensor: Sensor
    form: Form

    def predict(self, pixels: BallPixels) -> Float:
        """(m, 3) code values, clipped to 0…1."""
        gx, gy = compute_slopes(pixels.normal)
        light = shade(gx, gy, self.sensor).astype(np.float64)
        return np.asarray(np.clip(_to_frame(light, pixels.background, self.form), 0.0, 1.0))

    def decode(self, pixels: BallPixels) -> Float:
        """(m, 3) unit normals by tactile.optics.decode_gradients."""
        gx, gy = decode_gradients(_to_light(pixels.colour, pixels.background, self.form), self.sensor)
        return np.asarray(np.stack([-gx, -gy, np.ones_like(gx)], axis=-1) / np.sqrt(1.0 + gx**2 + gy**2)[..., None])


def fit_linear_optics(pixels: BallPixels, form: Form) -> LinearOptics:
    """Least squares of light = ambient + S n: twelve numbers. Saturated values are left out, channel by channel.

    Raises UsageError where the normals do not span all directions.
    """
    light = _to_light(pixels.colour, pixels.background, form)
    terms = np.concatenate([pixels.normal, np.ones((len(pixels.normal), 1))], axis=1)
    solved = np.empty((4, 3))
    for channel in range(3):
        good = pixels.colour[:, channel] < SATURATION_VALUE
        solved[:, channel], _, rank, _ = np.linalg.lstsq(terms[good], light[good, channel], rcond=None)
        if rank < 4:
            raise UsageError("the normals under the balls do not tell the lamps apart.")
    return LinearOptics(make_sensor(solved[:3].T, solved[3]), form)


def make_sensor(shading: Float, ambient: Float) -> Sensor:
    """A sensor with this S (3, 3) and ambient light (3,): the nominal GelSight's gel and lamp directions, everything
    that differs in the crosstalk."""
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
    """(∂h/∂x, ∂h/∂y) of surfaces with these unit normals (…, 3)."""
    return -normal[..., 0] / normal[..., 2], -normal[..., 1] / normal[..., 2]


def mount_sensor(sensor: Sensor, angle_rad: float, mirrored: bool, channels: tuple[int, ...]) -> Sensor:
    """The same sensor mounted otherwise: turned in its plane, seen in a mirror, its channels in another order."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    mount = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ np.diag(
        [-1.0 if mirrored else 1.0, 1.0, 1.0]
    )
    order = list(channels)
    out = make_sensor((sensor.shading @ mount)[order], np.asarray(sensor.ambient)[order])
    return replace(out, name=sensor.name)


def _to_light(colour: Float, background: Float, form: Form) -> Float:
    if form == "difference":
        return colour - background
    return colour / np.maximum(background, 1.0 / 255.0) if form == "ratio" else colour


def _to_frame(light: Float, background: Float, form: Form) -> Float:
    if form == "difference":
        return light + background
    return light * np.maximum(background, 1.0 / 255.0) if form == "ratio" else light


ROWS_PER_CHUNK = 256


def predict_polynomial(table: PolynomialTable, pixels: BallPixels) -> Float:
    """(m, 3) code values, clipped to 0…1: background + polynomial of the cell that the normal falls in."""
    return np.asarray(np.clip(pixels.background + compute_polynomial_change(table, pixels), 0.0, 1.0))


def compute_polynomial_change(table: PolynomialTable, pixels: BallPixels) -> Float:
    """(m, 3) what the table adds to the background."""
    tilt, direction = _locate_cells(pixels.normal, len(table.coefficients))
    return np.asarray(np.einsum("mkt,mt->mk", table.coefficients[tilt, direction], _compute_terms(pixels)))


def decode_polynomial(table: PolynomialTable, pixels: BallPixels, steepest_rad: float) -> Float:
    """(m, 3) unit normals: of all cells up to steepest_rad, the one whose colour at that place is nearest."""
    bins = len(table.coefficients)
    tilt, direction = (each.ravel() for each in np.mgrid[:bins, :bins])
    angle, towards = (tilt + 0.5) * _compute_tilt_step(bins), (direction + 0.5) * _compute_direction_step(bins) - np.pi
    known = (angle <= steepest_rad) & (direction < bins - 1)
    tilt, direction, angle, towards = tilt[known], direction[known], angle[known], towards[known]
    # Taxim's direction is the gradient's in the image, rows downwards: the normal's is its negative.
    normal = np.stack([-np.sin(angle) * np.cos(towards), np.sin(angle) * np.sin(towards), np.cos(angle)], axis=1)
    cells, terms, seen = table.coefficients[tilt, direction], _compute_terms(pixels), pixels.colour - pixels.background
    out = np.empty_like(pixels.normal)
    for start in range(0, len(terms), ROWS_PER_CHUNK):
        here = slice(start, start + ROWS_PER_CHUNK)
        colours = np.tensordot(terms[here], cells, axes=(1, 2))
        out[here] = normal[np.argmin(np.sum((colours - seen[here, None]) ** 2, axis=2), axis=1)]
    return out


def fit_polynomial_table(pixels: BallPixels, bins: int) -> PolynomialTable:
    """Taxim's calibration: each press fills the table by its nearest cell; each cell is fitted over the presses."""
    places, changes = [], []
    rows, columns = np.mgrid[:bins, :bins]
    grid = np.stack([rows.ravel(), columns.ravel()], axis=1).astype(np.float64)
    for press in np.unique(pixels.press):
        own = pixels.select(pixels.press == press)
        cells = np.stack(_locate_cells(own.normal, bins), axis=1).astype(np.float64)
        nearest = np.concatenate(
            [_find_nearest_cells(grid[at : at + ROWS_PER_CHUNK], cells) for at in range(0, len(grid), ROWS_PER_CHUNK)]
        )
        places.append(_compute_terms(own)[nearest])
        changes.append((own.colour - own.background)[nearest])
    terms, seen = np.stack(places, axis=1), np.stack(changes, axis=1)
    scale = np.maximum(np.abs(terms).max(axis=(0, 1)), 1.0)
    solved = np.linalg.pinv(terms / scale) @ seen / scale[:, None]
    return PolynomialTable(np.moveaxis(solved.reshape(bins, bins, 6, 3), 2, 3))


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
