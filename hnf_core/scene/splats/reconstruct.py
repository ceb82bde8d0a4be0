"""What the views say of the vertices of a surface: where it really is, its colour, and how far they agree.

How far a reconstructed surface is to be trusted, in numbers and in words.

A surface to stroke, out of splats: cleaned, seen from all around, fused, meshed, and laid where the views see it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, UsageError
from ..camera import Camera
from .depth_views import DepthView, make_depth_view, make_surrounding_cameras, sample_points
from .gaussians import Splats
from .prune import PruneResult, prune_splats
from .rasterize import SplatView, render_splats
from .surface_nets import extract_surface
from .tsdf import THICKNESS, find_band, fuse_depth_views
from .voxel_grid import find_nearest_triangles, label_components

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]

MAX_VIEW_DISTANCE_PX = 2.5
"""Pixels around a vertex in which a view speaks of it; more than the surface was thickened by."""
MIN_FACING_COSINE = 0.2
"""Cosine between view and normal from which a view speaks of a vertex."""
MIN_SHEET_THICKNESS_PX = 0.5
"""Pixels that the two sides of a sheet are kept apart, so that it is clear which one is touched."""

SMOOTHING_FACTOR = 0.5
"""Of the way to the middle of its neighbours that a vertex goes each time."""


@dataclass(frozen=True)
class VertexObservations:
    """Of V vertices, lengths in pixels. height: (V,) mean signed distance of the vertex above the seen surface, along
    its normal; 0 where no view speaks. spread: (V,) its standard deviation among the views. views: (V,) how many
    speak. back: (V,) how far behind the vertex the other side lies, inf where none is seen near. colour: (V, 3)
    linear."""

    height: Single
    spread: Single
    views: NDArray[np.int32]
    back: Single
    colour: Single

    def take(self, which: NDArray[np.integer[Any]]) -> VertexObservations:
        """Those of some vertices."""
        return VertexObservations(*(getattr(self, each.name)[which] for each in fields(self)))


def observe_vertices(depth_views: Sequence[DepthView], vertices: Float, normals: Float) -> VertexObservations:
    """vertices, normals: (V, 3). Views weigh opacity · cos θ of the surface seen · cos θ of the vertex's normal."""
    points, facing = vertices.astype(np.float32), normals.astype(np.float32)
    count = len(points)
    weight, first, second = (np.zeros(count, dtype=np.float32) for _ in range(3))
    behind, other = (np.zeros(count, dtype=np.float32) for _ in range(2))
    views, colour = np.zeros(count, dtype=np.int32), np.zeros((count, 3), dtype=np.float32)
    for sight in depth_views:
        seen = sample_points(sight, points)
        pixel = np.maximum(seen.pixel, 0)
        cosine = sight.cosine.reshape(-1)[pixel]
        distance = np.where(np.isfinite(seen.ahead), seen.ahead, np.float32(10.0 * MAX_VIEW_DISTANCE_PX)) * cosine
        toward = facing @ -sight.camera.pose[:3, 2].astype(np.float32)
        near = np.abs(distance) < MAX_VIEW_DISTANCE_PX
        said = np.where(near, sight.opacity.reshape(-1)[pixel] * cosine, np.float32(0.0))
        front = said * np.maximum(toward, 0.0) * (toward > MIN_FACING_COSINE)
        back = said * np.maximum(-toward, 0.0) * (toward < -MIN_FACING_COSINE)
        weight += front
        first += front * distance
        second += front * distance * distance
        views += front > 0.0
        behind += back
        other += back * distance
        colour += front[:, None] * sight.rgb.reshape(-1, 3)[pixel]
    safe = np.where(weight > 0.0, weight, np.float32(1.0))
    mean = first / safe
    return VertexObservations(
        height=mean,
        spread=np.sqrt(np.maximum(second / safe - mean * mean, 0.0)),
        views=views,
        back=np.where(behind > 0.0, -other / np.where(behind > 0.0, behind, np.float32(1.0)), np.float32(np.inf)),
        colour=colour / safe[:, None],
    )


