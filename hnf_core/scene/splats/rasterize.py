"""Rendering of Gaussian splats on the CPU: projection, tiles, and front-to-back compositing, in numpy.

A region of the image is composited at a time, many tiles and many splats at once; `render_splats` runs regions in
threads. tests/reference/splat_rendering.py has the plain definition that the result is compared with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...progress import add_work
from ..camera import Camera
from .gaussians import Splats, compute_view_directions, evaluate_sh_colours
from .project import (
    LOW_PASS_PX2,
    MAX_ALPHA,
    MEDIAN_TRANSMITTANCE,
    Footprints,
    Int,
    concatenate_footprints,
    evaluate_quadratic_form,
    project_chunk,
    sort_front_to_back,
    split_into_chunks,
)


@dataclass(frozen=True)
class SplatView:
    """One rendered view of splats, depths in its camera's unit; w = α · transmittance is a splat's weight in a pixel.

    Attributes
    ----------
    camera : Camera
        The camera.
    rgb : ndarray, shape (H, W, 3)
        Display-referred (sRGB) color over black, Σ w c: splats are trained in this color space. All images are float32,
        or float64 from the reference renderer.
    depth : ndarray, shape (H, W)
        Expected planar depth Σ w z / Σ w, inf if opacity is 0.
    median : ndarray, shape (H, W)
        Planar depth of the splat at which half of the light is absorbed, inf if opacity stays below one half.
    opacity : ndarray, shape (H, W)
        Σ w in [0, 1].
    drawn : int
        Number of splats that overlap the image.
    pairs : int
        Number of splat–pixel pairs evaluated.
    """

    camera: Camera
    rgb: NDArray[np.floating[Any]]
    depth: NDArray[np.floating[Any]]
    median: NDArray[np.floating[Any]]
    opacity: NDArray[np.floating[Any]]
    drawn: int
    pairs: int


Float = NDArray[np.float64]
Single = NDArray[np.float32]
Bool = NDArray[np.bool_]

SPLATS_PER_BATCH = 1 << 13
"""Number of splats whose tiles are found together."""
INTERSECTIONS_PER_BATCH = 1 << 16
"""Largest number of splat–tile pairs in memory; only the pairs of the last splat of a batch may exceed it."""
PIXELS_PER_GROUP = 1 << 12
"""Number of pixels of the tiles that are composited together."""
PAIRS_PER_BATCH = 1 << 17
"""Largest number of splat–pixel pairs in memory."""
MIN_TRANSMITTANCE = np.float32(1e-5)
"""Transmittance below which a pixel is finished."""

SMALLEST_TRANSMITTANCE, MIN_EXPONENT = np.float32(1e-30), np.float32(-50.0)
"""Lower limits of transmittance and of the exponent of α: subnormal numbers multiply a hundred times more slowly."""


@dataclass(frozen=True)
class Region:
    """A rectangle of an image in tiles of side × side pixels; the last tile in a row or column may exceed it."""

    left: int
    top: int
    width: int
    height: int
    side: int

    @property
    def tiles_across(self) -> int:
        """Number of tiles in a row."""
        return -(-self.width // self.side)

    @property
    def tiles_down(self) -> int:
        """Number of rows of tiles."""
        return -(-self.height // self.side)


@dataclass(frozen=True)
class Canvas:
    """Accumulated values of the T tiles of a region, with P = side² pixels each; w is a splat's weight. All (P, T).

    Attributes
    ----------
    region : Region
        The region.
    transmittance : ndarray of float32
        Fraction of the light not yet absorbed, 0 outside the region.
    weight : ndarray of float64
        Σ w.
    sums : ndarray of float64, shape (6, P, T)
        Σ w · attribute for the six attributes of `_evaluate_layer_attributes`: depth plane and color.
    median : ndarray of float32
        Median depth less the region's base depth, inf if not reached yet.
    """

    region: Region
    transmittance: Single
    weight: Float
    sums: Float
    median: Single

    @classmethod
    def empty(cls, region: Region) -> Canvas:
        """Return the canvas of a region before any splat is composited."""
        side = region.side
        transmittance = np.zeros((region.tiles_down, side, region.tiles_across, side), dtype=np.float32)
        transmittance.reshape(region.tiles_down * side, -1)[: region.height, : region.width] = 1.0
        transmittance = np.ascontiguousarray(transmittance.transpose(1, 3, 0, 2)).reshape(side * side, -1)
        zero = np.zeros((7, *transmittance.shape))
        return cls(region, transmittance, zero[0], zero[1:], np.full_like(transmittance, np.inf))

    def depth(self) -> Float:
        """Return Σ w (z − base), (P, T): the weighted sum of depth relative to the base depth."""
        pixel = np.arange(self.region.side**2)[:, None]
        return np.asarray(_evaluate_depth_plane(self.sums[:3], pixel, self.region.side), dtype=np.float64)

    def to_image(self, values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Rearrange values (P, T), pixels by tiles, to an image (height, width) of the region."""
        side, down, across = self.region.side, self.region.tiles_down, self.region.tiles_across
        image = values.reshape(side, side, down, across).transpose(2, 0, 3, 1)
        return image.reshape(down * side, -1)[: self.region.height, : self.region.width]


