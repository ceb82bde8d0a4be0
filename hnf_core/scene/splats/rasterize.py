"""What a camera sees of splats.

Splats composited front to back in one region of a picture: small tiles, many tiles and many splats at once.

Splats seen by a camera, on the CPU: what the reference defines, fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

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
    """One view of splats, in the unit of its camera.

    rgb: (H, W, 3) display-referred (sRGB) colour over black, Σ w c: the space splats are trained in. depth: (H, W)
    expected planar depth, Σ w z / Σ w, inf where opacity is 0. median: (H, W) planar depth of the splat at which half
    of the light is gone, inf where opacity stays below one half. opacity: (H, W) in [0, 1], Σ w. All float32 (the
    reference: float64). drawn: splats that met the picture. pairs: Gaussians evaluated at a pixel.
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
"""Looked at together."""
INTERSECTIONS_PER_BATCH = 1 << 16
"""Pairs of a splat and a tile held at once, but for the last splat's."""
PIXELS_PER_GROUP = 1 << 12
"""Blended together, in tiles."""
PAIRS_PER_BATCH = 1 << 17
"""Pairs of a splat and a pixel held at once."""
MIN_TRANSMITTANCE = np.float32(1e-5)
"""A pixel with less light left than this is done."""

SMALLEST_TRANSMITTANCE, MIN_EXPONENT = np.float32(1e-30), np.float32(-50.0)
"""Of light and of what is left out: subnormal numbers would take a hundred times as long to multiply."""