def refine_vertices(
    vertices: Float, normals: Float, triangles: Int, observed: VertexObservations, default_height: float
) -> Float:
    """Vertices moved along their normals down to the surface seen, by no more than NEAR, and across them towards the
    middle of their neighbours, so that no triangle folds over (the elastic part of Gibson's nets).

    Those that no view speaks of move as their neighbours do, at first by unseen. The two sides of a sheet stay SHEET
    apart. A hole's rim only moves along the normals.
    """
    told = observed.views > 0
    fall = np.where(told, observed.height, default_height).astype(np.float64)
    thick = np.where(np.isfinite(observed.back), observed.back - fall, np.inf)
    fall = fall - np.clip(0.5 * (MIN_SHEET_THICKNESS_PX - thick), 0.0, 0.5 * MIN_SHEET_THICKNESS_PX)
    links = _EdgeGraph.build(triangles, len(vertices))
    aside = np.stack([links.mean(each) for each in vertices.T], axis=1) - vertices
    aside = np.where(links.rim[:, None], 0.0, aside - np.sum(aside * normals, axis=1, keepdims=True) * normals)
    fall = 0.5 * (fall + links.mean(fall))
    return np.asarray(vertices - fall[:, None] * normals + SMOOTHING_FACTOR * aside)


@dataclass(frozen=True)
class _EdgeGraph:
    """Edges of a mesh, both ways. degree: (V,). rim: (V,) whether an edge there has one triangle only."""

    start: Int
    end: Int
    degree: Int
    rim: NDArray[np.bool_]

    @staticmethod
    def build(triangles: Int, count: int) -> _EdgeGraph:
        ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        keys, times = np.unique(ends.min(axis=1) * count + ends.max(axis=1), return_counts=True)
        low, high = keys // count, keys % count
        start, end = np.concatenate([low, high]), np.concatenate([high, low])
        rim = np.zeros(count, dtype=np.bool_)
        rim[low[times == 1]] = rim[high[times == 1]] = True
        return _EdgeGraph(start, end, np.maximum(np.bincount(start, minlength=count), 1), rim)

    def mean(self, values: Float) -> Float:
        """(V,) the mean over each vertex's neighbours."""
        return np.asarray(np.bincount(self.start, weights=values[self.end], minlength=len(self.degree)) / self.degree)


def compute_vertex_normals(vertices: Float, triangles: Int) -> Float:
    """(V, 3) unit normals: the mean of the faces around, weighted by area; +Z where they cancel."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    who, count = triangles.reshape(-1), len(vertices)
    total = np.stack([np.bincount(who, weights=np.repeat(each, 3), minlength=count) for each in face.T], axis=1)
    size = np.linalg.norm(total, axis=1)
    total[size <= 0.0], size[size <= 0.0] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(total / size[:, None])


OPAQUE_OPACITY = 0.5
"""Opacity from which a splat's centre should lie on the surface."""
NEAR_SPACINGS = 2.0
SEARCH_SPACINGS = 4.0
"""Spacings: near the surface; as far as it is looked for."""
MAX_SAMPLED_SPLATS = 1 << 12
"""Splats whose distance is taken, evenly chosen: a share of so many is right to 0.8 %."""
MIN_NEAR_SHARE = 0.6
MAX_OPEN_SHARE = 0.05
MAX_TRANSLUCENT_SHARE = 0.2
MAX_RAGGED_SHARE = 0.25
MIN_RETAINED_SHARE = 0.7
MIN_SPLATS = 200
TRANSLUCENT_RANGE = (0.1, 0.9)
"""Opacity between which a pixel shows neither something solid nor nothing."""
DEPTH_JUMP_PX = 3.0
"""Pixels of depth between two neighbours that no surface has, but at an outline."""


@dataclass(frozen=True)
class Clarity:
    """What views look like. translucent: share of the pixels showing anything that are TRANSLUCENT. ragged: share of
    neighbouring pixels with a CLIFF between them. Both are small where there is a surface, whatever its shape."""

    translucent: float
    ragged: float


