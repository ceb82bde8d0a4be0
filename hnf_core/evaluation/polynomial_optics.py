"""The rival: Taxim's table of polynomials, applied, read backwards, and fitted anew (Si & Yuan 2022, section III-B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..datasets.ball_calibration import PolynomialTable
from .ball_press import BallPixels

Float = NDArray[np.float64]

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
