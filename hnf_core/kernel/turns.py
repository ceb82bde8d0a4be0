"""Compiled: where a course bends (its twin in numpy is in field/breakpoints.py)."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from .library import address


def bends(kernel: ctypes.CDLL, course: NDArray[np.float64], kept: NDArray[np.int64], bent: float) -> NDArray[np.int64]:
    """The rows of a course (n, channels), ascending, between which no channel is off a straight line by more than bent;
    kept are among them. Raises ValueError where the first and the last are not."""
    if not len(kept) or kept[0] != 0 or kept[-1] != len(course) - 1:
        raise ValueError(f"a course of {len(course)} states from {kept[:1]} to {kept[-1:]}")
    marked = np.zeros(len(course), dtype=np.uint8)
    marked[kept] = 1
    kernel.hnf_bends(address(course, np.float64), *course.shape, bent, address(marked, np.uint8))
    return np.flatnonzero(marked)
