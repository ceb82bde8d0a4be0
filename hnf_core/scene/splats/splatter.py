"""Splats seen by a camera, on the CPU: what the reference defines, fast."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from .blend import Canvas, blend
from .cloud import Splats
from .harmonics import colours, directions
from .project import CHUNK, LOW_PASS_PX2, Footprints, chunks, footprints_of, in_order
from .view import SplatView

TILE = 128
"""Pixels along a side of what is blended at once; its square must fit 16 bits."""

Part = TypeVar("Part")


def render_splats(
    splats: Splats, camera: Camera, *, low_pass: float = LOW_PASS_PX2, threads: int | None = None
) -> SplatView:
    """The view of a camera in the splats' own frame and unit, as `render_reference` defines it, in float32.

    A pixel is done once less than 1e-5 of its light is left. low_pass: pixels², added to the variance of every splat.
    threads: at once, None = one for each core; the view is the same bytes with any number. Raises UsageError for a
    low_pass that is negative or not finite.
    """
    work = _Work(max(1, threads or os.cpu_count() or 1))
    prints = in_order(work.each(partial(footprints_of, splats, camera, low_pass), chunks(splats)))
    tint = partial(_colours, splats, camera, prints)
    colour = np.concatenate(work.each(tint, range(0, max(len(prints), 1), CHUNK)), axis=1)
    base = float(prints.depth[0]) if len(prints) else 0.0
    tiles = [
        (left, top, min(TILE, camera.width - left), min(TILE, camera.height - top))
        for top in range(0, camera.height, TILE)
        for left in range(0, camera.width, TILE)
    ]
    found = work.each(lambda tile: blend(prints, colour, base, *tile), tiles)
    return _view(camera, base, [canvas for canvas, _ in found], len(prints), sum(pairs for _, pairs in found))


class _Work:
    """A function of each of several things, several at once, the results in their order."""

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def each(self, function: Callable[..., Part], things: Iterable[object]) -> list[Part]:
        listed = list(things)
        if min(self._threads, len(listed)) < 2:
            return [function(thing) for thing in listed]
        with ThreadPoolExecutor(min(self._threads, len(listed))) as pool:
            return list(pool.map(function, listed))


def _colours(splats: Splats, camera: Camera, prints: Footprints, start: int) -> NDArray[np.float32]:
    """(3, n) of some of those that meet the picture, from the nearest on."""
    index = prints.index[start : start + CHUNK]
    found = colours(splats.harmonics[index], directions(splats.means[index], camera))
    return np.ascontiguousarray(found.T, dtype=np.float32)


def _view(camera: Camera, base: float, canvases: list[Canvas], drawn: int, pairs: int) -> SplatView:
    shape = (camera.height, camera.width)
    rgb = np.zeros((*shape, 3), dtype=np.float32)
    depth, median, opacity = (np.zeros(shape, dtype=np.float32) for _ in range(3))
    for canvas in canvases:
        part = np.s_[canvas.top : canvas.top + canvas.height, canvas.left : canvas.left + canvas.width]
        size = (canvas.height, canvas.width)
        met = canvas.weight > 0.0
        expected = base + canvas.weighted / np.where(met, canvas.weight, 1.0)
        rgb[part] = canvas.rgb.T.reshape(*size, 3)
        depth[part] = np.where(met, expected, np.inf).reshape(size)
        median[part] = (base + canvas.median).reshape(size)
        opacity[part] = np.minimum(canvas.weight, 1.0).reshape(size)
    return SplatView(camera, rgb, depth, median, opacity, drawn, pairs)