@dataclass(frozen=True)
class TileIntersections:
    """Pairs of splats and the tiles that they touch, sorted by tile and within it front to back.

    Attributes
    ----------
    splat : ndarray of int, shape (I,)
        Index of the splat's footprint.
    tile : ndarray of int, shape (A,)
        Indices of the tiles that any splat touches.
    start, end : ndarray of int, shape (A,)
        Range of each tile's pairs in `splat`.
    """

    splat: Int
    tile: Int
    start: Int
    end: Int


def composite_region(
    footprints: Footprints, order: Int, colour: Single, base: float, region: Region
) -> tuple[Canvas, int]:
    """Composite splats front to back into one region of an image.

    Parameters
    ----------
    footprints : Footprints
        Footprints of M splats in the image.
    order : ndarray of int, shape (M,)
        Front-to-back order.
    colour : ndarray of float32, shape (3, M)
        Colours.
    base : float
        Depth that others are stored relative to, to save digits of float32.
    region : Region
        The region, at most 65,536 tiles.

    Returns
    -------
    canvas : Canvas
        The composited values.
    pairs : int
        Number of splat–pixel pairs evaluated.
    """
    canvas, pairs, position = Canvas.empty(region), 0, 0
    right, bottom = region.left + region.width, region.top + region.height
    overlapping = (
        (footprints.left < right)
        & (footprints.right > region.left)
        & (footprints.top < bottom)
        & (footprints.bottom > region.top)
    )
    chosen = order[overlapping[order]]
    footprints, colour = footprints.take(chosen), colour[:, chosen]
    while position < len(footprints):
        is_open = (canvas.transmittance >= MIN_TRANSMITTANCE).any(axis=0)
        if not is_open.any():
            break
        with np.errstate(over="ignore"):  # far from a needle-like splat q exceeds float32
            intersections, position = _intersect_tiles(footprints, position, region, is_open)
            pairs += _composite_tiles(canvas, footprints, colour, base, intersections)
    return canvas, pairs


