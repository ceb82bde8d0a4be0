"""Reconstruction of a triangle mesh from splats, with a measure of its quality.

The splats are pruned and rendered as depth views (orthographic depth images) from all around; the views are fused to a
truncated signed distance field (TSDF), surface nets mesh it, and the vertices move to the depth that the views show.
The quality compares the mesh with the splats, and the views with each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, UsageError
from ...progress import Progress, ProgressCallback, add_work, ignore_progress
from .depth_views import DepthView, make_depth_view, make_surrounding_cameras, sample_points
from .gaussians import Splats
from .prune import PruneResult, prune_splats
from .rasterize import render_splats
from .tsdf import THICKNESS, extract_surface, find_band, find_nearest_triangles, fuse_depth_views, label_components

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]

MAX_VIEW_DISTANCE_PX = 2.5
"""Largest distance of a vertex from a view's surface at which the view counts [pixels]; more than `tsdf.THICKNESS`."""
MIN_FACING_COSINE = 0.2
"""Least cosine between viewing direction and vertex normal at which a view counts."""
MIN_SHEET_THICKNESS_PX = 0.5
"""Least distance between the two sides of a sheet [pixels], so that it is clear which one is touched."""

SMOOTHING_FACTOR = 0.5
"""Laplacian smoothing factor: fraction of the distance to the neighbours' centroid moved per iteration."""


@dataclass(frozen=True)
class VertexObservations:
    """Averages of what the depth views show at each of V mesh vertices; lengths in pixels.

    Attributes
    ----------
    height : ndarray of float32, shape (V,)
        Mean signed distance of the vertex above the visible surface along its normal; 0 if no view sees it.
    spread : ndarray of float32, shape (V,)
        Standard deviation of that distance among the views.
    views : ndarray of int32, shape (V,)
        Number of views that see the vertex.
    back : ndarray of float32, shape (V,)
        Distance to the opposite side of a thin sheet, behind the vertex; inf if none is seen near.
    colour : ndarray of float32, shape (V, 3)
        Linear colour.
    """

    height: Single
    spread: Single
    views: NDArray[np.int32]
    back: Single
    colour: Single

    def take(self, which: NDArray[np.integer[Any]]) -> VertexObservations:
        """Return the observations of some vertices."""
        return VertexObservations(*(getattr(self, field.name)[which] for field in fields(self)))


def observe_vertices(depth_views: Iterable[DepthView], vertices: Float, normals: Float) -> VertexObservations:
    """Average over the depth views the height of the visible surface and its color at each vertex.

    A view's weight is opacity · cos θ₁ · cos θ₂, the angles between the view and the normals of the visible surface and
    of the vertex.

    Parameters
    ----------
    depth_views : iterable of DepthView
        The views.
    vertices : ndarray, shape (V, 3)
        Positions [pixels].
    normals : ndarray, shape (V, 3)
        Unit normals.

    Returns
    -------
    VertexObservations
        Observations per vertex.
    """
    points, normals32 = vertices.astype(np.float32), normals.astype(np.float32)
    count = len(points)
    weight, distance_sum, square_sum = (np.zeros(count, dtype=np.float32) for _ in range(3))
    back_weight, back_sum = (np.zeros(count, dtype=np.float32) for _ in range(2))
    views, colour = np.zeros(count, dtype=np.int32), np.zeros((count, 3), dtype=np.float32)
    for view in depth_views:
        sample = sample_points(view, points)
        pixel = np.maximum(sample.pixel, 0)
        cosine = view.cosine.reshape(-1)[pixel]
        distance = np.where(np.isfinite(sample.ahead), sample.ahead, np.float32(10.0 * MAX_VIEW_DISTANCE_PX)) * cosine
        facing = normals32 @ -view.camera.pose[:3, 2].astype(np.float32)
        near = np.abs(distance) < MAX_VIEW_DISTANCE_PX
        view_weight = np.where(near, view.opacity.reshape(-1)[pixel] * cosine, np.float32(0.0))
        front = view_weight * np.maximum(facing, 0.0) * (facing > MIN_FACING_COSINE)
        back = view_weight * np.maximum(-facing, 0.0) * (facing < -MIN_FACING_COSINE)
        weight += front
        distance_sum += front * distance
        square_sum += front * distance * distance
        views += front > 0.0
        back_weight += back
        back_sum += back * distance
        colour += front[:, None] * view.rgb.reshape(-1, 3)[pixel]
    safe = np.where(weight > 0.0, weight, np.float32(1.0))
    mean = distance_sum / safe
    return VertexObservations(
        height=mean,
        spread=np.sqrt(np.maximum(square_sum / safe - mean * mean, 0.0)),
        views=views,
        back=np.where(
            back_weight > 0.0, -back_sum / np.where(back_weight > 0.0, back_weight, np.float32(1.0)), np.float32(np.inf)
        ),
        colour=colour / safe[:, None],
    )