@dataclass(frozen=True)
class Region:
    """A rectangle of a picture, in tiles of side × side pixels; those on its right and lower edge may stick out."""

    left: int
    top: int
    width: int
    height: int
    side: int

    @property
    def tiles_across(self) -> int:
        return -(-self.width // self.side)

    @property
    def tiles_down(self) -> int:
        return -(-self.height // self.side)


@dataclass(frozen=True)
class Canvas:
    """What has been blended into the T tiles of a region; P = side² pixels each. All (P, T).

    light: float32 that is left, 0 outside the region. weight: float64 Σ w. sums: (6, P, T) float64, Σ w of what `_seen`
    says. median: float32 z − base, inf = not reached yet.
    """

    region: Region
    transmittance: Single
    weight: Float
    sums: Float
    median: Single

    @classmethod
    def empty(cls, region: Region) -> Canvas:
        side = region.side
        light = np.zeros((region.tiles_down, side, region.tiles_across, side), dtype=np.float32)
        light.reshape(region.tiles_down * side, -1)[: region.height, : region.width] = 1.0
        light = np.ascontiguousarray(light.transpose(1, 3, 0, 2)).reshape(side * side, -1)
        zero = np.zeros((7, *light.shape))
        return cls(region, light, zero[0], zero[1:], np.full_like(light, np.inf))

    def depth(self) -> Float:
        """(P, T) Σ w (z − base)."""
        pixel = np.arange(self.region.side**2)[:, None]
        return np.asarray(_evaluate_depth_plane(self.sums[:3], pixel, self.region.side), dtype=np.float64)

    def to_image(self, values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """(P, T) → (height, width)."""
        side, down, across = self.region.side, self.region.tiles_down, self.region.tiles_across
        whole = values.reshape(side, side, down, across).transpose(2, 0, 3, 1)
        return whole.reshape(down * side, -1)[: self.region.height, : self.region.width]


@dataclass(frozen=True)
class TileIntersections:
    """Splats that meet tiles, tile by tile, each tile's front to back. splat: (I,) index into the footprints.
    tile: (A,) those met. start, end: (A,) where each one's splats lie."""

    splat: Int
    tile: Int
    start: Int
    end: Int


def composite_region(
    footprints: Footprints, order: Int, colour: Single, base: float, region: Region
) -> tuple[Canvas, int]:
    """A region of a picture, at most 65,536 tiles, and how many pairs of a splat and a pixel it took.

    order: (M,) of the footprints, front to back. colour: (3, M) of the footprints. base: a depth that others are kept
    relative to, so that float32 is spent on what differs.
    """
    canvas, pairs, at = Canvas.empty(region), 0, 0
    right, bottom = region.left + region.width, region.top + region.height
    met = (
        (footprints.left < right)
        & (footprints.right > region.left)
        & (footprints.top < bottom)
        & (footprints.bottom > region.top)
    )
    mine = order[met[order]]
    footprints, colour = footprints.take(mine), colour[:, mine]
    while at < len(footprints):
        open_ = (canvas.transmittance >= MIN_TRANSMITTANCE).any(axis=0)
        if not open_.any():
            break
        with np.errstate(over="ignore"):  # far from a needle q is beyond float32
            touches, at = _intersect_tiles(footprints, at, region, open_)
            pairs += _composite_tiles(canvas, footprints, colour, base, touches)
    return canvas, pairs


def _intersect_tiles(prints: Footprints, at: int, region: Region, open_: Bool) -> tuple[TileIntersections, int]:
    """Of the foremost splats from `at` on with the tiles that are still open, and where the next ones begin."""
    span, side = np.s_[at : at + SPLATS_PER_BATCH], region.side
    left = np.maximum(prints.left[span] - region.left, 0) // side
    right = (np.minimum(prints.right[span] - region.left, region.width) - 1) // side + 1
    top = np.maximum(prints.top[span] - region.top, 0) // side
    bottom = (np.minimum(prints.bottom[span] - region.top, region.height) - 1) // side + 1
    seen = _has_open_tile(open_.reshape(region.tiles_down, region.tiles_across), left, right, top, bottom)
    count = np.where(seen, (right - left) * (bottom - top), 0)
    taken = int(np.searchsorted(np.cumsum(count), INTERSECTIONS_PER_BATCH)) + 1
    which = np.flatnonzero(seen[:taken])
    count, wide = count[which], (right - left)[which]

    member = np.repeat(np.arange(len(which)), count)
    place = np.arange(len(member)) - (np.cumsum(count) - count)[member]
    row = ((place + 0.5) / wide[member]).astype(np.intp)  # whole numbers divide more slowly
    y, x, splat = top[which][member] + row, left[which][member] + place - row * wide[member], which[member] + at
    kept = np.flatnonzero(open_[y * region.tiles_across + x])
    y, x, splat = y[kept], x[kept], splat[kept]
    kept = np.flatnonzero(_may_reach_tile(prints, splat, region.left + side * x, region.top + side * y, side))
    tile, splat = (y[kept] * region.tiles_across + x[kept]).astype(np.uint16), splat[kept]
    order = np.argsort(tile, kind="stable")
    found = np.bincount(tile, minlength=len(open_))
    met, end = np.flatnonzero(found), np.cumsum(found)
    return TileIntersections(splat[order], met, (end - found)[met], end[met]), at + min(taken, len(seen))


def _has_open_tile(open_: Bool, left: Int, right: Int, top: Int, bottom: Int) -> Bool:
    """Which boxes of tiles hold an open one (summed areas)."""
    if open_.all():
        return np.ones(len(left), dtype=np.bool_)
    total = np.zeros((open_.shape[0] + 1, open_.shape[1] + 1), dtype=np.int32)
    total[1:, 1:] = open_.cumsum(axis=0, dtype=np.int32).cumsum(axis=1)
    return np.asarray(total[bottom, right] - total[bottom, left] > total[top, right] - total[top, left])


def _may_reach_tile(prints: Footprints, splat: Int, left: Int, top: Int, side: int) -> Bool:
    """False where an ellipse surely misses a tile: no pixel is nearer to it, in the Mahalanobis distance, than the
    tile's middle less what half its diagonal can make."""
    steep, across, _ = evaluate_quadratic_form(prints, splat, top + (0.5 * side - 0.5))
    offset = left + 0.5 * side - across
    q = steep + prints.precision[splat] * (offset * offset)
    return np.asarray(q <= (np.square(np.sqrt(prints.cutoff) + np.sqrt(0.5) * side * prints.inverse_std))[splat])


def _composite_tiles(
    canvas: Canvas, prints: Footprints, colour: Single, base: float, touches: TileIntersections
) -> int:
    """Blend them in; returns how many pairs had a part in it. Tiles go together with those that have as many splats."""
    pairs, size, depths = 0, canvas.region.side**2, touches.end - touches.start
    alike = np.argsort(depths, kind="stable")
    for first in range(0, len(alike), PIXELS_PER_GROUP // size):
        group = alike[first : first + PIXELS_PER_GROUP // size]
        tile, start, end = touches.tile[group], touches.start[group], touches.end[group]
        while len(tile):
            layers = int(min(max(PAIRS_PER_BATCH // (size * len(tile)), 1), (end - start).max()))
            at = start + np.arange(layers)[:, None]
            there = at < end
            splat = touches.splat[np.where(there, at, 0)]
            pairs += _composite_layers(canvas, prints, colour, base, tile, splat, there)
            start = start + layers
            rest = np.flatnonzero((start < end) & (canvas.transmittance[:, tile] >= MIN_TRANSMITTANCE).any(axis=0))
            tile, start, end = tile[rest], start[rest], end[rest]
    return pairs


def _composite_layers(
    canvas: Canvas, prints: Footprints, colour: Single, base: float, tile: Int, splat: Int, there: Bool
) -> int:
    """L splats, one behind the other, in each of A tiles. splat, there: (L, A)."""
    y, x = np.divmod(tile, canvas.region.tiles_across)
    side = canvas.region.side
    left, top = canvas.region.left + side * x, canvas.region.top + side * y
    alpha, covered = _evaluate_alpha(prints, left, top, side, splat, there)
    light = np.empty((len(splat) + 1, *alpha.shape[1:]), dtype=np.float32)
    light[0] = canvas.transmittance[:, tile]
    np.subtract(np.float32(1.0), alpha, out=light[1:])
    for layer in range(len(splat)):  # multiply.accumulate takes ten times as long
        light[layer + 1] *= light[layer]
        np.maximum(light[layer + 1], SMALLEST_TRANSMITTANCE, out=light[layer + 1])
    canvas.transmittance[:, tile] = light[-1]
    seen = _evaluate_layer_attributes(prints, colour, base, left, top, splat)

    pixel, which = np.nonzero((light[0] > MEDIAN_TRANSMITTANCE) & (light[-1] <= MEDIAN_TRANSMITTANCE))
    layer = np.argmax(light[1:, pixel, which] <= MEDIAN_TRANSMITTANCE, axis=0)
    canvas.median[pixel, tile[which]] = _evaluate_depth_plane(seen[:3, layer, which], pixel, side)

    covered &= light[:-1] >= MIN_TRANSMITTANCE
    weight = alpha
    weight *= light[:-1]
    weight *= covered
    canvas.weight[:, tile] += weight.sum(axis=0)
    canvas.sums[:, :, tile] += np.einsum("lpa,kla->kpa", weight, seen)
    return int(np.count_nonzero(covered))


def _evaluate_alpha(prints: Footprints, left: Int, top: Int, side: int, splat: Int, there: Bool) -> tuple[Single, Bool]:
    """(L, P, A), and which of them count: q decides in float64, as it does for the reference. The others are 0."""
    steps = np.arange(side)[:, None]
    steep, across, _ = evaluate_quadratic_form(prints, splat[:, None], (top + steps)[None])
    q = (left + steps + 0.5) - across[:, :, None]
    q *= q
    q *= prints.precision[splat][:, None, None]
    q += steep[:, :, None]
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
    """(6, L, A): depth less base in the middle of a tile's first pixel, its growth per pixel right and down, colour."""
    along, aside = top + 0.5 - prints.v[splat], left + 0.5 - prints.u[splat]
    rise_x, rise_y = prints.depth_slope_x[splat], prints.depth_slope_y[splat]
    corner = prints.depth[splat] - base + rise_x * aside + rise_y * along
    return np.stack([each.astype(np.float32) for each in (corner, rise_x, rise_y)] + [each[splat] for each in colour])


def _evaluate_depth_plane(plane: NDArray[np.floating[Any]], pixel: Int, side: int) -> NDArray[np.floating[Any]]:
    """Of pixels (n,) of a tile, from depth in its first pixel and the growth right and down, (3, n, ...)."""
    row, column = np.divmod(pixel, side)
    corner, right, down = plane
    return np.asarray(corner + right * column + down * row)


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
