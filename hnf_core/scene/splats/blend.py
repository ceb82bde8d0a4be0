"""Splats composited front to back within a rectangle of pixels, all pairs of a splat and a pixel at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .project import MOST_ALPHA, Footprints, Int
from .spans import Spans, spans

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Bool = NDArray[np.bool_]

BLOCK = 1 << 16
"""Pairs held at once, but for the last splat's: few enough for a cache, many enough for numpy."""
TICKS = float(1 << 30)
"""−ln(1 − α) is counted in whole parts of this: sums of such are exact, in whatever order and portions."""
OPAQUE = -np.log(1e-5) * TICKS
"""Where this much is in front of a pair, it is left out."""
HALF = np.log(2.0) * TICKS
FAR = 2.0**40


@dataclass(frozen=True)
class Canvas:
    """What has been blended into P = width · height pixels, row by row. thickness: (P,) float64 optical depth, ticks.
    rgb: (3, P). weight: (P,) Σ w. weighted: (P,) Σ w (z − base). median: (P,) z − base, inf = not reached yet."""

    left: int
    top: int
    width: int
    height: int
    thickness: Float
    rgb: Float
    weight: Float
    weighted: Float
    median: Float

    @classmethod
    def empty(cls, left: int, top: int, width: int, height: int) -> Canvas:
        count = width * height
        flat = [np.zeros(count) for _ in range(3)]
        return cls(left, top, width, height, flat[0], np.zeros((3, count)), flat[1], flat[2], np.full(count, np.inf))


@dataclass(frozen=True)
class Pairs:
    """Q pairs, pixel by pixel, each pixel's front to back. pixel: (S,) those met, flat. start: (S,) where each pixel's
    begin. alpha: (Q,). run, column: (Q,) of which of the spans, and how many pixels right of its anchor."""

    pixel: Int
    start: Int
    alpha: Single
    run: Int
    column: Single


def blend(
    prints: Footprints, colour: Single, base: float, left: int, top: int, width: int, height: int
) -> tuple[Canvas, int]:
    """The rectangle of a picture, at most 65,536 pixels, and how many pairs it took. colour: (3, M) of the footprints.
    base: a depth that others are kept relative to, so that float32 is spent on what differs."""
    canvas, count = Canvas.empty(left, top, width, height), 0
    right, bottom = left + width, top + height
    rest = np.flatnonzero((prints.left < right) & (prints.right > left) & (prints.top < bottom) & (prints.bottom > top))
    while len(rest):
        open_ = canvas.thickness < OPAQUE
        rest = rest[_any_open(prints, rest, canvas, open_)]
        taken = _first(prints, rest, canvas)
        runs = _trim(spans(prints, rest[:taken], left, top, right, bottom), canvas, open_)
        rest = rest[taken:]
        if len(runs):
            count += int(np.sum(runs.right - runs.left))
            _composite(canvas, prints, colour, base, runs, _pairs(canvas, prints, runs))
    return canvas, count


def _box(prints: Footprints, which: Int, canvas: Canvas) -> tuple[Int, Int, Int, Int]:
    """Left, right, top, bottom within the canvas, right and bottom exclusive."""
    return (
        np.maximum(prints.left[which] - canvas.left, 0),
        np.minimum(prints.right[which] - canvas.left, canvas.width),
        np.maximum(prints.top[which] - canvas.top, 0),
        np.minimum(prints.bottom[which] - canvas.top, canvas.height),
    )


def _any_open(prints: Footprints, which: Int, canvas: Canvas, open_: Bool) -> Bool:
    """Which boxes hold a pixel that is not opaque yet (summed areas)."""
    across = canvas.width + 1
    total = np.zeros((canvas.height + 1, across), dtype=np.int32)
    np.cumsum(np.cumsum(open_.reshape(canvas.height, canvas.width), axis=0, dtype=np.int32), axis=1, out=total[1:, 1:])
    flat = total.ravel()
    left, right, top, bottom = _box(prints, which, canvas)
    top, bottom = top * across, bottom * across
    return np.asarray(flat[bottom + right] - flat[bottom + left] > flat[top + right] - flat[top + left])


