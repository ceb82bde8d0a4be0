"""Which pixels a splat covers: its ellipse, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .project import Footprints, Int

Float = NDArray[np.float64]

SLACK = 1e-7


@dataclass(frozen=True)
class Spans:
    """R runs of pixels, splat by splat in the footprints' order, each splat's from top to bottom. All (R,).

    splat: index into the footprints. y, left, right: pixels, right exclusive, never empty. steep, across, along: of the
    quadratic form q = steep + sharp (x + ½ − across)² on the row y; along: dy.
    """

    splat: Int
    y: Int
    left: Int
    right: Int
    steep: Float
    across: Float
    along: Float

    def __len__(self) -> int:
        return len(self.splat)


def form(prints: Footprints, which: Int, y: Int) -> tuple[Float, Float, Float]:
    """(steep, across, along) of splats on rows, with which q = steep + sharp (x + ½ − across)². The one place where q
    is made, in float64, so that the reference and the fast way leave out the same pixels."""
    along = (y + 0.5) - prints.v[which]
    return along * along / prints.var_y[which], prints.u[which] + prints.shear[which] * along, along


def spans(prints: Footprints, which: Int, left: int, top: int, right: int, bottom: int) -> Spans:
    """The pixels of a rectangle with q ≤ limit, of splats `which` whose boxes meet it.

    The root of q gives the ends within far less than a pixel; at the ends q itself decides, as it does for the
    reference at every pixel.
    """
    first = np.maximum(prints.top[which], top)
    rows = np.minimum(prints.bottom[which], bottom) - first
    splat = np.repeat(which, rows)
    y = np.arange(len(splat)) - np.repeat(np.cumsum(rows) - rows - first, rows)
    steep, across, along = form(prints, splat, y)
    sharp, limit = prints.sharp[splat], prints.limit[splat]
    half = np.sqrt(np.maximum(limit - steep, 0.0) / sharp)
    half += SLACK * (1.0 + half + abs(across) + 1.0 / np.sqrt(sharp))
    x0, x1 = np.ceil(across - half - 0.5), np.floor(across + half - 0.5)
    x0 += ~_inside(x0, steep, across, sharp, limit)
    x1 -= ~_inside(x1, steep, across, sharp, limit)
    x0 = np.maximum(x0, left)
    x1 = np.minimum(x1 + 1.0, right)
    kept = np.flatnonzero(x0 < x1)
    ends = (x0[kept].astype(np.intp), x1[kept].astype(np.intp))
    return Spans(splat[kept], y[kept], *ends, steep[kept], across[kept], along[kept])


def _inside(x: Float, steep: Float, across: Float, sharp: Float, limit: Float) -> NDArray[np.bool_]:
    offset = (x + 0.5) - across
    return np.asarray(steep + sharp * (offset * offset) <= limit)
