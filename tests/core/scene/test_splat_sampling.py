"""Points spread over a surface for splats: as many as the area asks for, even, and finer where strokes touch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.mesh_sampling import (
    compute_triangle_sequence,
    distribute_points,
    order_along_curve,
    sample_mesh,
    subdivide_triangles,
)
from hnf_core.scene.mesh import TriangleMesh

few = settings(max_examples=25)


def mesh_of(corners) -> TriangleMesh:
    corners = np.asarray(corners, dtype=float)
    count = len(corners)
    zero = np.zeros(count, dtype=np.int32)
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return TriangleMesh(corners.reshape(-1, 3), triangles, zero, zero, np.zeros((count, 3, 3)))


def square(side: float = 0.1) -> TriangleMesh:
    a, b, c, d = ([x * side / 2, y * side / 2, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return mesh_of([[a, b, c], [a, c, d]])


@st.composite
def triangles(draw):
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    return random.normal(size=(draw(st.integers(1, 30)), 3, 3)) * 10.0 ** random.uniform(-1.0, 1.0)


@few
@given(st.integers(0, 4**10), st.integers(0, 4))
def test_points_that_follow_each_other_lie_in_equal_parts(start, digits) -> None:
    """Basu and Owen's law: 4^k from a multiple of 4^k on, one in each of the 4^k parts."""
    count = 4**digits
    points = compute_triangle_sequence(np.arange(count) + (start // count) * count)
    np.testing.assert_allclose(points.sum(axis=1), 1.0, atol=1e-12)
    assert points.min() >= 0.0
    # A part is told by the cell of its barycentric coordinates on a grid of 2^k lines.
    cells = np.floor(points * 2**digits).astype(int)
    assert len(np.unique(cells, axis=0)) == count


@few
@given(triangles(), st.integers(0, 100))
def test_every_piece_gets_its_share_of_the_area(corners, seed) -> None:
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    spacing = np.sqrt(area.sum() / 500.0)
    found = distribute_points(np.arange(len(corners)), corners, spacing, np.random.default_rng(seed))
    assert abs(len(found) - 500) <= 1
    counts = np.bincount(found.triangle, minlength=len(corners))
    assert np.abs(counts - len(found) * area / area.sum()).max() < 1.0 + 1e-9
    np.testing.assert_allclose(found.spacing, spacing, rtol=2e-3)


@few
@given(triangles(), st.integers(0, 100))
def test_points_lie_in_their_triangles(corners, seed) -> None:
    side = float(np.ptp(corners, axis=(0, 1)).max())
    found = sample_mesh(mesh_of(corners), side / 15.0, seed)
    own = corners[found.triangle]
    off = np.einsum("nx,nx->n", found.position - own[:, 0], found.normal)
    assert np.abs(off).max() < 1e-9 * side
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0)
    for index in range(3):
        edge = own[:, (index + 1) % 3] - own[:, index]
        inward = np.cross(found.normal, edge)
        assert np.einsum("nx,nx->n", found.position - own[:, index], inward).min() > -1e-9 * side**2


def test_a_plane_has_neither_holes_nor_heaps() -> None:
    found = sample_mesh(square(), 4e-3, seed=3)
    grid = np.linspace(-0.048, 0.048, 40)
    places = np.stack([*np.meshgrid(grid, grid), np.zeros((40, 40))], axis=-1).reshape(-1, 3)
    away = np.linalg.norm(places[:, None] - found.position[None], axis=2).min(axis=1)
    assert away.max() < 1.5 * 4e-3
    # Points by chance leave exp(−π 0.81) = 8 % of places so far from all of them.
    assert np.mean(away > 0.9 * 4e-3) < 0.02


def test_a_strip_has_no_holes_either() -> None:
    """A side of 0.1 m in triangles 1 mm wide, as round things have."""
    x = np.linspace(-0.05, 0.05, 101)
    low, high = ([[place, -0.05, 0.0] for place in x], [[place, 0.05, 0.0] for place in x])
    strips = [[low[i], low[i + 1], high[i]] for i in range(100)] + [
        [low[i + 1], high[i + 1], high[i]] for i in range(100)
    ]
    found = sample_mesh(mesh_of(strips), 4e-3, seed=3)
    places = np.random.default_rng(0).uniform(-0.048, 0.048, (1500, 2))
    away = np.linalg.norm(places[:, None] - found.position[None, :, :2], axis=2).min(axis=1)
    assert away.max() < 1.5 * 4e-3


def test_it_is_finer_around_a_place_and_nowhere_else() -> None:
    place, reach = np.array([0.02, 0.01, 0.0]), 0.01
    found = sample_mesh(square(), 4e-3, 0, centres=[place], reach_m=reach, fine_m=0.5e-3)
    near = np.linalg.norm(found.position - place, axis=1) <= reach
    np.testing.assert_allclose(found.spacing[near], 0.5e-3, rtol=0.02)
    np.testing.assert_allclose(found.spacing[~near], 4e-3, rtol=0.02)
    assert near.sum() == pytest.approx(np.pi * reach**2 / 0.5e-3**2, rel=0.03)
    assert (~near).sum() == pytest.approx((0.01 - np.pi * reach**2) / 4e-3**2, rel=0.05)


def test_equal_seeds_give_equal_points_and_others_do_not() -> None:
    first, again, other = (sample_mesh(square(), 5e-3, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.position, again.position)
    assert first.position.shape == other.position.shape
    assert not np.array_equal(first.position, other.position)


@few
@given(triangles(), st.floats(0.1, 0.5))
def test_pieces_are_the_triangle_again(corners, share) -> None:
    longest = share * float(np.ptp(corners, axis=(0, 1)).max())
    triangle, pieces = subdivide_triangles(corners, longest)
    assert np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max() <= longest

    def doubled_area(of):
        return np.cross(of[:, 1] - of[:, 0], of[:, 2] - of[:, 0])

    total = np.zeros((len(corners), 3))
    np.add.at(total, triangle, doubled_area(pieces))  # with its sign: nothing overlaps, nothing is turned over
    np.testing.assert_allclose(total, doubled_area(corners), atol=1e-9 * np.abs(total).max())


@few
@given(triangles(), st.integers(0, 2**32), st.floats(0.05, 0.3))
def test_pieces_around_a_place_hold_all_that_is_near_it(corners, seed, share) -> None:
    reach = share * float(np.ptp(corners, axis=(0, 1)).max())
    middle = np.einsum("c,cx->x", np.random.default_rng(seed).dirichlet([1.0, 1.0, 1.0]), corners[0]) + 0.3 * reach
    every, near = (
        subdivide_triangles(corners, 0.5 * reach),
        subdivide_triangles(corners, 0.5 * reach, middle[None], reach),
    )
    close = np.linalg.norm(every[1].mean(axis=1) - middle, axis=1) <= reach
    # Pieces come by the triangle and the cut, so that equal ones are equal to the last bit.
    kept = {piece.tobytes() for piece in near[1]}
    assert all(piece.tobytes() in kept for piece in every[1][close])
    assert np.linalg.norm(near[1] - middle, axis=2).min(axis=1, initial=np.inf).max(initial=0.0) <= 1.5 * reach


def test_neighbours_along_the_curve_are_neighbours() -> None:
    points = np.random.default_rng(0).random((4000, 3))
    order = order_along_curve(points)
    assert sorted(order) == list(range(4000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    assert np.median(steps) < 0.2 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))


def test_a_mesh_without_area_has_no_points() -> None:
    assert len(sample_mesh(mesh_of(np.zeros((2, 3, 3))), 1e-3, 0)) == 0
