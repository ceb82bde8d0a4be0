"""Compiled: what pressing harder or less hard makes felt (its twin in numpy is FilterBank.force_term in
field/contact_filter.py)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .library import get_address, pack_pointers

Float = NDArray[np.float64]
MAX_SAMPLES_PER_STATE = 64


class StateResponses:
    """Response of a state's samples to 1 N at each neighbouring state, of each of B contacts.

    tables: (rows, samples) each, the earliest state first; the last `ahead` rows are of states after the own one.
    Raises ValueError where these do not fit together.
    """

    def __init__(self, tables: Sequence[Float], ahead: int) -> None:
        widths = {each.shape[1] for each in tables}
        if (
            len(widths) != 1
            or max(widths) > MAX_SAMPLES_PER_STATE
            or not all(len(each) > ahead >= 0 for each in tables)
        ):
            raise ValueError(f"what is given to states: {[each.shape for each in tables]}, {ahead} rows ahead")
        self.tables, self.ahead, self.samples = tuple(tables), ahead, widths.pop()
        self._row_counts = np.array([len(each) for each in tables], dtype=np.int64)
        self._table_pointers = pack_pointers([get_address(each, np.float64) for each in tables])

    def compute_force_response(self, kernel: ctypes.CDLL, force: Float, weight: Float, first: int, count: int) -> Float:
        """(count · samples,) from state `first` on; force (n,) is held beyond its ends, as weight (n, B) is. Raises
        ValueError where these do not fit."""
        if weight.shape != (len(force), len(self.tables)) or not len(force):
            raise ValueError(f"{weight.shape} weights of {len(self.tables)} contacts at {len(force)} states")
        out = np.empty(count * self.samples)
        kernel.hnf_press(
            get_address(force, np.float64), len(force), get_address(weight, np.float64), len(self.tables), self._table_pointers,
            get_address(self._row_counts, np.int64), self.ahead, self.samples, first, count, get_address(out, np.float64),
        )  # fmt: skip
        return out