def _intersect_tiles(prints: Footprints, at: int, region: Region, open_: Bool) -> tuple[TileIntersections, int]:
    """Return pairs of splats and unfinished tiles for a batch of splats from index `at` on, and the next batch's index.

    `open_` (T,) marks the tiles that still let light through; footprints are in front-to-back order.
    """
    span, side = np.s_[at : at + SPLATS_PER_BATCH], region.side
    left = np.maximum(prints.left[span] - region.left, 0) // side
    right = (np.minimum(prints.right[span] - region.left, region.width) - 1) // side + 1
    top = np.maximum(prints.top[span] - region.top, 0) // side
    bottom = (np.minimum(prints.bottom[span] - region.top, region.height) - 1) // side + 1
    reaches_open = _has_open_tile(open_.reshape(region.tiles_down, region.tiles_across), left, right, top, bottom)
    count = np.where(reaches_open, (right - left) * (bottom - top), 0)
    used = int(np.searchsorted(np.cumsum(count), INTERSECTIONS_PER_BATCH)) + 1
    selected = np.flatnonzero(reaches_open[:used])
    count, width = count[selected], (right - left)[selected]

    member = np.repeat(np.arange(len(selected)), count)
    rank = np.arange(len(member)) - (np.cumsum(count) - count)[member]
    row = ((rank + 0.5) / width[member]).astype(np.intp)  # integer division is slower
    y, x, splat = (
        top[selected][member] + row,
        left[selected][member] + rank - row * width[member],
        selected[member] + at,
    )
    keep = np.flatnonzero(open_[y * region.tiles_across + x])
    y, x, splat = y[keep], x[keep], splat[keep]
    keep = np.flatnonzero(_may_reach_tile(prints, splat, region.left + side * x, region.top + side * y, side))
    tile, splat = (y[keep] * region.tiles_across + x[keep]).astype(np.uint16), splat[keep]
    order = np.argsort(tile, kind="stable")
    per_tile = np.bincount(tile, minlength=len(open_))
    nonempty, end = np.flatnonzero(per_tile), np.cumsum(per_tile)
    return TileIntersections(splat[order], nonempty, (end - per_tile)[nonempty], end[nonempty]), at + min(
        used, len(reaches_open)
    )


def _has_open_tile(open_: Bool, left: Int, right: Int, top: Int, bottom: Int) -> Bool:
    """Return a mask of the boxes (in tiles) that contain an unfinished tile of `open_`, by a summed-area table."""
    if open_.all():
        return np.ones(len(left), dtype=np.bool_)
    total = np.zeros((open_.shape[0] + 1, open_.shape[1] + 1), dtype=np.int32)
    total[1:, 1:] = open_.cumsum(axis=0, dtype=np.int32).cumsum(axis=1)
    return np.asarray(total[bottom, right] - total[bottom, left] > total[top, right] - total[top, left])


def _may_reach_tile(prints: Footprints, splat: Int, left: Int, top: Int, side: int) -> Bool:
    """Return a mask of splat–tile pairs; False where the splat's ellipse certainly misses the tile.

    A pixel's Mahalanobis distance is at least that of the tile's center less half the diagonal over the least standard
    deviation. `left`, `top` are the tile's first pixel.
    """
    row_term, nearest_x, _ = evaluate_quadratic_form(prints, splat, top + (0.5 * side - 0.5))
    offset = left + 0.5 * side - nearest_x
    q = row_term + prints.precision[splat] * (offset * offset)
    return np.asarray(q <= (np.square(np.sqrt(prints.cutoff) + np.sqrt(0.5) * side * prints.inverse_std))[splat])