def measure_clarity(depth_views: Sequence[DepthView]) -> Clarity:
    """Over all the views; lengths in their pixels."""
    shown = pale = pairs = cliffs = 0
    for sight in depth_views:
        shown += int(np.count_nonzero(sight.opacity > TRANSLUCENT_RANGE[0]))
        pale += int(np.count_nonzero((sight.opacity > TRANSLUCENT_RANGE[0]) & (sight.opacity < TRANSLUCENT_RANGE[1])))
        for axis in (0, 1):
            with np.errstate(invalid="ignore"):
                step = np.abs(np.diff(sight.depth, axis=axis))
            pairs += int(np.count_nonzero(np.isfinite(step)))
            cliffs += int(np.count_nonzero(np.isfinite(step) & (step > DEPTH_JUMP_PX)))
    return Clarity(pale / max(shown, 1), cliffs / max(pairs, 1))


@dataclass(frozen=True)
class Quality:
    """median, most: distance of the opaque splats' centres to the surface, half of them and 95 % within it, in the
    cloud's unit (inf: beyond REACH spacings). spacing: of the surface's vertices, in that unit. near: share of the
    opaque splats' opacity within NEAR spacings. kept: share of all opacity that cleaning left. spread: median over the
    vertices of how far the views disagree on their depth (standard deviation), in spacings. views: how many views see
    the median vertex. open: share of edges with one triangle only. pieces: connected parts. clarity: of the views.
    warnings: what makes it too poor to touch, for an artist to read."""

    median: float
    most: float
    spacing: float
    near: float
    retained: float
    spread: float
    views: float
    open: float
    components: int
    clarity: Clarity
    warnings: tuple[str, ...]

    @property
    def touchable(self) -> bool:
        """Nothing to warn of."""
        return not self.warnings

    def summary(self) -> str:
        """One sentence."""
        half, most = (
            f"{each / self.spacing:.1f}" if np.isfinite(each) else f"more than {SEARCH_SPACINGS:.0f}"
            for each in (self.median, self.most)
        )
        return (
            f"Half of the opaque splats lie within {half} and 95 % within {most} spacings ({self.spacing:.3g} units) "
            f"of the surface; the views disagree by {self.spread:.2f} spacings; "
            f"{100 * self.open:.1f} % of its edges are open."
        )


