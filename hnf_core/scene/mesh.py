"""Triangle meshes in metres, their frame for float32 ray tracing, parts of them, and normals of their smooth shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError

Float = NDArray[np.float64]

MIN_EXTENT_M, MAX_EXTENT_M = 1e-60, 1e60
"""Accepted distances of a mesh's farthest corner from its centre [m]: within them the fourth powers of barycentrics fit
float64."""
MIN_RELATIVE_WIDTH = 1e-9
"""Width of a triangle over its longest side, below which it counts as degenerate."""


@dataclass(frozen=True)
class TriangleMesh:
    """A triangulated surface in metres.

    Attributes
    ----------
    vertices : ndarray of float64, shape (V, 3)
        Positions [m].
    triangles : ndarray of int32, shape (T, 3)
        Vertex indices.
    face : ndarray of int32, shape (T,)
        Index of the polygon that each triangle came from.
    slot : ndarray of int32, shape (T,)
        Material slot of each triangle, as in Blender.
    normals : ndarray of float64, shape (T, 3, 3)
        Unit corner normals, smooth shading included.
    uv : ndarray of float64, shape (T, 3, 2), or None
        Corner UVs, if the mesh has any.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    face: NDArray[np.int32]
    slot: NDArray[np.int32]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None

    def corner_positions(self) -> NDArray[np.float64]:
        """Return the corner positions (T, 3, 3) [m]."""
        return self.vertices[self.triangles]


def has_area(corners: Float) -> NDArray[np.bool_]:
    """Return a mask (T,) of the triangles (T, 3, 3) that are wider than `MIN_RELATIVE_WIDTH` times their longest side.

    A thinner triangle stops no ray, but a float32 ray tracer may report it in place of the surface that it lies on.
    """
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.einsum("tcx,tcx->tc", sides, sides).max(axis=1, initial=0.0)
    normal = np.cross(sides[:, 1], sides[:, 2])
    return np.asarray(np.sqrt(np.einsum("tx,tx->t", normal, normal)) > MIN_RELATIVE_WIDTH * longest)


@dataclass(frozen=True)
class Float32Frame:
    """Coordinates in which a float32 ray tracer (Embree) stores a mesh: (x − centre) · scale.

    Attributes
    ----------
    centre : ndarray of float64, shape (3,)
        Median of the triangles' centroids [m], so that a part 10 km away costs the rest no precision.
    scale : float
        Power of two that brings the farthest corner to a distance of about 1 [1/m]; a power of two causes no rounding.
    radius : float
        Radius of the sphere around `centre` that contains every triangle [m].
    """

    centre: Float
    scale: float
    radius: float

    def to_frame(self, points: ArrayLike) -> Float:
        """Transform points (..., 3) from metres to this frame; the result is still float64."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.centre) * self.scale)


def compute_float32_frame(corners: Float) -> Float32Frame:
    """Compute the frame in which triangles (T, 3, 3) [m] fit float32 best.

    Parameters
    ----------
    corners : ndarray of float64, shape (T, 3, 3)
        Corner positions [m].

    Returns
    -------
    Float32Frame
        The frame.

    Raises
    ------
    SceneError
        If there are no triangles, a corner is not finite, or the extent is outside `MIN_EXTENT_M` … `MAX_EXTENT_M`.
    """
    if len(corners) == 0:
        raise SceneError("the mesh has no faces to touch.", remedy="Give the object some faces, or choose another.")
    if not np.isfinite(corners).all():
        raise SceneError("a vertex is not a number.", remedy="Move or delete that vertex.")
    centre = np.median(corners.mean(axis=1), axis=0)
    away = np.maximum(corners.max(axis=(0, 1)) - centre, centre - corners.min(axis=(0, 1)))
    farthest = float(away.max())
    if not MIN_EXTENT_M < farthest < MAX_EXTENT_M:
        raise SceneError(
            f"all of the mesh lies within {farthest:.1g} m."
            if farthest < 1.0
            else f"the mesh reaches {farthest:.1g} m.",
            remedy="Check the object's scale and the scene's unit scale.",
        )
    return Float32Frame(centre, float(np.ldexp(1.0, -int(np.frexp(farthest)[1]))), float(np.linalg.norm(away)))


def crop_mesh(mesh: TriangleMesh, points: ArrayLike, reach_m: float) -> TriangleMesh:
    """Return the part of a mesh around some points, so that later work does not grow with the rest of the mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    points : array_like, shape (n, 3)
        Centres, at least one [m].
    reach_m : float
        Distance along each axis from a centre within which bounding boxes of triangles must come [m].

    Returns
    -------
    TriangleMesh
        Those triangles in their order, with the vertices that they use. A ray that stays within `reach_m` of a centre
        hits no other triangle.
    """
    centres = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    selected = _triangles_in_box(
        mesh, np.arange(len(mesh.triangles)), centres.min(axis=0) - reach_m, centres.max(axis=0) + reach_m
    )
    if len(centres) > 1:
        inside = np.zeros(len(mesh.triangles), dtype=np.bool_)
        for centre in centres:
            inside[_triangles_in_box(mesh, selected, centre - reach_m, centre + reach_m)] = True
        selected = np.flatnonzero(inside)
    return _take_triangles(mesh, selected)


def _take_triangles(mesh: TriangleMesh, selected: NDArray[np.intp]) -> TriangleMesh:
    """Return a mesh of some triangles of another, with the vertices that they use."""
    used, triangles = np.unique(mesh.triangles[selected], return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        face=mesh.face[selected],
        slot=mesh.slot[selected],
        normals=mesh.normals[selected],
        uv=None if mesh.uv is None else mesh.uv[selected],
    )


def _triangles_in_box(
    mesh: TriangleMesh, triangles: NDArray[np.intp], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Return those of the given triangle indices whose bounding boxes overlap the box from `low` to `high` (3,) [m]."""
    for axis in range(3):
        corners = mesh.vertices[:, axis][mesh.triangles[triangles]]
        triangles = triangles[(corners.min(axis=1) <= high[axis]) & (corners.max(axis=1) >= low[axis])]
    return triangles


