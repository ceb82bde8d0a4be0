"""Compiled: the noise of linear contact, and rows read between rows (the twins in numpy are in field/linear_contact.py
and field/adaptive.py)."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .library import address

Float = NDArray[np.float64]
Integers = NDArray[np.int64]

TOUCH = ("speed", "radius", "stiffness", "damping", "mass", "load_square", "rubbed", "flank")
"""Columns of what is known of each state, as in hnf_kernel.h."""


class Noise(NamedTuple):
    """(n, K) each: power of all axes and of the normal one, squared share of a ripple that the tip and its spots pass
    on, and what makes acceleration power of a height up and of a slope aside."""

    power: Float
    normal: Float
    passed: Float
    leaned: Float
    up: Float
    aside: Float


def contact_noise(
    kernel: ctypes.CDLL, touch: Float, kappa: Float, height: Float, density: Float, token_band: Integers,
    shifts: Integers, hand: tuple[float, float],
) -> Noise:  # fmt: skip
    """touch: (n, 8) columns TOUCH. height: (n, K) m² at wavenumbers kappa (K,). density: (A, n, T) of what stands at
    each angle; token_band: (K,) which of the T columns. shifts: (A,) bands by which the cut moves a wave. hand:
    stiffness over mass, and 4 ζ² times it. Raises ValueError where shapes do not fit."""
    angles, states, token_bands = density.shape
    bands = len(kappa)
    fits = touch.shape == (states, len(TOUCH)) and height.shape == (states, bands) and len(shifts) == angles
    if not fits or len(token_band) != bands or not 0 <= token_band.min() <= token_band.max() < token_bands:
        raise ValueError(f"contact of {touch.shape} states with {height.shape} heights and {density.shape} densities")
    height, density = np.ascontiguousarray(height), np.ascontiguousarray(density)
    found = Noise(*(np.empty((states, bands)) for _ in Noise._fields))
    scratch, out = np.empty(3 * bands), (ctypes.c_void_p * len(found))(*(address(each, np.float64) for each in found))
    kernel.hnf_linear_contact(
        address(touch, np.float64), states, address(kappa, np.float64), bands, address(height, np.float64),
        address(density, np.float64), token_bands, address(token_band, np.int64), address(shifts, np.int64), angles,
        *hand, address(scratch, np.float64), out,
    )  # fmt: skip
    return found


def add_rows(kernel: ctypes.CDLL, values: Float, row: Integers, share: Float, factor: Float, out: Float) -> None:
    """out (n, K) += factor (n,) times what lies share (n,) of the way from row (n,) of values (m, K) to the next.

    Raises ValueError where there is no such row.
    """
    count, width = out.shape
    if values.shape[1] != width or not len(row) == len(share) == len(factor) == count:
        raise ValueError(f"{len(row)} rows of {values.shape} into {out.shape}")
    if count and not 0 <= row.min() <= row.max() <= len(values) - 2:
        raise ValueError(f"rows {row.min()} to {row.max() + 1} of {len(values)}")
    kernel.hnf_add_rows(
        address(values, np.float64), width, address(row, np.int64), address(share, np.float64),
        address(factor, np.float64), count, address(out, np.float64),
    )  # fmt: skip
