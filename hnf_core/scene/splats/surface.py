"""A surface to stroke, out of splats: cleaned, seen from all around, fused, meshed, and laid where the views see it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, UsageError
from ..camera import Camera
from .cells import label_components
from .clean import PruneResult, prune_splats
from .cloud import Splats
from .quality import Quality, assess_quality, measure_clarity
from .sights import DepthView, make_depth_view
from .splatter import render_splats
from .surface_nets import extract_surface
from .tsdf import THICKNESS, find_band, fuse_depth_views
from .view import SplatView
from .viewpoints import make_surrounding_cameras
from .witness import VertexObservations, compute_vertex_normals, observe_vertices, refine_vertices

Float = NDArray[np.float64]
Int = NDArray[np.int64]
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