def refine_vertices(
    vertices: Float, normals: Float, triangles: Int, observed: VertexObservations, default_height: float
) -> Float:
    """Move vertices along their normals to the visible surface, and across them towards their neighbours' centroid.

    The lateral motion keeps triangles from folding over (the elastic relaxation of Gibson's surface nets). Vertices
    that no view shows start from `default_height` and follow their neighbours. The two sides of a sheet stay
    `MIN_SHEET_THICKNESS_PX` apart. A hole's rim only moves along the normals.

    Parameters
    ----------
    vertices, normals : ndarray, shape (V, 3)
        Positions [pixels] and unit normals.
    triangles : ndarray of int, shape (T, 3)
        Vertex indices.
    observed : VertexObservations
        Observations of the vertices, from `observe_vertices`.
    default_height : float
        Assumed height above the surface of vertices that no view shows [pixels].

    Returns
    -------
    ndarray, shape (V, 3)
        New positions.
    """
    observed_mask = observed.views > 0
    offset = np.where(observed_mask, observed.height, default_height).astype(np.float64)
    thickness = np.where(np.isfinite(observed.back), observed.back - offset, np.inf)
    offset = offset - np.clip(0.5 * (MIN_SHEET_THICKNESS_PX - thickness), 0.0, 0.5 * MIN_SHEET_THICKNESS_PX)
    graph = _EdgeGraph.build(triangles, len(vertices))
    lateral = np.stack([graph.mean(coordinate) for coordinate in vertices.T], axis=1) - vertices
    lateral = np.where(graph.rim[:, None], 0.0, lateral - np.sum(lateral * normals, axis=1, keepdims=True) * normals)
    offset = 0.5 * (offset + graph.mean(offset))
    return np.asarray(vertices - offset[:, None] * normals + SMOOTHING_FACTOR * lateral)


@dataclass(frozen=True)
class _EdgeGraph:
    """Edges of a mesh in both directions, each vertex's number of neighbors (V,), and a mask (V,) of open borders."""

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
        """Return the mean of `values` (V,) over the neighbors of each vertex, (V,)."""
        return np.asarray(np.bincount(self.start, weights=values[self.end], minlength=len(self.degree)) / self.degree)


def compute_vertex_normals(vertices: Float, triangles: Int) -> Float:
    """Return unit normals (V, 3): the area-weighted mean of the adjacent faces' normals; +Z where they cancel."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    corner_vertex, count = triangles.reshape(-1), len(vertices)
    total = np.stack(
        [np.bincount(corner_vertex, weights=np.repeat(component, 3), minlength=count) for component in face.T], axis=1
    )
    length = np.linalg.norm(total, axis=1)
    total[length <= 0.0], length[length <= 0.0] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(total / length[:, None])


OPAQUE_OPACITY = 0.5
"""Opacity from which a splat's centre should lie on the surface."""
NEAR_SPACINGS = 2.0
"""Distance within which a splat counts as near the surface [vertex spacings]."""
SEARCH_SPACINGS = 4.0
"""Distance from a splat within which the surface is searched for [vertex spacings]."""
MAX_SAMPLED_SPLATS = 1 << 12
"""Number of splats, evenly chosen, whose distance is measured: a fraction of so many is accurate to 0.8 %."""
MIN_NEAR_SHARE = 0.6
"""Least opacity-weighted fraction of opaque splats near a good surface."""
MAX_OPEN_SHARE = 0.05
"""Largest fraction of open edges in a good surface."""
MAX_TRANSLUCENT_SHARE = 0.2
"""Largest fraction of translucent pixels in good views."""
MAX_RAGGED_SHARE = 0.25
"""Largest fraction of neighbouring pixels with a depth jump in good views."""
MIN_RETAINED_SHARE = 0.7
"""Least fraction of opacity that pruning should leave."""
MIN_SPLATS = 200
"""Least number of splats for a surface."""
TRANSLUCENT_RANGE = (0.1, 0.9)
"""Opacities between which a pixel shows neither a surface nor background."""
DEPTH_JUMP_PX = 3.0
"""Depth difference of neighbouring pixels that occurs only at outlines [pixels]."""


