"""Grid cells, surface nets and nearest triangles, against exact surfaces and plain references."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hnf_core.errors import SceneError, UsageError
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.splats.tsdf import (
    MAX_CELLS_PER_AXIS,
    GridSamples,
    SurfaceNet,
    VoxelGrid,
    dilate_keys,
    extract_surface,
    find_keys,
    find_nearest_triangles,
    label_components,
)
from reference.geometry import ReferenceGeometry


def ball(points, radius=0.7):
    return np.linalg.norm(points, axis=-1) - radius


def ring(points, large=0.6, small=0.25):
    return np.hypot(np.hypot(points[..., 0], points[..., 1]) - large, points[..., 2]) - small


AREA = {ball: 4 * np.pi * 0.7**2, ring: 4 * np.pi**2 * 0.6 * 0.25}
VOLUME = {ball: 4 / 3 * np.pi * 0.7**3, ring: 2 * np.pi**2 * 0.6 * 0.25**2}


def sampled(field, count: int, shift=(0.0, 0.0, 0.0), band: float = 4.0) -> tuple[GridSamples, float]:
    """A field on −1 … 1, known where it is within band spacings of zero; the spacing."""
    grid, spacing = VoxelGrid((count, count, count)), 2.0 / (count - 7)
    cells = np.stack(np.meshgrid(*[np.arange(2, count - 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    values = field((cells - (count - 1) / 2) * spacing - np.array(shift))
    near = np.abs(values) < band * spacing
    return GridSamples(grid, grid.keys(cells[near]), values[near]), spacing


@cache
def netted(field, count: int) -> tuple[SurfaceNet, float]:
    samples, spacing = sampled(field, count)
    return extract_surface(samples), spacing


def edges(triangles):
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)


def area_and_volume(net: SurfaceNet, spacing: float) -> tuple[float, float]:
    corner = net.vertices[net.triangles] * spacing
    corner = corner - corner.mean(axis=(0, 1))
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.linalg.norm(normal, axis=1).sum() / 2, np.einsum("tx,tx->", corner[:, 0], normal) / 6


@pytest.mark.parametrize(("field", "euler"), [(ball, 2), (ring, 0)])
@pytest.mark.parametrize("count", [16, 32])
def test_a_closed_surface_is_closed_and_has_its_holes(field, euler, count):
    net, _ = netted(field, count)
    pairs, times = edges(net.triangles)
    assert (times == 2).all()
    assert len(net.vertices) - len(pairs) + len(net.triangles) == euler
    assert len(np.unique(np.sort(net.triangles, axis=1), axis=0)) == len(net.triangles)
    corner = net.vertices[net.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.linalg.norm(normal, axis=1).min() > 1e-3


@pytest.mark.parametrize("field", [ball, ring])
def test_every_edge_is_walked_once_each_way_and_out_is_out(field):
    net, spacing = netted(field, 32)
    walked = np.concatenate([net.triangles[:, [0, 1]], net.triangles[:, [1, 2]], net.triangles[:, [2, 0]]])
    assert len(np.unique(walked, axis=0)) == len(walked)
    assert area_and_volume(net, spacing)[1] > 0.0


@pytest.mark.parametrize("field", [ball, ring])
def test_area_and_volume_are_right_to_the_square_of_the_spacing(field):
    for count in (16, 32, 64):
        net, spacing = netted(field, count)
        area, volume = area_and_volume(net, spacing)
        assert abs(area / AREA[field] - 1.0) < 9.0 * spacing**2
        assert abs(volume / VOLUME[field] - 1.0) < 9.0 * spacing**2


@settings(max_examples=10, deadline=None)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_a_moved_field_gives_a_moved_surface(shift):
    samples, spacing = sampled(ball, 24, tuple(0.5 * 2.0 / 17 * each for each in shift))
    moved = extract_surface(samples)
    assert (edges(moved.triangles)[1] == 2).all()
    distance = ball((moved.vertices - (24 - 1) / 2) * spacing - 0.5 * spacing * np.array(shift))
    assert np.abs(distance).max() < 0.15 * spacing


@settings(max_examples=10, deadline=None)
@given(st.tuples(*[st.integers(0, 5)] * 3))
def test_whole_steps_change_nothing_but_the_place(step):
    samples, _ = sampled(ring, 16)
    wide = VoxelGrid((22, 22, 22))
    keys = wide.keys(samples.grid.cells(samples.keys) + np.array(step))
    net, other = extract_surface(samples), extract_surface(GridSamples(wide, keys, samples.values))
    np.testing.assert_allclose(other.vertices, net.vertices + np.array(step), atol=1e-12)
    np.testing.assert_array_equal(other.triangles, net.triangles)


def test_a_hole_in_what_is_known_stays_a_hole():
    samples, _ = sampled(ball, 32)
    cells = samples.grid.cells(samples.keys) - 15.5
    known = ~((cells[:, 2] > 0.0) & (np.hypot(cells[:, 0], cells[:, 1]) < 4.0))
    net = extract_surface(GridSamples(samples.grid, samples.keys[known], samples.values[known]))
    pairs, times = edges(net.triangles)
    assert set(times.tolist()) == {1, 2}
    rim = net.vertices[np.unique(pairs[times == 1])] - 15.5
    assert (np.hypot(rim[:, 0], rim[:, 1]) < 6.5).all()
    assert (rim[:, 2] > 0.0).all()
    assert len(net.vertices) - len(pairs) + len(net.triangles) == 1


def test_the_widest_grid_numbers_all_cells_and_wider_is_refused():
    side = MAX_CELLS_PER_AXIS
    widest, corners = VoxelGrid((side,) * 3), np.array([[0, 0, 0], [side - 1, 1, side - 2], [side - 1] * 3])
    np.testing.assert_array_equal(widest.cells(widest.keys(corners)), corners)
    with pytest.raises(SceneError, match="too far apart"):
        VoxelGrid((8, side + 1, 8))


def test_nothing_known_or_no_sign_change_is_no_surface():
    grid = VoxelGrid((9, 9, 9))
    empty = extract_surface(GridSamples(grid, np.zeros(0, dtype=np.int64), np.zeros(0)))
    assert len(empty.vertices) == len(empty.triangles) == 0
    samples, _ = sampled(ball, 16)
    assert len(extract_surface(GridSamples(samples.grid, samples.keys, np.abs(samples.values))).triangles) == 0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(0, 2))
def test_cells_are_found_grown_and_numbered_as_sets_are(seed, count, reach):
    random = np.random.default_rng(seed)
    grid = VoxelGrid((9, 12, 10))
    cells = random.integers(3, 7, (count, 3))
    keys = grid.keys(cells)
    np.testing.assert_array_equal(grid.cells(keys), cells)
    around = range(-reach, reach + 1)
    wanted = {(i + x, j + y, k + z) for i, j, k in cells.tolist() for x in around for y in around for z in around}
    found = dilate_keys(grid, keys, reach)
    assert {tuple(each) for each in grid.cells(found).tolist()} == wanted
    assert (np.diff(found) > 0).all()
    at = find_keys(found, keys)
    np.testing.assert_array_equal(found[at], keys)
    assert find_keys(found, np.array([0])).tolist() == [-1]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(0, 80))
def test_connected_parts_are_those_of_a_walk(seed, count, links):
    random = np.random.default_rng(seed)
    first, second = random.integers(0, count, (2, links))
    label = label_components(count, first, second)
    expected = np.arange(count)
    for _ in range(count):
        for a, b in zip(first, second, strict=True):
            expected[a] = expected[b] = min(expected[a], expected[b])
    np.testing.assert_array_equal(label, expected)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.02, 1.0))
def test_the_nearest_face_is_the_references(seed, within):
    random = np.random.default_rng(seed)
    middle = random.uniform(-1.0, 1.0, (50, 1, 3))
    corners = middle + 0.1 * random.standard_normal((50, 3, 3)) * random.choice([0.3, 1.0, 4.0], (50, 1, 1))
    vertices, triangles = corners.reshape(-1, 3), np.arange(150, dtype=np.int32).reshape(-1, 3)
    index = np.arange(50, dtype=np.int32)
    mesh = TriangleMesh(vertices, triangles, index, 0 * index, np.zeros((50, 3, 3)))
    points = random.uniform(-2.0, 2.0, (40, 3))
    plain = ReferenceGeometry(mesh).closest_points(points)
    assume((np.abs(plain.distance - within) > 1e-9).all())
    found = find_nearest_triangles(vertices, triangles, points, within)
    near = plain.distance <= within
    np.testing.assert_array_equal(found.triangle, np.where(near, plain.triangle, -1))
    np.testing.assert_allclose(found.distance, np.where(near, plain.distance, np.inf), rtol=1e-12)


def test_no_faces_no_points_and_no_reach():
    none = find_nearest_triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((2, 3)), 1.0)
    assert none.triangle.tolist() == [-1, -1]
    assert len(find_nearest_triangles(np.eye(3), [[0, 1, 2]], np.zeros((0, 3)), 1.0).triangle) == 0
    for reach in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(UsageError):
            find_nearest_triangles(np.eye(3), [[0, 1, 2]], np.zeros((1, 3)), reach)
