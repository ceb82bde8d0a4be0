"""Amplitudes over time as straight lines between knots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Samples = NDArray[np.int64]


@dataclass(frozen=True)
class Knots:
    """at: (m,) ascending samples of the model rate, two at least. amplitude: (m, K), linear in time between knots; it
    holds beyond them."""

    at: Samples
    amplitude: NDArray[np.floating[Any]]

    def find_rows(self, first: Samples, last: Samples) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Those that say what happens at samples first … last of many stretches (n,), two at least: where they begin,
        and where they end."""
        low = np.maximum(np.searchsorted(self.at, first, side="right") - 1, 0)
        high = np.minimum(np.searchsorted(self.at, last, side="left") + 1, len(self.at))
        return np.minimum(low, len(self.at) - 2), np.maximum(high, 2)

    def select_range(self, first: int, last: int) -> Knots:
        """Those of one stretch alone, in float32."""
        low, high = self.find_rows(np.array([first]), np.array([last]))
        rows = slice(int(low[0]), int(high[0]))
        return Knots(self.at[rows], np.ascontiguousarray(self.amplitude[rows], dtype=np.float32))

    def select_carriers(self, carriers: slice) -> Knots:
        return Knots(self.at, self.amplitude[:, carriers])

    def locate(self, sample: Samples) -> tuple[NDArray[np.intp], Float32]:
        """Index of the knot before each sample (n,), and how far it is on the way to the next, 0 … 1."""
        row = np.clip(np.searchsorted(self.at, sample, side="right") - 1, 0, len(self.at) - 2)
        span = self.at[row + 1] - self.at[row]
        return row, np.clip((sample - self.at[row]) / span, 0.0, 1.0).astype(np.float32)

    def nonzero_by_group(self, carriers: int) -> NDArray[np.bool_]:
        """(K / carriers, m) whether any of so many neighbouring amplitudes is not zero."""
        return np.asarray(self.amplitude.reshape(len(self.at), -1, carriers).any(axis=2).T)

    def find_active_ranges(self, loud: NDArray[np.bool_], first: int, last: int) -> list[tuple[int, int]]:
        """Ranges of samples within first … last − 1 beside a knot that is loud (m,)."""
        if loud.all():
            return [(first, last)]
        active = np.concatenate([[False], loud[:-1] | loud[1:], [False]])
        edges = np.flatnonzero(np.diff(active.astype(np.int8)))
        bounds = self.at.copy()
        bounds[0], bounds[-1] = min(bounds[0], first), max(bounds[-1], last)
        pairs = zip(bounds[edges[::2]].tolist(), bounds[edges[1::2]].tolist(), strict=True)
        ranges = [(max(low, first), min(high, last)) for low, high in pairs]
        return [each for each in ranges if each[0] < each[1]]