def measure_surface_distance(
    splats: Splats, vertices: Float, triangles: NDArray[np.integer[Any]], spacing: float
) -> tuple[Float, Float]:
    """Distances of the opaque splats' centres to the surface, inf beyond REACH spacings, and their opacities.

    Where no splat is opaque, of all of them.
    """
    opaque = splats.opacities >= OPAQUE_OPACITY
    which = np.flatnonzero(opaque if opaque.any() else np.ones(len(splats), dtype=np.bool_))
    chosen = splats.take(which[:: max(1, -(-len(which) // MAX_SAMPLED_SPLATS))])
    found = find_nearest_triangles(vertices, triangles, chosen.means, SEARCH_SPACINGS * spacing)
    return found.distance, chosen.opacities.astype(np.float64)


def assess_quality(
    splats: Splats,
    retained: float,
    vertices: Float,
    triangles: NDArray[np.integer[Any]],
    spacing: float,
    spread: NDArray[np.floating[Any]],
    views: NDArray[np.integer[Any]],
    components: int,
    clarity: Clarity,
) -> Quality:
    """splats: the cleaned ones, in the frame of vertices (V, 3). kept: share of all opacity in them. spread: (V,), in
    spacings, of the vertices that views (V,) see."""
    distance, weight = measure_surface_distance(splats, vertices, triangles, spacing)
    median, most = (float(each) for each in np.quantile(distance, (0.5, 0.95), method="higher"))
    near = float(weight[distance <= NEAR_SPACINGS * spacing].sum() / weight.sum())
    seen = views > 0
    disagreement = float(np.median(spread[seen])) if seen.any() else float("inf")
    open_ = compute_open_edge_share(triangles)
    return Quality(
        median, most, spacing, near, retained, disagreement, float(np.median(views)), open_, components, clarity,
        _make_warnings(len(splats), near, retained, open_, clarity),
    )  # fmt: skip


def compute_open_edge_share(triangles: NDArray[np.integer[Any]]) -> float:
    """Share of the edges that belong to one triangle only."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys = edges[:, 0].astype(np.int64) * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    _, count = np.unique(keys, return_counts=True)
    return float((count == 1).mean()) if len(count) else 1.0


def _make_warnings(count: int, near: float, retained: float, open_: float, clarity: Clarity) -> tuple[str, ...]:
    said = []
    if count < MIN_SPLATS:
        said.append(f"There are only {count} splats: too few to make a surface.")
    if near < MIN_NEAR_SHARE:
        said.append(
            f"Only {100 * near:.0f} % of the opaque splats lie near the surface: this is a cloud or fog more than a "
            "solid thing, or most of it is hidden inside."
        )
    if clarity.translucent > MAX_TRANSLUCENT_SHARE:
        said.append(
            f"{100 * clarity.translucent:.0f} % of what the views show is half transparent: fog, glass, or splats too "
            "small for the gaps between them."
        )
    if clarity.ragged > MAX_RAGGED_SHARE:
        said.append(
            f"Depth jumps between {100 * clarity.ragged:.0f} % of neighbouring pixels: the splats are loose grains, "
            f"not "
            "a surface. Use fewer cells, or train the reconstruction longer."
        )
    if open_ > MAX_OPEN_SHARE:
        said.append(
            f"{100 * open_:.0f} % of the surface's edges are open: it is full of holes. Touch only where it is whole, "
            "or use fewer cells."
        )
    if retained < MIN_RETAINED_SHARE:
        said.append(f"Cleaning dropped {100 * (1 - retained):.0f} % of the cloud as floating, blurred or far away.")
    return tuple(said)


RenderFunction = Callable[[Splats, Camera], SplatView]
Progress = Callable[[str, float], None]

DEFAULT_CELLS = 256
"""Along the longest axis."""
MIN_CELLS, MAX_CELLS = 8, 2048
DEFAULT_VIEWS = 32
MAX_VIEW_MARGIN = 20.0
"""Cells around a splat's centre that a view sees, at most."""
REFINEMENT_ROUNDS = 2
"""Rounds in which vertices go where the views see the surface; a third moves them by less than 0.01 spacings."""
MIN_COMPONENT_AREA_SHARE = 0.005
"""Of the area; smaller connected pieces are left out."""


@dataclass(frozen=True)
class SplatSurface:
    """A triangle mesh in the frame and unit of its splats.

    vertices: (V, 3) float32. triangles: (T, 3) int32, counter-clockwise from outside. normals: (V, 3) float32 unit,
    outwards. colour: (V, 3) float32 linear. support: (V,) float32, how many views see the vertex. spread: (V,) float32
    standard deviation of its depth among them. spacing: of the grid that it was made in. cleaned: what it was made
    from. quality: how far to trust it.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    colour: NDArray[np.float32]
    support: NDArray[np.float32]
    spread: NDArray[np.float32]
    spacing: float
    pruned: PruneResult
    quality: Quality


def reconstruct_surface(
    splats: Splats,
    *,
    cells: int = DEFAULT_CELLS,
    views: int = DEFAULT_VIEWS,
    progress: Progress | None = None,
    render: RenderFunction = render_splats,
    where: str = "",
) -> SplatSurface:
    """cells: along the longest axis of the cleaned cloud. views: orthographic pictures from all around.

    progress: called with a stage's name and the share of the whole that is done, from 0 to 1; who wants to stop raises
    from it. Raises UsageError for cells or views out of range, and SceneError where nothing solid is seen.
    """
    if not MIN_CELLS <= cells <= MAX_CELLS:
        raise UsageError(f"{cells} cells.", remedy=f"Choose {MIN_CELLS} to {MAX_CELLS} along the longest axis.")
    if not 6 <= views <= 1000:
        raise UsageError(f"{views} views.", remedy="Choose 6 to 1000.")
    tell: Progress = progress or (lambda _stage, _share: None)
    tell("cleaning", 0.0)
    cleaned = prune_splats(splats, where=where)
    local, middle, spacing = _scale_to_cells(cleaned.splats, cells)
    sights = _render_depth_views(local, views, render, tell)
    tell("fusing", 0.75)
    grid, origin, keys = find_band(sights)
    band = fuse_depth_views(sights, grid, origin, keys)
    tell("meshing", 0.85)
    net = extract_surface(band.samples)
    if len(net.triangles) == 0:
        raise SceneError(
            "no view shows anything solid.", where=where, remedy="Its splats are too faint or too few; use fewer cells."
        )
    tell("settling", 0.9)
    vertices, triangles, seen = _refine_surface(sights, net.vertices + origin, net.triangles)
    vertices, triangles, seen = _drop_small_components(vertices, triangles, seen)
    if len(triangles) == 0:
        raise SceneError("no surface is seen.", where=where, remedy="Use fewer cells, or more views.")
    tell("judging", 0.95)
    pieces = len(
        np.unique(label_components(len(vertices), np.repeat(triangles[:, 0], 2), triangles[:, 1:].reshape(-1)))
    )
    share = float(cleaned.splats.opacities.sum(dtype=np.float64) / np.nansum(splats.opacities, dtype=np.float64))
    report = assess_quality(
        local, share, vertices, triangles, 1.0, seen.spread, seen.views, pieces, measure_clarity(sights)
    )
    tell("done", 1.0)
    return SplatSurface(
        vertices=(vertices * spacing + middle).astype(np.float32),
        triangles=triangles.astype(np.int32),
        normals=compute_vertex_normals(vertices, triangles).astype(np.float32),
        colour=seen.colour,
        support=seen.views.astype(np.float32),
        spread=seen.spread * np.float32(spacing),
        spacing=spacing,
        pruned=cleaned,
        quality=replace(report, median=report.median * spacing, most=report.most * spacing, spacing=spacing),
    )


def _scale_to_cells(splats: Splats, cells: int) -> tuple[Splats, Float, float]:
    """The cloud with a cell's side as its unit, around its middle: what follows knows no scale. That middle, and the
    side."""
    means = splats.means.astype(np.float64)
    low, high = means.min(axis=0), means.max(axis=0)
    side, middle = float((high - low).max()) / cells, (low + high) / 2.0
    local = replace(
        splats,
        means=((means - middle) / side).astype(np.float32),
        scales=(splats.scales.astype(np.float64) / side).astype(np.float32),
    )
    return local, middle, side


def _render_depth_views(local: Splats, views: int, render: RenderFunction, progress: Progress) -> list[DepthView]:
    reach = np.minimum(2.0 * local.scales.max(axis=1).astype(np.float64), MAX_VIEW_MARGIN)
    cameras = make_surrounding_cameras(local.means.astype(np.float64), reach, views, 1.0)
    sights = []
    for done, camera in enumerate(cameras):
        progress("looking", 0.05 + 0.7 * done / len(cameras))
        sights.append(make_depth_view(render(local, camera)))
    return sights


def _refine_surface(
    depth_views: list[DepthView], vertices: Float, triangles: Int
) -> tuple[Float, Int, VertexObservations]:
    unseen = THICKNESS
    for _ in range(REFINEMENT_ROUNDS):
        normals = compute_vertex_normals(vertices, triangles)
        vertices = refine_vertices(
            vertices, normals, triangles, observe_vertices(depth_views, vertices, normals), unseen
        )
        unseen = 0.0
    return vertices, triangles, observe_vertices(depth_views, vertices, compute_vertex_normals(vertices, triangles))


def _drop_small_components(
    vertices: Float, triangles: Int, observed: VertexObservations
) -> tuple[Float, Int, VertexObservations]:
    """Without triangles none of whose corners any view sees, and without pieces under SMALLEST_PIECE of the area."""
    triangles = triangles[(observed.views[triangles] > 0).any(axis=1)]
    label = label_components(len(vertices), np.repeat(triangles[:, 0], 2), triangles[:, 1:].reshape(-1))[
        triangles[:, 0]
    ]
    corner = vertices[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    held = np.bincount(label, weights=area, minlength=len(vertices))[label]
    used, kept = np.unique(triangles[held >= MIN_COMPONENT_AREA_SHARE * area.sum()], return_inverse=True)
    return vertices[used], kept.reshape(-1, 3).astype(np.int64), observed.take(used)
