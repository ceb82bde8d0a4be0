"""Contact sheet of tactile pairs: one row a category, from the visual inputs to the tactile maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.pair_generation import FIRST_SEED, PATCHES_PER_INSTANCE, TileRequest, make_tile
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, TRAIN, Pairs
from hnf_core.simulation.material_classes import derive_seed, get_category, list_classes
from hnf_core.tactile.optics import SENSORS, shade

Image = NDArray[np.uint8]

GAP = 4
RELIEF_RANGE_SIGMA = 2.5
"""Half the range of the grey scale of a relief [standard deviations]."""
MIN_SHOWN_SLOPE_RMS = 0.35
"""RMS to which smaller slopes are stretched: real ones (0.001–0.1) hardly colour a sensor image."""
SHOWN_PITCHES = (0, 2)
"""Indices of the pitches shown: views 20 and 5 mm wide."""


def make_contact_sheet(seed: int, per_category: int = 1) -> Image:
    """Make the sheet, (H, W, 3) uint8: rows are the categories and one random surface.

    Each view shows rgb, depth, height, GelSight and DIGIT. Depth and height are stretched to their own spread, slopes
    to MIN_SHOWN_SLOPE_RMS: the sheet shows form, not size.
    """
    rows = []
    names = dict.fromkeys(get_category(name) for name in list_classes())
    for category in (*names, ""):
        members = [name for name in list_classes() if get_category(name) == category] or [""]
        for number in range(per_category):
            name = members[number % len(members)]
            first = FIRST_SEED[TRAIN] + number if name else -1
            request = TileRequest(name, first, derive_seed(f"sheet/{seed}/{name}/{number}") // PATCHES_PER_INSTANCE)
            rows.append(make_tile_row(make_tile(request)))
    return _stack_images(rows, 0)


def make_tile_row(pairs: Pairs) -> Image:
    """Join the views of one tile side by side."""
    return _stack_images([picture for view in SHOWN_PITCHES for picture in make_view_images(pairs, view)], 1)


def make_view_images(pairs: Pairs, view: int) -> list[Image]:
    """Make the images of one view, (64, 64, 3) each: rgb (gamma as stored), depth, height and the two sensors."""
    pictures = [
        pairs.rgb[view],
        _relief_to_grey(-pairs.depth[view].astype(np.float64)),
        _relief_to_grey(pairs.height[view]),
    ]
    for sensor, (gx, gy) in zip(PAIR_SENSORS, pairs.slopes[view].astype(np.float64), strict=True):
        rms = float(np.sqrt(np.mean(gx**2 + gy**2)))
        gain = max(MIN_SHOWN_SLOPE_RMS / max(rms, 1e-12), 1.0)
        pictures.append(_to_uint8(np.sqrt(np.clip(shade(gain * gx, gain * gy, SENSORS[sensor]), 0.0, 1.0))))
    return pictures


def _relief_to_grey(values: NDArray[np.float16] | NDArray[np.float64]) -> Image:
    level = values.astype(np.float64) - float(np.mean(values, dtype=np.float64))
    spread = max(float(level.std()), 1e-12)
    return _to_uint8(np.repeat((0.5 + 0.5 * level / (RELIEF_RANGE_SIGMA * spread))[..., None], 3, axis=2))


def _to_uint8(values: NDArray[np.float64]) -> Image:
    return np.asarray(np.rint(255.0 * np.clip(values, 0.0, 1.0)), dtype=np.uint8)


def _stack_images(images: list[Image], axis: int) -> Image:
    pads = [(0, 0), (0, 0), (0, 0)]
    pads[axis] = (0, GAP)
    white = [np.pad(picture, pads, constant_values=255) for picture in images[:-1]]
    return np.concatenate([*white, images[-1]], axis=axis)
