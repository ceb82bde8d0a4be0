"""Names beside points, none over another: where each goes, in pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""
Segment = tuple[tuple[float, float], tuple[float, float]]

MARK_PX = 7.0
"""Half the side of a point's mark, its surroundings included."""
RING_PX, RINGS = 12.0, 12
ANGLES = np.radians([0, 180, 90, 270, 45, 315, 135, 225, 22, 338, 158, 202, 67, 293, 113, 247])


@dataclass(frozen=True)
class LabelLayout:
    """boxes: one for each label. crossed: names and marks that lines from points to their names run over."""

    boxes: tuple[Box, ...]
    crossed: int


def lay_out_labels(anchors: Float, sizes: Float, frame: Box, occupied: Sequence[Box] = ()) -> LabelLayout | None:
    """A box for each label: within frame, over no point's mark, no other label and nothing taken; None where no room is
    left.

    anchors: (n, 2) points. sizes: (n, 2) width and height of the labels. Nearest places first, the right side before
    the others, among those whose line to their point runs over the fewest names and other marks.
    """
    marks = [(x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX) for x, y in anchors.tolist()]
    placed: list[Box] = []
    lines: list[Segment] = []
    total = 0
    for own, anchor, size in zip(marks, anchors.tolist(), sizes.tolist(), strict=True):
        others = [*(mark for mark in marks if not overlaps_any(mark, [own])), *placed]
        best: tuple[int, Box] | None = None
        for box in _generate_candidates(anchor, size):
            if not _is_within(box, frame) or overlaps_any(box, [*marks, *placed, *occupied]):
                continue
            line = make_leader(anchor, box)
            crossed = sum(crosses_box(line, other) for other in others) + sum(crosses_box(each, box) for each in lines)
            if best is None or crossed < best[0]:
                best = crossed, box
            if crossed == 0:
                break
        if best is None:
            return None
        total += best[0]
        placed.append(best[1])
        lines.append(make_leader(anchor, best[1]))
    return LabelLayout(tuple(placed), total)


def make_leader(anchor: Sequence[float], box: Box) -> Segment:
    """From a point to the middle of its name."""
    return (anchor[0], anchor[1]), (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))


def crosses_box(line: Segment, box: Box) -> bool:
    """Does a line enter a box? (Y.-D. Liang & B. A. Barsky 1984, a new concept and method for line clipping.)"""
    (x, y), (to_x, to_y) = line
    begin, end = 0.0, 1.0
    for start, step, low, high in ((x, to_x - x, box[0], box[2]), (y, to_y - y, box[1], box[3])):
        if step == 0.0:
            if not low < start < high:
                return False
            continue
        near, far = sorted(((low - start) / step, (high - start) / step))
        begin, end = max(begin, near), min(end, far)
    return begin < end


def overlaps_any(box: Box, others: Sequence[Box]) -> bool:
    """Does box share more than an edge with any of others?"""
    left, bottom, right, top = box
    return any(left < r and l < right and bottom < t and b < top for l, b, r, t in others)  # noqa: E741


def _generate_candidates(anchor: Sequence[float], size: Sequence[float]) -> Iterator[Box]:
    for ring in range(RINGS):
        away = MARK_PX + 1.0 + RING_PX * ring
        for angle in ANGLES.tolist():
            x = anchor[0] + float(np.cos(angle)) * (size[0] / 2.0 + away)
            y = anchor[1] + float(np.sin(angle)) * (size[1] / 2.0 + away)
            yield x - size[0] / 2.0, y - size[1] / 2.0, x + size[0] / 2.0, y + size[1] / 2.0


def _is_within(box: Box, frame: Box) -> bool:
    return box[0] >= frame[0] and box[1] >= frame[1] and box[2] <= frame[2] and box[3] <= frame[3]