def _first(prints: Footprints, which: Int, canvas: Canvas) -> int:
    """How many of the foremost splats make a block."""
    left, right, top, bottom = _box(prints, which[:BLOCK], canvas)
    return int(np.searchsorted(np.cumsum((right - left) * (bottom - top)), BLOCK)) + 1


def _trim(runs: Spans, canvas: Canvas, open_: Bool) -> Spans:
    """Without the opaque pixels at the ends of each run."""
    if open_.all():
        return runs
    at = np.arange(len(open_))
    following = np.append(np.minimum.accumulate(np.where(open_, at, len(open_))[::-1])[::-1], len(open_))
    before = np.maximum.accumulate(np.where(open_, at, -1))
    row = (runs.y - canvas.top) * canvas.width - canvas.left
    left = following[row + runs.left] - row
    right = before[row + runs.right - 1] + 1 - row
    kept = np.flatnonzero(left < right)
    return Spans(
        runs.splat[kept], runs.y[kept], left[kept], right[kept], runs.steep[kept], runs.across[kept], runs.along[kept]
    )


def _pairs(canvas: Canvas, prints: Footprints, runs: Spans) -> Pairs:
    counts = runs.right - runs.left
    first = np.cumsum(counts) - counts
    run = np.repeat(np.arange(len(runs)), counts)
    at = np.arange(len(run))
    anchor = _anchor(runs)
    column = (at + (runs.left - anchor - first)[run]).astype(np.float32)
    pixel = (at + ((runs.y - canvas.top) * canvas.width - canvas.left + runs.left - first)[run]).astype(np.uint16)

    offset = (anchor + 0.5 - runs.across).astype(np.float32)
    narrow = (-0.5 * prints.sharp[runs.splat]).astype(np.float32)
    peak = (np.log(prints.opacity[runs.splat]) - 0.5 * runs.steep).astype(np.float32)
    t = column + offset[run]
    alpha = np.minimum(np.exp(peak[run] + narrow[run] * (t * t)), np.float32(MOST_ALPHA))

    order = np.argsort(pixel, kind="stable")
    pixel = pixel[order]
    start = np.flatnonzero(np.concatenate([[True], pixel[1:] != pixel[:-1]]))
    return Pairs(pixel[start].astype(np.intp), start, alpha[order], run[order], column[order])


def _anchor(runs: Spans) -> Int:
    """A pixel of each row that is the same for every crop and rectangle: that of the ellipse's middle."""
    return np.clip(np.floor(runs.across), -FAR, FAR).astype(np.intp)


def _composite(canvas: Canvas, prints: Footprints, colour: Single, base: float, runs: Spans, pairs: Pairs) -> None:
    thickness = np.rint(np.log(np.float32(1.0) - pairs.alpha) * np.float32(-TICKS)).astype(np.float64)
    begin = canvas.thickness[pairs.pixel]
    end = begin + np.add.reduceat(thickness, pairs.start)
    # A running sum, whose step from one pixel's last pair to the next one's first leads to what is in front of that.
    steps = np.empty_like(thickness)
    steps[1:] = thickness[:-1]
    steps[pairs.start] = begin
    steps[pairs.start[1:]] -= end[:-1] - thickness[pairs.start[1:] - 1]
    front = np.cumsum(steps)
    light = np.exp((front * (-1.0 / TICKS)).astype(np.float32))
    weight = np.where(front < OPAQUE, pairs.alpha * light, np.float32(0.0))

    splat = runs.splat
    middle = _anchor(runs) + 0.5 - prints.u[splat]
    height = prints.depth[splat] - base + prints.rise_x[splat] * middle + prints.rise_y[splat] * runs.along
    z = height.astype(np.float32)[pairs.run] + prints.rise_x[splat].astype(np.float32)[pairs.run] * pairs.column
    half = np.flatnonzero((front < HALF) & (front + thickness >= HALF))
    canvas.median[pairs.pixel[np.searchsorted(pairs.start, half, side="right") - 1]] = z[half]

    canvas.thickness[pairs.pixel] = end
    canvas.weight[pairs.pixel] += np.add.reduceat(weight, pairs.start)
    canvas.weighted[pairs.pixel] += np.add.reduceat(weight * z, pairs.start)
    for total, channel in zip(canvas.rgb, colour, strict=True):
        total[pairs.pixel] += np.add.reduceat(weight * channel[splat][pairs.run], pairs.start)
