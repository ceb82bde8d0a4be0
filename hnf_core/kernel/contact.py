"""Compiled: linear contact, and rows read between rows (the twins in numpy are in field/linear_contact.py
and field/adaptive.py)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .library import get_address, pack_pointers

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

CONTACT_COLUMNS = ("angle", "speed", "radius", "stiffness", "damping", "mass", "load_square", "rubbed", "flank")
"""Columns of what is known of each state, as in hnf_kernel.h. load_square: (F / m)² [m²/s⁴]; rubbed: 1 + μ²; flank:
(1 + FLANK_FRICTION · (1 − a / R)²)² − 1, a the contact's radius and R the tip's."""
TOKEN_FEATURES = ("level", "peak", "offset", "cos2", "sin2", "cos4", "sin4")
"""Of a token's bands, that are asked for."""


_TABLE_COUNTS = ("bands", "token_bands", "features", "angles")
_TABLE_ARRAYS = ("kappa", "below", "share", "nearest_end", "wavelength", "turn", "shift")
_SIMD_WIDTH = 4
"""Numbers at once, as in contact.c."""
_TABLE_NUMBERS = ("per_octave", "concentration", "bump_mean", "least_left", "hand", "hand_damping")


class _TablesStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in (*_TABLE_COUNTS, *TOKEN_FEATURES)),
        *((name, ctypes.c_void_p) for name in _TABLE_ARRAYS),
        *((name, ctypes.c_double) for name in _TABLE_NUMBERS),
    )


class ContactTables:
    """What no state changes, as hnf_tables in hnf_kernel.h; its arrays stay where they are.

    features: names of a band's features in a token, in order. kappa, below, share: (K,); wavelength, nearest_end: (T,);
    turn: (A, 4); shift: (A,); scalars by their names. Raises ValueError where they do not fit together.
    """

    def __init__(
        self, *, features: Sequence[str], kappa: Float, share: Float, wavelength: Float, turn: Float, below: Integers,
        nearest_end: Integers, shift: Integers, **numbers: float,
    ) -> None:  # fmt: skip
        self.bands, self.token_bands, self.angles = len(kappa), len(wavelength), len(shift)
        inside = below.min() >= 0 and below.max() < self.token_bands - 1
        inside &= shift.min() >= 0 and nearest_end.max() == self.bands and len(nearest_end) == self.token_bands
        if not (inside and len(share) == len(below) == self.bands and turn.shape == (len(shift), 4)):
            raise ValueError(f"tables of {self.bands} bands, {self.token_bands} of a token and {self.angles} angles")
        self.token_size = self.token_bands * len(features)
        row = self.bands + int(shift.max()) + _SIMD_WIDTH
        self.scratch_size = 6 * self.bands + 21 * (self.token_bands + _SIMD_WIDTH - 1) + (3 + self.angles) * row
        self._arrays = [
            np.ascontiguousarray(array, dtype=np.float64 if array.dtype.kind == "f" else np.int64)
            for array in (kappa, below, share, nearest_end, wavelength, turn, shift)
        ]
        self.struct = _TablesStruct(
            self.bands, self.token_bands, len(features), self.angles, *(list(features).index(n) for n in TOKEN_FEATURES),
            *(each.__array_interface__["data"][0] for each in self._arrays), *(numbers[name] for name in _TABLE_NUMBERS),
        )  # fmt: skip


class ContactArrays(NamedTuple):
    """As field.linear_contact.LinearContact: power, noise (n, K); normal (n,); lines (2, n, 2T) and low (n, 2T)."""

    power: Float
    noise: Float
    normal: Float
    lines: Float
    low: Integers


def compute_linear_contact(kernel: ctypes.CDLL, tables: ContactTables, tokens: Float, touch: Float) -> ContactArrays:
    """tokens: (n, at least T · features). touch: (n, 9) columns TOUCH. Raises ValueError where shapes do not fit."""
    states, lines = len(tokens), 2 * tables.token_bands
    if touch.shape != (states, len(CONTACT_COLUMNS)) or tokens.shape[1] < tables.token_size:
        raise ValueError(f"contact of {touch.shape} states with tokens of {tokens.shape}")
    found = ContactArrays(
        np.empty((states, tables.bands)), np.empty((states, tables.bands)), np.empty(states),
        np.empty((2, states, lines)), np.empty((states, lines), dtype=np.int64),
    )  # fmt: skip
    scratch = np.empty(tables.scratch_size)
    out = pack_pointers([each.__array_interface__["data"][0] for each in found])
    kernel.hnf_linear_contact(
        ctypes.byref(tables.struct), get_address(tokens, np.float64), tokens.shape[1], get_address(touch, np.float64), states,
        get_address(scratch, np.float64), out,
    )  # fmt: skip
    return found


def blend_rows(kernel: ctypes.CDLL, values: Float32, row: Integers, share: Float, factor: Float) -> Float32:
    """(n, K) Σ over terms of factor times what lies share of the way from a row of values (m, K) to the next; row,
    share, factor: (n, terms). Raises ValueError where there is no such row."""
    if not row.shape == share.shape == factor.shape or row.ndim != 2:
        raise ValueError(f"rows {row.shape} with shares {share.shape} and factors {factor.shape}")
    if row.size and not 0 <= row.min() <= row.max() <= len(values) - 2:
        raise ValueError(f"rows {row.min()} to {row.max() + 1} of {len(values)}")
    out = np.empty((len(row), values.shape[1]), dtype=np.float32)
    kernel.hnf_between_rows(
        get_address(values, np.float32), values.shape[1], get_address(row, np.int64), get_address(share, np.float64),
        get_address(factor, np.float64), row.shape[1], len(row), get_address(out, np.float32),
    )  # fmt: skip
    return out