@dataclass(frozen=True)
class Clarity:
    """Two fractions that are small if the depth views show a clear surface rather than fog, whatever its shape.

    Attributes
    ----------
    translucent : float
        Fraction of the non-empty pixels with an opacity in `TRANSLUCENT_RANGE`.
    ragged : float
        Fraction of neighbouring pixels with a depth difference above `DEPTH_JUMP_PX`.
    """

    translucent: float
    ragged: float


def measure_clarity(depth_views: Sequence[DepthView]) -> Clarity:
    """Measure the clarity of all depth views together: translucent pixels, and depth jumps between adjacent pixels."""
    shown = translucent = pairs = jumps = 0
    for view in depth_views:
        shown += int(np.count_nonzero(view.opacity > TRANSLUCENT_RANGE[0]))
        translucent += int(
            np.count_nonzero((view.opacity > TRANSLUCENT_RANGE[0]) & (view.opacity < TRANSLUCENT_RANGE[1]))
        )
        for axis in (0, 1):
            with np.errstate(invalid="ignore"):
                step = np.abs(np.diff(view.depth, axis=axis))
            pairs += int(np.count_nonzero(np.isfinite(step)))
            jumps += int(np.count_nonzero(np.isfinite(step) & (step > DEPTH_JUMP_PX)))
    return Clarity(translucent / max(shown, 1), jumps / max(pairs, 1))


@dataclass(frozen=True)
class Quality:
    """Quality of a reconstructed surface; a vertex spacing is the side of the grid cells that it was meshed in.

    Attributes
    ----------
    median, most : float
        Distance of opaque splats' centres to the surface, median and 95th percentile, in the cloud's unit; inf beyond
        `SEARCH_SPACINGS` vertex spacings.
    spacing : float
        Vertex spacing, in the cloud's unit.
    near : float
        Fraction of the opaque splats' opacity within `NEAR_SPACINGS` vertex spacings of the surface.
    retained : float
        Fraction of all opacity left after pruning.
    spread : float
        Median over the vertices of the standard deviation of depth among views [vertex spacings].
    views : float
        Number of views that see the median vertex.
    open : float
        Fraction of edges with one triangle only, the borders of holes.
    components : int
        Number of connected components.
    clarity : Clarity
        Clarity of the views.
    warnings : tuple of str
        Reasons why the surface is too poor to touch, for an artist.
    """

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
        """True if there are no warnings."""
        return not self.warnings

    def summary(self) -> str:
        """Return the quality as one sentence."""
        half, most = (
            f"{distance / self.spacing:.1f}" if np.isfinite(distance) else f"more than {SEARCH_SPACINGS:.0f}"
            for distance in (self.median, self.most)
        )
        return (
            f"Half of the opaque splats lie within {half} and 95 % within {most} spacings ({self.spacing:.3g} units) "
            f"of the surface; the views disagree by {self.spread:.2f} spacings; "
            f"{100 * self.open:.1f} % of its edges are open."
        )


