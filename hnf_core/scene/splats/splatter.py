"""Splats seen by a camera, on the CPU: what the reference defines, fast."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from .blend import Canvas, Region, composite_region
from .cloud import Splats
from .harmonics import compute_view_directions, evaluate_sh_colours
from .project import (
    LOW_PASS_PX2,
    Footprints,
    Int,
    concatenate_footprints,
    project_chunk,
    sort_front_to_back,
    split_into_chunks,
)
from .view import SplatView

REGION_SIZE_PX = 128
"""Pixels along a side of what one thread blends at a time."""
TILE_SIDES = ((32.0, 2), (2000.0, 4), (np.inf, 8))
"""(mean area of the splats' boxes up to which it is, pixels along a tile's side): small tiles waste fewer pixels on
small splats, large ones put large splats down in fewer places. The picture is the same."""

Result = TypeVar("Result")


def render_splats(splats: Splats, camera: Camera, *, low_pass: float = LOW_PASS_PX2, threads: int = 1) -> SplatView:
    """The view of a camera in the splats' own frame and unit, as `render_reference` defines it, in float32.

    A pixel is done once less than 1e-5 of its light is left. low_pass: pixels², added to the variance of every splat.
    threads: at once; the view is the same bytes with any number, and on two cores two took as long as one. Raises
    UsageError for a low_pass that is negative or not finite.
    """
    work = _ThreadMap(threads)
    prints = concatenate_footprints(
        work.run(partial(project_chunk, splats, camera, low_pass), split_into_chunks(len(splats)))
    )
    order, base = sort_front_to_back(prints), float(prints.depth.min(initial=np.inf))
    tints = work.run(partial(_compute_colours, splats, camera, prints.index), split_into_chunks(len(prints)))
    colour = np.concatenate(tints, axis=1)
    side = _choose_tile_side(prints)
    regions = [
        Region(left, top, min(REGION_SIZE_PX, camera.width - left), min(REGION_SIZE_PX, camera.height - top), side)
        for top in range(0, camera.height, REGION_SIZE_PX)
        for left in range(0, camera.width, REGION_SIZE_PX)
    ]
    rgb = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    depth, median, opacity = (np.empty(rgb.shape[:2], dtype=np.float32) for _ in range(3))
    view = SplatView(camera, rgb, depth, median, opacity, len(prints), 0)

    def paint(region: Region) -> int:
        canvas, pairs = composite_region(prints, order, colour, base, region)
        _write_region(view, canvas, base)
        return pairs

    return replace(view, pairs=sum(work.run(paint, regions)))


class _ThreadMap:
    """A function of each of several things, several at once, the results in their order."""

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def run(self, function: Callable[..., Result], items: Iterable[object]) -> list[Result]:
        listed = list(items)
        if min(self._threads, len(listed)) < 2:
            return [function(thing) for thing in listed]
        with ThreadPoolExecutor(min(self._threads, len(listed))) as pool:
            return list(pool.map(function, listed))


def _choose_tile_side(prints: Footprints) -> int:
    area = np.mean((prints.right - prints.left) * (prints.bottom - prints.top)) if len(prints) else 0.0
    return next(side for most, side in TILE_SIDES if area < most)


def _compute_colours(splats: Splats, camera: Camera, visible: Int, chunk: slice) -> NDArray[np.float32]:
    """(3, n) of some of those that meet the picture."""
    index = visible[chunk]
    found = evaluate_sh_colours(splats.harmonics[index], compute_view_directions(splats.means[index], camera))
    return np.ascontiguousarray(found.T, dtype=np.float32)


def _write_region(view: SplatView, canvas: Canvas, base: float) -> None:
    """Write a region into its place."""
    at = canvas.region
    part = np.s_[at.top : at.top + at.height, at.left : at.left + at.width]
    weight, weighted = canvas.to_image(canvas.weight), canvas.to_image(canvas.depth())
    colour = [canvas.to_image(each) for each in canvas.sums[3:]]
    met = weight > 0.0
    view.rgb[part] = np.stack(colour, axis=-1)
    view.depth[part] = np.where(met, base + weighted / np.where(met, weight, 1.0), np.inf)
    view.median[part] = base + canvas.to_image(canvas.median).astype(np.float64)
    view.opacity[part] = np.minimum(weight, 1.0)