def has_crowded_edge(mesh: TriangleMesh, points: ArrayLike, reach_m: float) -> bool:
    """Return True if more than two faces of a mesh share an edge near some points.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    points : array_like, shape (n, 3)
        Points, at least one [m].
    reach_m : float
        Distance from a point within which an edge is near [m].

    Returns
    -------
    bool
    """
    near = crop_mesh(mesh, points, reach_m)
    edges = np.sort(np.stack([near.triangles, np.roll(near.triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    key, face = edges[:, 0].astype(np.int64) * len(near.vertices) + edges[:, 1], np.repeat(near.face, 3)
    order = np.lexsort((face, key))
    key, face = key[order], face[order]
    # An edge between triangles of one polygon counts once.
    distinct = np.ones(len(key), dtype=np.bool_)
    distinct[1:] = (np.diff(key) != 0) | (np.diff(face) != 0)
    edge, count = np.unique(key[distinct], return_counts=True)
    crowded = edge[count > 2]
    start, end = near.vertices[crowded // len(near.vertices)], near.vertices[crowded % len(near.vertices)]
    along = end - start
    for point in np.asarray(points, dtype=np.float64).reshape(-1, 3):
        part = np.einsum("ex,ex->e", point - start, along) / np.maximum(np.einsum("ex,ex->e", along, along), 1e-300)
        foot = start + np.clip(part, 0.0, 1.0)[:, None] * along
        if (np.linalg.norm(foot - point, axis=1) <= reach_m).any():
            return True
    return False


SMOOTH_NORMAL_M = 2.5e-3
"""Standard deviation of the Gaussian weights of the smooth shape's normals [m]; 99 % of a 5 mm wave is removed."""
FINE_FACE_M = 1.5e-3
"""Height over the longest side of a triangle up to which a mesh may hold relief [m]: half of a quad of 2 mm, of which a
wave of 8 mm has four."""
MIN_FINE_FACES = 8
"""Fewest such triangles under a stroke: one wave."""
MIN_RELIEF_ANGLE_COSINE = float(np.cos(np.radians(6.0)))
"""Cosine of the least angle between the mesh's and the smooth shape's normals at which the latter are used."""
_NORMAL_CELL_M = 0.5e-3
"""Side of the cells in which triangles are summed for smooth normals, and step along the path between them [m]."""


def compute_smooth_normals(
    mesh: TriangleMesh, point: Float, normal: Float, triangle: NDArray[np.int32]
) -> Float | None:
    """Compute the normals of a mesh's smooth shape under a stroke, without ridges that the mesh models.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    point, normal : ndarray, shape (n, 3)
        Points on the surface [m] and the mesh's own normals.
    triangle : ndarray of int32, shape (n,)
        Triangles at these points.

    Returns
    -------
    ndarray, shape (n, 3), or None
        Unit normals. None if faces under the stroke are too large for relief, or the surface is as smooth as its
        normals.

    Notes
    -----
    The sum of the area vectors of a piece of surface depends on its border alone, so that ridges cancel in it.
    """
    if _count_fine_faces(mesh.vertices[mesh.triangles[np.unique(triangle)]]) < MIN_FINE_FACES:
        return None
    if _looks_smooth(mesh, point, normal):
        return None
    travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1))])
    stops = np.searchsorted(travel, np.arange(0.0, travel[-1] + _NORMAL_REACH_M, _NORMAL_REACH_M))
    near = crop_mesh(mesh, point[np.unique(np.minimum(stops, len(point) - 1))], 1.5 * _NORMAL_REACH_M)
    centre, area = _sum_area_vectors(near)
    chosen = np.unique(np.searchsorted(travel, np.arange(0.0, travel[-1] + _NORMAL_CELL_M, _NORMAL_CELL_M)))
    chosen = np.unique(np.append(chosen[chosen < len(point)], len(point) - 1))
    averaged = np.concatenate([
        _average_area_vectors(point[rows], normal[rows], centre, area)
        for rows in np.array_split(chosen, len(chosen) // 64 + 1)
    ])  # fmt: skip
    smooth = np.stack([np.interp(travel, travel[chosen], averaged[:, axis]) for axis in range(3)], axis=-1)
    smooth = smooth / np.maximum(np.linalg.norm(smooth, axis=1), 1e-30)[:, None]
    is_smooth = np.einsum("nx,nx->n", smooth, normal) >= MIN_RELIEF_ANGLE_COSINE
    return None if is_smooth.all() else smooth


def _count_fine_faces(corners: Float) -> int:
    """Return how many of the triangles (T, 3, 3) [m] are narrow enough to be part of a relief."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return int(np.count_nonzero(double_area < FINE_FACE_M * edges.max(axis=1)))


def has_fine_faces(mesh: TriangleMesh, slot: int) -> bool:
    """Return True if faces of a material slot are narrow enough to be part of a relief; of many, some are looked at."""
    return _count_fine_faces(mesh.vertices[mesh.triangles[_sample_triangles(mesh, slot)]]) >= MIN_FINE_FACES


def _sample_triangles(mesh: TriangleMesh, slot: int) -> NDArray[np.intp]:
    """Return the indices of a material slot's triangles, of many every few."""
    chosen = np.flatnonzero(mesh.slot == slot)
    return chosen[:: len(chosen) // _SAMPLED_TRIANGLES + 1]


def has_steep_relief(mesh: TriangleMesh, slot: int) -> bool:
    """Return True if many of a material slot's faces are narrow, and differ much from those around them."""
    if not has_fine_faces(mesh, slot):
        return False
    chosen = _sample_triangles(mesh, slot)
    middle, vector = _read_area_vectors(mesh, chosen)
    _, cell = np.unique(_number_cells(middle, STEEP_CELL_M), return_inverse=True)
    size = np.linalg.norm(vector, axis=1)
    steep = np.einsum("tx,tx->t", vector, _sum_directions(cell, vector)[cell]) < STEEP_ANGLE_COSINE * size
    return bool(size[steep].sum() > MIN_STEEP_SHARE * size.sum())


def smooth_normals_near(mesh: TriangleMesh, points: ArrayLike, reach_m: float) -> TriangleMesh:
    """Return a mesh with the normals of its smooth shape near some points, as `compute_smooth_normals` has them.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    points : array_like, shape (n, 3)
        Points [m].
    reach_m : float
        Distance along each axis within which centroids of triangles get the normals of the smooth shape [m].

    Returns
    -------
    TriangleMesh
    """
    centroid = mesh.corner_positions().mean(axis=1)
    distance = np.full(len(centroid), np.inf)
    for point in np.asarray(points, dtype=np.float64).reshape(-1, 3):
        distance = np.minimum(distance, np.maximum.reduce([abs(centroid[:, axis] - point[axis]) for axis in range(3)]))
    chosen = np.flatnonzero(distance <= reach_m)
    middle, vector = _read_area_vectors(mesh, chosen)
    # One normal for the triangles of a small cell, and another for those that face away from its first.
    _, first, cell = np.unique(_number_cells(middle, SMOOTH_NORMAL_M), return_index=True, return_inverse=True)
    away = np.einsum("tx,tx->t", vector, vector[first][cell]) < 0.0
    _, first, cell = np.unique(2 * cell + away, return_index=True, return_inverse=True)
    start = _sum_directions(cell, vector)
    centre, area = _sum_area_vectors(
        _take_triangles(mesh, np.flatnonzero(distance <= reach_m + _NORMAL_REACH_M)), _COARSE_CELL_M
    )
    smooth = np.concatenate([
        _average_area_vectors(middle[first[rows]], start[rows], centre, area)
        for rows in np.array_split(np.arange(len(first)), len(first) // 64 + 1)
    ])[cell]  # fmt: skip
    normals = mesh.normals.copy()
    normals[chosen] = smooth[:, None]
    return replace(mesh, normals=normals)


def _read_area_vectors(mesh: TriangleMesh, chosen: NDArray[np.intp]) -> tuple[Float, Float]:
    """Return the centroids (n, 3) [m] of some triangles, and their area vectors (n, 3) [m²], which point outwards."""
    corners = mesh.vertices[mesh.triangles[chosen]]
    vector = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    outward = np.einsum("tx,tx->t", vector, mesh.normals[chosen].sum(axis=1))
    return corners.mean(axis=1), vector * np.where(outward < 0.0, -1.0, 1.0)[:, None]


def _number_cells(points: Float, side_m: float) -> NDArray[np.int64]:
    """Return a number (n,) for the cubic cell that each point (n, 3) [m] lies in."""
    place = np.floor(points / side_m).astype(np.int64)
    place -= place.min(axis=0)
    spans = tuple(int(span) for span in place.max(axis=0) + 1)
    return np.asarray(np.ravel_multi_index(tuple(place.T), spans), dtype=np.int64)


def _sum_directions(cell: NDArray[np.intp], vector: Float) -> Float:
    """Return the unit vectors (k, 3) of the sums of vectors (n, 3) by cell (n,)."""
    total = np.stack([np.bincount(cell, weights=vector[:, axis]) for axis in range(3)], axis=-1)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])


STEEP_CELL_M = 5e-3
"""Side of the cells in which normals are compared [m]."""
STEEP_ANGLE_COSINE = float(np.cos(np.radians(20.0)))
"""Cosine of the angle to the mean of their cell from which faces are steep; those of a ball of 20 mm are within 15°."""
MIN_STEEP_SHARE = 0.05
"""Least share of the area that is steep, for a surface to have steep relief."""
_COARSE_CELL_M = 1.25e-3
"""Side of the cells in which triangles are summed where many normals are computed [m]."""
_NORMAL_REACH_M = 2.5 * SMOOTH_NORMAL_M
"""Distance beyond which triangles do not count for a smooth normal [m]."""
_MAX_PIECES = 256
"""Most pieces into which a long triangle is cut."""


_SAMPLED_TRIANGLES = 60_000
"""Number of triangles of a mesh that are examined first; all of a small mesh."""
_SAMPLE_REACH_M = 2e-3
"""Distance from the path within which they are examined [m]."""
_MIN_SAMPLES = 64
"""Fewest triangles there that tell whether a surface is smooth."""


def _looks_smooth(mesh: TriangleMesh, point: Float, normal: Float) -> bool:
    """Return True if triangles picked at random near a path (n, 3) have the normals (n, 3) that the path has there."""
    count = len(mesh.triangles)
    picked = np.arange(count)
    if count > _SAMPLED_TRIANGLES:
        picked = np.random.default_rng(0).integers(0, count, _SAMPLED_TRIANGLES)
    corners = mesh.vertices[mesh.triangles[picked]]
    centre = corners.mean(axis=1)
    low, high = point.min(axis=0) - _SAMPLE_REACH_M, point.max(axis=0) + _SAMPLE_REACH_M
    near = ((centre >= low) & (centre <= high)).all(axis=1)
    corners, centre, picked = corners[near], centre[near], picked[near]
    rows = np.arange(0, len(point), max(len(point) // 256, 1))
    square = sum((centre[:, None, axis] - point[None, rows, axis]) ** 2 for axis in range(3))
    closest = np.argmin(square, axis=1)
    near = square[np.arange(len(centre)), closest] <= _SAMPLE_REACH_M**2
    if np.count_nonzero(near) < _MIN_SAMPLES:
        return False
    vector = np.cross(corners[near, 1] - corners[near, 0], corners[near, 2] - corners[near, 0])
    cosine = np.einsum("tx,tx->t", vector, normal[rows[closest[near]]])
    length = np.linalg.norm(vector, axis=1)
    # The back of a thin sheet, and faces without area, tell nothing.
    front = np.abs(cosine) > 0.3 * length
    return bool((np.abs(cosine[front]) >= MIN_RELIEF_ANGLE_COSINE * length[front]).all())


def _sum_area_vectors(mesh: TriangleMesh, cell_m: float = _NORMAL_CELL_M) -> tuple[Float, Float]:
    """Return the area vectors of a mesh summed in cells of side `cell_m`: centres (k, 3) [m] and sums (k, 3) [m²].

    Long triangles are cut into pieces along their longest sides. The two sides of a thin sheet have cells of their own.
    """
    corners = mesh.corner_positions()
    _, vector = _read_area_vectors(mesh, np.arange(len(corners)))
    length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    start = length.argmax(axis=1)
    rows = np.arange(len(corners))
    first, second, apex = (corners[rows, (start + k) % 3] for k in range(3))
    side = length[rows, start]
    foot = np.einsum("tx,tx->t", apex - first, second - first) / np.maximum(side**2, 1e-300)
    pieces = np.clip(np.ceil(side / (0.4 * SMOOTH_NORMAL_M)), 1, _MAX_PIECES).astype(int)
    owner = np.repeat(rows, pieces)
    fraction = (np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[owner]
    width = np.minimum(
        fraction / np.clip(foot[owner], 1e-9, None), (1.0 - fraction) / np.clip(1.0 - foot[owner], 1e-9, None)
    )
    total = np.bincount(owner, weights=width, minlength=len(rows))
    vector = vector[owner] * (width / np.maximum(total[owner], 1e-300))[:, None]
    # The middle of a piece lies half its width from the longest side; a single piece has the triangle's centroid.
    along = first[owner] + fraction[:, None] * (second - first)[owner]
    across = (apex - first - foot[:, None] * (second - first))[owner]
    at = np.where((pieces == 1)[owner, None], corners.mean(axis=1)[owner], along + 0.5 * width[:, None] * across)
    facing = np.abs(vector).argmax(axis=1)
    sign = vector[np.arange(len(vector)), facing] > 0.0
    keys = np.column_stack([np.floor(at / cell_m).astype(np.int64), 2 * facing + sign])
    low = keys.min(axis=0)
    spans = keys.max(axis=0) - low + 1
    flat = np.ravel_multi_index(tuple((keys - low).T), tuple(int(span) for span in spans))
    _, cell = np.unique(flat, return_inverse=True)
    cell = cell.reshape(-1)
    weight = np.linalg.norm(vector, axis=1)
    mass = np.maximum(np.bincount(cell, weights=weight), 1e-300)
    centre, area = np.zeros((len(mass), 3)), np.zeros((len(mass), 3))
    for axis in range(3):
        centre[:, axis] = np.bincount(cell, weights=weight * at[:, axis]) / mass
        area[:, axis] = np.bincount(cell, weights=vector[:, axis])
    return centre, area


def _average_area_vectors(point: Float, normal: Float, centre: Float, area: Float) -> Float:
    """Return unit normals (n, 3) averaged around points (n, 3) with Gaussian weights, of cells that face like them."""
    near = ((centre >= point.min(axis=0) - _NORMAL_REACH_M) & (centre <= point.max(axis=0) + _NORMAL_REACH_M)).all(
        axis=1
    )
    centre, area = centre[near], area[near]
    square = np.square(point[:, None, 0] - centre[None, :, 0])
    for axis in (1, 2):
        square += np.square(point[:, None, axis] - centre[None, :, axis])
    # Few cells are within reach of each point.
    row, column = np.nonzero(square <= _NORMAL_REACH_M**2)
    direction = (area / np.maximum(np.linalg.norm(area, axis=1), 1e-300)[:, None])[column]
    weighted = np.exp(-0.5 * square[row, column] / SMOOTH_NORMAL_M**2)[:, None] * area[column]
    # Flanks of a ridge may face away from each other by up to 120°, the back of a sheet faces away by 180°.
    for least in (-0.5, 0.0):
        counts = np.flatnonzero(np.einsum("px,px->p", normal[row], direction) > least)
        mean = np.stack([np.bincount(row[counts], weighted[counts, k], len(point)) for k in range(3)], axis=-1)
        length = np.linalg.norm(mean, axis=1)
        normal = np.where((length > 1e-18)[:, None], mean / np.maximum(length, 1e-300)[:, None], normal)
    return normal
