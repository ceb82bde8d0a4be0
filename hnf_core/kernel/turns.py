"""Compiled: where a course bends (its twin in numpy is in field/breakpoints.py)."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from .library import get_address


def find_bends(
    kernel: ctypes.CDLL, course: NDArray[np.float64], required: NDArray[np.int64], tolerance: float
) -> NDArray[np.int64]:
    """The rows of a course (n, channels), ascending, between which no channel is off a straight line by more than bent;
    kept are among them. Raises ValueError where the first and the last are not."""
    if not len(required) or required[0] != 0 or required[-1] != len(course) - 1:
        raise ValueError(f"a course of {len(course)} states from {required[:1]} to {required[-1:]}")
    marked = np.zeros(len(course), dtype=np.uint8)
    marked[required] = 1
    kernel.hnf_bends(get_address(course, np.float64), *course.shape, tolerance, get_address(marked, np.uint8))
    return np.flatnonzero(marked)