def _composite_tiles(
    canvas: Canvas, prints: Footprints, colour: Single, base: float, touches: TileIntersections
) -> int:
    """Composite splats into the tiles that they touch; return the number of contributing splat–pixel pairs.

    Tiles with about equally many splats are composited together.
    """
    pairs, size, counts = 0, canvas.region.side**2, touches.end - touches.start
    by_count = np.argsort(counts, kind="stable")
    for first in range(0, len(by_count), PIXELS_PER_GROUP // size):
        group = by_count[first : first + PIXELS_PER_GROUP // size]
        tile, start, end = touches.tile[group], touches.start[group], touches.end[group]
        while len(tile):
            layers = int(min(max(PAIRS_PER_BATCH // (size * len(tile)), 1), (end - start).max()))
            at = start + np.arange(layers)[:, None]
            valid = at < end
            splat = touches.splat[np.where(valid, at, 0)]
            pairs += _composite_layers(canvas, prints, colour, base, tile, splat, valid)
            start = start + layers
            unfinished = np.flatnonzero(
                (start < end) & (canvas.transmittance[:, tile] >= MIN_TRANSMITTANCE).any(axis=0)
            )
            tile, start, end = tile[unfinished], start[unfinished], end[unfinished]
    return pairs


def _composite_layers(
    canvas: Canvas, prints: Footprints, colour: Single, base: float, tile: Int, splat: Int, there: Bool
) -> int:
    """Composite up to L splats, front to back, into each of A tiles; return the number of contributing pairs.

    `splat` (L, A) holds the footprint of each layer of each tile, and `there` (L, A) is False where a tile has fewer.
    """
    y, x = np.divmod(tile, canvas.region.tiles_across)
    side = canvas.region.side
    left, top = canvas.region.left + side * x, canvas.region.top + side * y
    alpha, covered = _evaluate_alpha(prints, left, top, side, splat, there)
    transmittance = np.empty((len(splat) + 1, *alpha.shape[1:]), dtype=np.float32)
    transmittance[0] = canvas.transmittance[:, tile]
    np.subtract(np.float32(1.0), alpha, out=transmittance[1:])
    for layer in range(len(splat)):  # multiply.accumulate is ten times slower
        transmittance[layer + 1] *= transmittance[layer]
        np.maximum(transmittance[layer + 1], SMALLEST_TRANSMITTANCE, out=transmittance[layer + 1])
    canvas.transmittance[:, tile] = transmittance[-1]
    attributes = _evaluate_layer_attributes(prints, colour, base, left, top, splat)

    pixel, column = np.nonzero((transmittance[0] > MEDIAN_TRANSMITTANCE) & (transmittance[-1] <= MEDIAN_TRANSMITTANCE))
    layer = np.argmax(transmittance[1:, pixel, column] <= MEDIAN_TRANSMITTANCE, axis=0)
    canvas.median[pixel, tile[column]] = _evaluate_depth_plane(attributes[:3, layer, column], pixel, side)

    covered &= transmittance[:-1] >= MIN_TRANSMITTANCE
    weight = alpha
    weight *= transmittance[:-1]
    weight *= covered
    canvas.weight[:, tile] += weight.sum(axis=0)
    canvas.sums[:, :, tile] += np.einsum("lpa,kla->kpa", weight, attributes)
    return int(np.count_nonzero(covered))


def _evaluate_alpha(prints: Footprints, left: Int, top: Int, side: int, splat: Int, there: Bool) -> tuple[Single, Bool]:
    """Return α and a mask of the pixels within the splat's cutoff, (L, P, A) each, for L layers of A tiles.

    The Mahalanobis distance is compared with the cutoff in float64, as in the reference renderer, so that both agree.
    """
    steps = np.arange(side)[:, None]
    row_term, nearest_x, _ = evaluate_quadratic_form(prints, splat[:, None], (top + steps)[None])
    q = (left + steps + 0.5) - nearest_x[:, :, None]
    q *= q
    q *= prints.precision[splat][:, None, None]
    q += row_term[:, :, None]
    covered = q <= np.where(there, prints.cutoff[splat], -1.0)[:, None, None]
    alpha = q.astype(np.float32)
    alpha *= np.float32(-0.5)
    np.maximum(alpha, MIN_EXPONENT, out=alpha)
    np.exp(alpha, out=alpha)
    alpha *= prints.opacity[splat].astype(np.float32)[:, None, None]
    np.minimum(alpha, np.float32(MAX_ALPHA), out=alpha)
    alpha *= covered
    shape = (len(splat), side * side, len(left))
    return alpha.reshape(shape), covered.reshape(shape)


def _evaluate_layer_attributes(
    prints: Footprints, colour: Single, base: float, left: Int, top: Int, splat: Int
) -> Single:
    """Return depth at a tile's first pixel less `base`, depth slopes right and down, and color of splats, (6, L, A)."""
    dy, dx = top + 0.5 - prints.v[splat], left + 0.5 - prints.u[splat]
    slope_x, slope_y = prints.depth_slope_x[splat], prints.depth_slope_y[splat]
    corner = prints.depth[splat] - base + slope_x * dx + slope_y * dy
    return np.stack(
        [value.astype(np.float32) for value in (corner, slope_x, slope_y)] + [value[splat] for value in colour]
    )


def _evaluate_depth_plane(plane: NDArray[np.floating[Any]], pixel: Int, side: int) -> NDArray[np.floating[Any]]:
    """Return depths at flat pixel indices (n,) of a tile; `plane` is its first pixel's depth and slopes right, down."""
    row, column = np.divmod(pixel, side)
    corner, right, down = plane
    return np.asarray(corner + right * column + down * row)


REGION_SIZE_PX = 128
"""Side of the region that one thread composites at a time [pixels]."""
TILE_SIDES = ((32.0, 2), (2000.0, 4), (np.inf, 8))
"""Pairs of a largest mean area of the splats' bounding boxes [pixels²] and the side of a tile [pixels]: small tiles
waste fewer pixels on small splats, large ones need fewer splat–tile pairs for large splats. The image is the same."""

Result = TypeVar("Result")


def render_splats(splats: Splats, camera: Camera, *, low_pass: float = LOW_PASS_PX2, threads: int = 1) -> SplatView:
    """Render the view of a camera, front to back, in float32.

    Parameters
    ----------
    splats : Splats
        The splats.
    camera : Camera
        The camera, in the splats' frame and unit.
    low_pass : float
        Variance added to every footprint [pixels²].
    threads : int
        Number of threads; the result is the same, byte for byte, with any number.

    Returns
    -------
    SplatView
        The view.

    Raises
    ------
    UsageError
        If `low_pass` is negative or not finite.

    Notes
    -----
    α-compositing as in Kerbl et al. 2023; a pixel is finished once its transmittance is below 1e-5.
    """
    pool = _ThreadMap(threads)
    footprints = concatenate_footprints(
        pool.run(partial(project_chunk, splats, camera, low_pass), split_into_chunks(len(splats)))
    )
    order, base = sort_front_to_back(footprints), float(footprints.depth.min(initial=np.inf))
    colours = pool.run(partial(_compute_colours, splats, camera, footprints.index), split_into_chunks(len(footprints)))
    colour = np.concatenate(colours, axis=1)
    side = _choose_tile_side(footprints)
    regions = [
        Region(left, top, min(REGION_SIZE_PX, camera.width - left), min(REGION_SIZE_PX, camera.height - top), side)
        for top in range(0, camera.height, REGION_SIZE_PX)
        for left in range(0, camera.width, REGION_SIZE_PX)
    ]
    rgb = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    depth, median, opacity = (np.empty(rgb.shape[:2], dtype=np.float32) for _ in range(3))
    view = SplatView(camera, rgb, depth, median, opacity, len(footprints), 0)

    def paint(region: Region) -> int:
        canvas, pairs = composite_region(footprints, order, colour, base, region)
        _write_region(view, canvas, base)
        return pairs

    return replace(view, pairs=sum(pool.run(paint, regions)))


class _ThreadMap:
    """Small thread pool; `run` maps a function over items and returns the results in order."""

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def run(self, function: Callable[..., Result], items: Iterable[object]) -> list[Result]:
        queue = list(items)
        if min(self._threads, len(queue)) < 2:
            return [function(item) for item in queue]
        with ThreadPoolExecutor(min(self._threads, len(queue))) as pool:
            return list(pool.map(function, queue))


def _choose_tile_side(prints: Footprints) -> int:
    area = np.mean((prints.right - prints.left) * (prints.bottom - prints.top)) if len(prints) else 0.0
    return next(side for max_area, side in TILE_SIDES if area < max_area)


def _compute_colours(splats: Splats, camera: Camera, visible: Int, chunk: slice) -> NDArray[np.float32]:
    """Return the display-referred colors (3, n) of one chunk of the visible splats, as seen from the camera."""
    index = visible[chunk]
    add_work("splats", len(index))
    colours = evaluate_sh_colours(splats.harmonics[index], compute_view_directions(splats.means[index], camera))
    return np.ascontiguousarray(colours.T, dtype=np.float32)


def _write_region(view: SplatView, canvas: Canvas, base: float) -> None:
    """Write the result of a region into the view's images."""
    region = canvas.region
    window = np.s_[region.top : region.top + region.height, region.left : region.left + region.width]
    weight, weighted = canvas.to_image(canvas.weight), canvas.to_image(canvas.depth())
    colour = [canvas.to_image(channel) for channel in canvas.sums[3:]]
    covered = weight > 0.0
    view.rgb[window] = np.stack(colour, axis=-1)
    view.depth[window] = np.where(covered, base + weighted / np.where(covered, weight, 1.0), np.inf)
    view.median[window] = base + canvas.to_image(canvas.median).astype(np.float64)
    view.opacity[window] = np.minimum(weight, 1.0)
