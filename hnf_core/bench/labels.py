"""Names beside points, none over another: where each goes, in pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""

MARK_PX = 7.0
"""Half the side of a point's mark, its surroundings included."""
RING_PX, RINGS = 12.0, 12
ANGLES = np.radians([0, 180, 90, 270, 45, 315, 135, 225, 22, 338, 158, 202, 67, 293, 113, 247])


def place_labels(anchors: Float, sizes: Float, frame: Box, taken: Sequence[Box] = ()) -> tuple[Box, ...] | None:
    """A box for each label: within frame, over no point's mark, no other label and nothing taken; None where no room is
    left.

    anchors: (n, 2) points. sizes: (n, 2) width and height of the labels. Nearest places first, the right side before
    the others.
    """
    marks = [(x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX) for x, y in anchors.tolist()]
    placed: list[Box] = []
    for anchor, size in zip(anchors.tolist(), sizes.tolist(), strict=True):
        there = [*marks, *placed, *taken]
        free = (box for box in _around(anchor, size) if _within(box, frame) and not overlaps(box, there))
        box = next(free, None)
        if box is None:
            return None
        placed.append(box)
    return tuple(placed)


def overlaps(box: Box, others: Sequence[Box]) -> bool:
    """Does box share more than an edge with any of others?"""
    left, bottom, right, top = box
    return any(left < r and l < right and bottom < t and b < top for l, b, r, t in others)  # noqa: E741


def _around(anchor: Sequence[float], size: Sequence[float]) -> Iterator[Box]:
    for ring in range(RINGS):
        away = MARK_PX + 1.0 + RING_PX * ring
        for angle in ANGLES.tolist():
            x = anchor[0] + float(np.cos(angle)) * (size[0] / 2.0 + away)
            y = anchor[1] + float(np.sin(angle)) * (size[1] / 2.0 + away)
            yield x - size[0] / 2.0, y - size[1] / 2.0, x + size[0] / 2.0, y + size[1] / 2.0


def _within(box: Box, frame: Box) -> bool:
    return box[0] >= frame[0] and box[1] >= frame[1] and box[2] <= frame[2] and box[3] <= frame[3]
