"""A contact sheet of tactile pairs: one row a category, from what is seen to what is touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..datasets.pair_tiles import FIRST_SEED, PATCHES, TileOrder, make_tile
from ..datasets.tactile_pairs import PAIR_SENSORS, TRAIN, Pairs
from ..simulation.classes import category_of, classes, seed_of
from ..tactile.optics import SENSORS, shade

Picture = NDArray[np.uint8]

GAP = 4
SPAN = 2.5
"""A relief is shown grey in grey over this many standard deviations to either side."""
STEEP = 0.35
"""Slopes are stretched to this RMS where they are less: real ones (0.001–0.1) hardly colour a sensor picture."""
VIEWS = (0, 2)
"""Which pitches are shown: 20 and 5 mm wide."""


def contact_sheet(seed: int, per_category: int = 1) -> Picture:
    """(H, W, 3) uint8: rows = categories and one random surface; per view rgb, depth, height, GelSight, DIGIT.

    Depth and height are stretched to their own spread, slopes to STEEP: the sheet shows form, not size.
    """
    rows = []
    names = dict.fromkeys(category_of(name) for name in classes())
    for category in (*names, ""):
        members = [name for name in classes() if category_of(name) == category] or [""]
        for number in range(per_category):
            name = members[number % len(members)]
            first = FIRST_SEED[TRAIN] + number if name else -1
            order = TileOrder(name, first, seed_of(f"sheet/{seed}/{name}/{number}") // PATCHES)
            rows.append(row_of(make_tile(order)))
    return _stacked(rows, 0)


def row_of(pairs: Pairs) -> Picture:
    """One tile's views side by side."""
    return _stacked([picture for view in VIEWS for picture in pictures_of(pairs, view)], 1)


def pictures_of(pairs: Pairs, view: int) -> list[Picture]:
    """rgb (gamma as stored), depth, height and the two sensor pictures of one view, (64, 64, 3) each."""
    pictures = [pairs.rgb[view], _grey(-pairs.depth[view].astype(np.float64)), _grey(pairs.height[view])]
    for sensor, (gx, gy) in zip(PAIR_SENSORS, pairs.slopes[view].astype(np.float64), strict=True):
        rms = float(np.sqrt(np.mean(gx**2 + gy**2)))
        gain = max(STEEP / max(rms, 1e-12), 1.0)
        pictures.append(_bytes(np.sqrt(np.clip(shade(gain * gx, gain * gy, SENSORS[sensor]), 0.0, 1.0))))
    return pictures


def _grey(values: NDArray[np.float16] | NDArray[np.float64]) -> Picture:
    level = values.astype(np.float64) - float(np.mean(values, dtype=np.float64))
    spread = max(float(level.std()), 1e-12)
    return _bytes(np.repeat((0.5 + 0.5 * level / (SPAN * spread))[..., None], 3, axis=2))


def _bytes(values: NDArray[np.float64]) -> Picture:
    return np.asarray(np.rint(255.0 * np.clip(values, 0.0, 1.0)), dtype=np.uint8)


def _stacked(pictures: list[Picture], axis: int) -> Picture:
    pads = [(0, 0), (0, 0), (0, 0)]
    pads[axis] = (0, GAP)
    white = [np.pad(picture, pads, constant_values=255) for picture in pictures[:-1]]
    return np.concatenate([*white, pictures[-1]], axis=axis)