def measure_surface_distance(
    splats: Splats, vertices: Float, triangles: NDArray[np.integer[Any]], spacing: float
) -> tuple[Float, Float]:
    """Return the distances of opaque splats' centers to the surface (n,), and the splats' opacities (n,).

    Distances beyond `SEARCH_SPACINGS` vertex spacings (`spacing`) are inf. Up to `MAX_SAMPLED_SPLATS` splats are
    sampled; if none is opaque, from all.
    """
    opaque = splats.opacities >= OPAQUE_OPACITY
    candidates = np.flatnonzero(opaque if opaque.any() else np.ones(len(splats), dtype=np.bool_))
    chosen = splats.take(candidates[:: max(1, -(-len(candidates) // MAX_SAMPLED_SPLATS))])
    nearest = find_nearest_triangles(vertices, triangles, chosen.means, SEARCH_SPACINGS * spacing)
    return nearest.distance, chosen.opacities.astype(np.float64)


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
    """Assess whether a reconstructed surface is good enough to touch.

    Parameters
    ----------
    splats : Splats
        Pruned splats, in the frame of `vertices`.
    retained : float
        Fraction of the original cloud's opacity that the pruned splats hold.
    vertices : ndarray, shape (V, 3)
        Positions.
    triangles : ndarray of int, shape (T, 3)
        Vertex indices.
    spacing : float
        Spacing of the vertices, in the unit of `vertices`.
    spread : ndarray, shape (V,)
        Standard deviation of each vertex's depth among views [vertex spacings].
    views : ndarray of int, shape (V,)
        Number of views that see each vertex.
    components : int
        Number of connected components.
    clarity : Clarity
        Clarity of the depth views, from `measure_clarity`.

    Returns
    -------
    Quality
        The quality.
    """
    distance, weight = measure_surface_distance(splats, vertices, triangles, spacing)
    median, most = (float(quantile) for quantile in np.quantile(distance, (0.5, 0.95), method="higher"))
    near = float(weight[distance <= NEAR_SPACINGS * spacing].sum() / weight.sum())
    is_seen = views > 0
    disagreement = float(np.median(spread[is_seen])) if is_seen.any() else float("inf")
    open_ = compute_open_edge_share(triangles)
    return Quality(
        median, most, spacing, near, retained, disagreement, float(np.median(views)), open_, components, clarity,
        _make_warnings(len(splats), near, retained, open_, clarity),
    )  # fmt: skip


def compute_open_edge_share(triangles: NDArray[np.integer[Any]]) -> float:
    """Return the fraction of a mesh's edges that belong to one triangle only, as at the border of a hole."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys = edges[:, 0].astype(np.int64) * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    _, count = np.unique(keys, return_counts=True)
    return float((count == 1).mean()) if len(count) else 1.0


def _make_warnings(count: int, near: float, retained: float, open_: float, clarity: Clarity) -> tuple[str, ...]:
    warnings = []
    if count < MIN_SPLATS:
        warnings.append(f"There are only {count} splats: too few to make a surface.")
    if near < MIN_NEAR_SHARE:
        warnings.append(
            f"Only {100 * near:.0f} % of the opaque splats lie near the surface: this is a cloud or fog more than a "
            "solid thing, or most of it is hidden inside."
        )
    if clarity.translucent > MAX_TRANSLUCENT_SHARE:
        warnings.append(
            f"{100 * clarity.translucent:.0f} % of what the views show is half transparent: fog, glass, or splats too "
            "small for the gaps between them."
        )
    if clarity.ragged > MAX_RAGGED_SHARE:
        warnings.append(
            f"Depth jumps between {100 * clarity.ragged:.0f} % of neighboring pixels: the splats are loose grains, "
            f"not "
            "a surface. Use fewer cells, or train the reconstruction longer."
        )
    if open_ > MAX_OPEN_SHARE:
        warnings.append(
            f"{100 * open_:.0f} % of the surface's edges are open: it is full of holes. Touch only where it is whole, "
            "or use fewer cells."
        )
    if retained < MIN_RETAINED_SHARE:
        warnings.append(f"Cleaning dropped {100 * (1 - retained):.0f} % of the cloud as floating, blurred or far away.")
    return tuple(warnings)


DEFAULT_CELLS = 256
"""Number of grid cells along the longest axis of the cloud."""
MIN_CELLS, MAX_CELLS = 8, 2048
"""Accepted numbers of grid cells along the longest axis of the cloud."""
DEFAULT_VIEWS = 32
"""Number of depth views."""
MAX_VIEW_MARGIN = 20.0
"""Largest radius around a splat's center that views include [grid cells]."""
REFINEMENT_ROUNDS = 2
"""Number of rounds that move vertices to the visible surface; a third would move them by less than 0.01 vertex
spacings."""
MIN_COMPONENT_AREA_SHARE = 0.005
"""Least fraction of the area in a connected component that is kept."""


@dataclass(frozen=True)
class SplatSurface:
    """A triangle mesh in the frame and unit of its splats.

    Attributes
    ----------
    vertices : ndarray of float32, shape (V, 3)
        Positions.
    triangles : ndarray of int32, shape (T, 3)
        Vertex indices, counter-clockwise seen from outside.
    normals : ndarray of float32, shape (V, 3)
        Unit normals, outwards.
    colour : ndarray of float32, shape (V, 3)
        Linear colour.
    support : ndarray of float32, shape (V,)
        Number of views that see the vertex.
    spread : ndarray of float32, shape (V,)
        Standard deviation of the vertex's depth among these views, in the unit of the splats.
    spacing : float
        Spacing of the grid that it was meshed in, about that of the vertices.
    pruned : PruneResult
        Splats that it was made from.
    quality : Quality
        Its quality.
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
    progress: ProgressCallback = ignore_progress,
    where: str = "",
) -> SplatSurface:
    """Reconstruct a triangle mesh from splats.

    Parameters
    ----------
    splats : Splats
        The splats.
    cells : int
        Resolution: number of grid cells along the longest axis of the pruned cloud.
    views : int
        Number of orthographic depth views from all around.
    progress : callable, optional
        Called before each stage, and before each view of a stage; an exception that it raises cancels.
    where : str
        Name of the cloud in error messages.

    Returns
    -------
    SplatSurface
        The mesh.

    Raises
    ------
    UsageError
        If `cells` or `views` is out of range.
    SceneError
        If no view shows a surface.

    Notes
    -----
    Depth fusion after Curless and Levoy 1996, meshing after Gibson 1998.
    """
    if not MIN_CELLS <= cells <= MAX_CELLS:
        raise UsageError(f"{cells} cells.", remedy=f"Choose {MIN_CELLS} to {MAX_CELLS} along the longest axis.")
    if not 6 <= views <= 1000:
        raise UsageError(f"{views} views.", remedy="Choose 6 to 1000.")

    def report(stage: str, share: float) -> None:
        progress(Progress(stage, 0, 1, share))

    add_work("reconstructions", len(splats))
    report("cleaning", 0.0)
    pruned = prune_splats(splats, where=where)
    local, centre, spacing = _scale_to_cells(pruned.splats, cells)
    depth_views = _render_depth_views(local, views, report)
    report("fusing", 0.75)
    grid, origin, keys = find_band(depth_views)
    band = fuse_depth_views(_report_each(depth_views, partial(report, "fusing"), 0.75, 0.85), grid, origin, keys)
    report("meshing", 0.85)
    net = extract_surface(band.samples)
    if len(net.triangles) == 0:
        raise SceneError(
            "no view shows anything solid.", where=where, remedy="Its splats are too faint or too few; use fewer cells."
        )
    report("settling", 0.9)
    vertices, triangles, observed = _refine_surface(depth_views, net.vertices + origin, net.triangles, report)
    vertices, triangles, observed = _drop_small_components(vertices, triangles, observed)
    if len(triangles) == 0:
        raise SceneError("no surface is seen.", where=where, remedy="Use fewer cells, or more views.")
    report("judging", 0.95)
    components = len(
        np.unique(label_components(len(vertices), np.repeat(triangles[:, 0], 2), triangles[:, 1:].reshape(-1)))
    )
    retained = float(pruned.splats.opacities.sum(dtype=np.float64) / np.nansum(splats.opacities, dtype=np.float64))
    quality = assess_quality(
        local,
        retained,
        vertices,
        triangles,
        1.0,
        observed.spread,
        observed.views,
        components,
        measure_clarity(depth_views),
    )
    report("done", 1.0)
    return SplatSurface(
        vertices=(vertices * spacing + centre).astype(np.float32),
        triangles=triangles.astype(np.int32),
        normals=compute_vertex_normals(vertices, triangles).astype(np.float32),
        colour=observed.colour,
        support=observed.views.astype(np.float32),
        spread=observed.spread * np.float32(spacing),
        spacing=spacing,
        pruned=pruned,
        quality=replace(quality, median=quality.median * spacing, most=quality.most * spacing, spacing=spacing),
    )


def _scale_to_cells(splats: Splats, cells: int) -> tuple[Splats, Float, float]:
    """Return the cloud centered and scaled so that a grid cell has side 1, its former center (3,), and cell size."""
    means = splats.means.astype(np.float64)
    low, high = means.min(axis=0), means.max(axis=0)
    side, centre = float((high - low).max()) / cells, (low + high) / 2.0
    local = replace(
        splats,
        means=((means - centre) / side).astype(np.float32),
        scales=(splats.scales.astype(np.float64) / side).astype(np.float32),
    )
    return local, centre, side


def _render_depth_views(local: Splats, views: int, report: Callable[[str, float], None]) -> list[DepthView]:
    reach = np.minimum(2.0 * local.scales.max(axis=1).astype(np.float64), MAX_VIEW_MARGIN)
    cameras = make_surrounding_cameras(local.means.astype(np.float64), reach, views, 1.0)
    depth_views = []
    for index, camera in enumerate(cameras):
        report("looking", 0.05 + 0.7 * index / len(cameras))
        depth_views.append(make_depth_view(render_splats(local, camera)))
    return depth_views


def _refine_surface(
    depth_views: list[DepthView], vertices: Float, triangles: Int, report: Callable[[str, float], None]
) -> tuple[Float, Int, VertexObservations]:
    default_height, step = THICKNESS, 0.05 / (REFINEMENT_ROUNDS + 1)

    def observe(index: int, normals: Float) -> VertexObservations:
        share = 0.9 + index * step
        reported = _report_each(depth_views, partial(report, "settling"), share, share + step)
        return observe_vertices(reported, vertices, normals)

    for index in range(REFINEMENT_ROUNDS):
        normals = compute_vertex_normals(vertices, triangles)
        vertices = refine_vertices(vertices, normals, triangles, observe(index, normals), default_height)
        default_height = 0.0
    return vertices, triangles, observe(REFINEMENT_ROUNDS, compute_vertex_normals(vertices, triangles))


def _report_each(
    depth_views: Sequence[DepthView], report: Callable[[float], None], start: float, end: float
) -> Iterator[DepthView]:
    """Yield the views; before each, report the share of the work done, from `start` to `end`."""
    for index, view in enumerate(depth_views):
        report(start + (end - start) * index / len(depth_views))
        yield view


def _drop_small_components(
    vertices: Float, triangles: Int, observed: VertexObservations
) -> tuple[Float, Int, VertexObservations]:
    """Drop triangles that no view sees, and components with less than `MIN_COMPONENT_AREA_SHARE` of the mesh's area."""
    triangles = triangles[(observed.views[triangles] > 0).any(axis=1)]
    label = label_components(len(vertices), np.repeat(triangles[:, 0], 2), triangles[:, 1:].reshape(-1))[
        triangles[:, 0]
    ]
    corner = vertices[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    component_area = np.bincount(label, weights=area, minlength=len(vertices))[label]
    used, renumbered = np.unique(
        triangles[component_area >= MIN_COMPONENT_AREA_SHARE * area.sum()], return_inverse=True
    )
    return vertices[used], renumbered.reshape(-1, 3).astype(np.int64), observed.take(used)
