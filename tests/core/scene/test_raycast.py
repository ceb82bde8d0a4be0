"""Embree against brute-force intersection, nearest points against sampling, and the outputs of a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera, orthographic
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import (
    cast_view,
    compute_view_normals,
    find_closest_barycentric,
    make_embree_caster,
    refine_hits,
)
from reference.geometry import ReferenceGeometry

pytest.importorskip("embreex", reason="embreex is not installed here")


def mesh_of(vertices, triangles):
    vertices, triangles = np.asarray(vertices, float), np.asarray(triangles, np.int32)
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    count = np.arange(len(triangles), dtype=np.int32)
    return TriangleMesh(vertices, triangles, count // 2, count * 0, np.repeat(normal[:, None], 3, axis=1))


def bumpy_ball(seed=0, count=14, radius=0.05, centre=(0.0, 0.0, 0.0)):
    """A closed surface of 2 · count² triangles."""
    random = np.random.default_rng(seed)
    theta = np.linspace(0.05, np.pi - 0.05, count)
    phi = np.linspace(0, 2 * np.pi, count, endpoint=False)
    r = radius * (1 + 0.1 * random.standard_normal((count, count)))
    x, y = r * np.sin(theta)[:, None] * np.cos(phi), r * np.sin(theta)[:, None] * np.sin(phi)
    vertices = np.stack([x, y, r * np.cos(theta)[:, None]], axis=-1).reshape(-1, 3) + np.asarray(centre)
    i, j = np.meshgrid(np.arange(count - 1), np.arange(count), indexing="ij")
    a, b = (i * count + j).ravel(), (i * count + (j + 1) % count).ravel()
    return mesh_of(vertices, np.concatenate([np.stack([a, a + count, b], 1), np.stack([b, a + count, b + count], 1)]))


def edge_distance(barycentric):
    return barycentric.min(axis=-1)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 100.0))
def test_embree_hits_what_trying_every_triangle_hits(seed, far):
    random = np.random.default_rng(seed)
    centre = random.uniform(-20, 20, 3)
    mesh = bumpy_ball(seed, centre=centre)
    origins = centre + far * (unit := random.standard_normal((60, 3))) / np.linalg.norm(unit, axis=1, keepdims=True)
    directions = (centre + random.uniform(-0.05, 0.05, (60, 3)) - origins) * random.uniform(0.1, 3.0, (60, 1))
    fast, plain = make_embree_caster(mesh).cast(origins, directions), ReferenceGeometry(mesh).cast(origins, directions)
    inner = edge_distance(plain.barycentric) > 1e-4  # on an edge either neighbour is right
    inner |= (plain.triangle < 0) & (fast.triangle < 0)
    same = fast.triangle == plain.triangle
    assert same[inner].mean() >= 0.98  # silhouettes: a float32 ray may pass an edge on the other side
    np.testing.assert_allclose(fast.distance[same], plain.distance[same], rtol=1e-12)
    np.testing.assert_allclose(fast.barycentric[same], plain.barycentric[same], atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hits_lie_on_their_triangles_for_any_batch_size(seed):
    random = np.random.default_rng(seed)
    mesh = bumpy_ball(seed)
    corners, count = mesh.corner_positions(), 3 * len(mesh.triangles)
    triangle = random.integers(-1, len(mesh.triangles), count).astype(np.int32)
    weights = random.dirichlet(np.ones(3), count)
    origins, aims = random.standard_normal((count, 3)), np.einsum("nc,ncx->nx", weights, corners[triangle])
    directions = (aims - origins) / random.uniform(0.2, 3.0, (count, 1))
    hits = refine_hits(corners, triangle, origins, directions)
    hit = triangle >= 0
    np.testing.assert_array_equal(hits.triangle, triangle)
    np.testing.assert_allclose((origins + hits.distance[:, None] * directions)[hit], aims[hit], atol=1e-11)
    np.testing.assert_allclose(hits.barycentric[hit], weights[hit], atol=1e-6)
    assert np.isinf(hits.distance[~hit]).all()
    assert not hits.barycentric[~hit].any()
    few = refine_hits(corners, triangle[:40], origins[:40], directions[:40])
    assert (few.distance.tobytes(), few.barycentric.tobytes()) == (
        hits.distance[:40].tobytes(),
        hits.barycentric[:40].tobytes(),
    )


def test_a_ray_in_the_plane_of_its_triangle_meets_nothing():
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    hits = refine_hits(corners, np.array([0, 0], np.int32), [[-1.0, 0.2, 0.0], [0.2, 0.2, 1.0]] * np.ones((2, 1)),
                       np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -2.0]]))  # fmt: skip
    assert hits.triangle.tolist() == [-1, 0]
    assert hits.distance.tolist() == [np.inf, 0.5]
    np.testing.assert_allclose(hits.barycentric, [[0.0, 0.0, 0.0], [0.6, 0.2, 0.2]])


def test_a_hit_lies_on_its_ray_and_in_its_triangle():
    mesh = bumpy_ball(3, centre=(100.0, -50.0, 7.0))
    random = np.random.default_rng(1)
    origins = np.array([100.0, -50.0, 9.0]) + random.uniform(0.004, 0.02, (500, 3))  # beside the open pole
    directions = np.tile([0.0, 0.0, -2.0], (500, 1))
    hits = make_embree_caster(mesh).cast(origins, directions)
    assert (hits.triangle >= 0).all()
    on_ray = origins + hits.distance[:, None] * directions
    on_surface = np.einsum("nc,ncx->nx", hits.barycentric, mesh.corner_positions()[hits.triangle])
    np.testing.assert_allclose(on_ray, on_surface, atol=1e-9)
    np.testing.assert_allclose(hits.barycentric.sum(axis=1), 1.0)
    assert (hits.barycentric >= 0.0).all()


def test_a_miss_says_so():
    hits = make_embree_caster(bumpy_ball()).cast([[0, 0, 1.0], [0, 0, 1.0]], [[0, 0, 1.0], [1.0, 0, 0]])
    assert hits.triangle.tolist() == [-1, -1]
    assert np.isinf(hits.distance).all()
    assert (hits.barycentric == 0.0).all()
    assert make_embree_caster(bumpy_ball()).cast(np.zeros((0, 3)), np.zeros((0, 3))).triangle.shape == (0,)


@pytest.mark.parametrize("make", [make_embree_caster, ReferenceGeometry])
def test_a_mesh_without_triangles_is_refused(make):
    with pytest.raises(SceneError, match="no faces"):
        make(mesh_of(np.zeros((3, 3)), np.zeros((0, 3), np.int32)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_point_beats_every_sampled_point(seed):
    random = np.random.default_rng(seed)
    corners, point = random.standard_normal((1, 3, 3)), 2.0 * random.standard_normal((1, 3))
    weights = find_closest_barycentric(corners, point)
    assert (weights >= 0.0).all()
    assert weights.sum() == pytest.approx(1.0)
    best = np.linalg.norm(weights[0] @ corners[0] - point[0])
    sampled = np.linalg.norm(random.dirichlet(np.ones(3), 400) @ corners[0] - point[0], axis=-1)
    assert best <= sampled.min() + 1e-12


def test_the_nearest_point_of_a_needle_is_on_it():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], float)  # no area
    weights = find_closest_barycentric(corners, np.array([[1.5, 1.0, 0.0]]))
    np.testing.assert_allclose(weights[0] @ corners[0], [1.5, 0, 0], atol=1e-12)


def test_points_on_the_surface_are_their_own_nearest():
    mesh = bumpy_ball(5)
    random = np.random.default_rng(2)
    triangle = random.integers(0, len(mesh.triangles), 50)
    points = np.einsum("nc,ncx->nx", random.dirichlet(np.ones(3), 50), mesh.corner_positions()[triangle])
    found = ReferenceGeometry(mesh).closest_points(points)
    np.testing.assert_allclose(found.distance, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.position, points, atol=1e-12)


def test_a_view_gives_depth_polygon_and_normal_in_the_clip_range():
    square = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    roof = [[x, y, 0.004] for x, y, _ in square[:3]]
    mesh = mesh_of(np.array([*square, *roof]), [[0, 1, 2], [0, 2, 3], [4, 5, 6]])
    camera = orthographic([0.0, 0.0, 0.0], [1, 0, 0], [0, 0, 1], 0.02, 32, 0.01)
    below_roof = Camera(camera.kind, 32, 32, camera.intrinsics, camera.pose, clip_start=0.008, clip_end=camera.clip_end)
    view = cast_view(make_embree_caster(mesh), mesh, below_roof)
    np.testing.assert_allclose(view.depth, 0.01, rtol=1e-12)
    assert (view.face_id == 0).all()  # both halves of the square are polygon 0
    normal = compute_view_normals(mesh, below_roof, view)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1.0], normal.shape))
    roofed = cast_view(make_embree_caster(mesh), mesh, camera)
    x, y, _ = np.moveaxis(camera.unproject(camera.pixel_centres(), np.zeros((32, 32))), -1, 0)
    under = x > y + 1e-9  # the roof's triangle
    np.testing.assert_allclose(roofed.depth[under], 0.006, rtol=1e-12)
    assert (roofed.face_id[under] == 1).all()
    assert (roofed.face_id[x < y - 1e-9] == 0).all()
    short = Camera(camera.kind, 32, 32, camera.intrinsics, camera.pose, clip_end=0.005)
    nothing = cast_view(make_embree_caster(mesh), mesh, short)
    assert np.isinf(nothing.depth).all()
    assert (nothing.face_id == -1).all()
    assert (compute_view_normals(mesh, short, nothing) == 0.0).all()


def random_camera(random, kind):
    """A camera 3 m from the origin, which it has anywhere in its image, with pixels that are not square."""
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(random.standard_normal((3, 3)))[0]
    pose[:3, 0] *= np.linalg.det(pose[:3, :3])
    pose[:3, 3] = -3.0 * pose[:3, 2]
    focal = 30.0 if kind == "perspective" else 12.0
    intrinsics = np.array([[focal, 1.5, 18.0], [0.0, 1.2 * focal, 13.0], [0.0, 0.0, 1.0]])
    return Camera(kind, 40, 30, intrinsics, pose, clip_start=2.2, clip_end=3.8)


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
@pytest.mark.parametrize("seed", range(6))
def test_a_view_agrees_with_single_rays(kind, seed):
    random = np.random.default_rng(seed)
    mesh = mesh_of(random.uniform(-1.0, 1.0, (90, 3)), np.arange(90).reshape(-1, 3).tolist())
    turned = mesh.normals + 0.4 * random.standard_normal(mesh.normals.shape)
    mesh = replace(mesh, normals=turned / np.linalg.norm(turned, axis=-1, keepdims=True))
    camera = random_camera(random, kind)
    origins, directions = (rays.reshape(-1, 3) for rays in camera.pixel_rays())
    hits = ReferenceGeometry(mesh).cast(origins + camera.clip_start * directions, directions)
    depth = hits.distance + camera.clip_start
    triangle = np.where(depth <= camera.clip_end, hits.triangle, -1)
    view = cast_view(make_embree_caster(mesh), mesh, camera)
    same = view.triangle.ravel() == triangle
    assert same.mean() > 0.98  # on an edge either neighbor is right
    hit = same & (triangle >= 0)
    assert 0.1 < hit.mean() < 1.0
    assert np.isinf(view.depth.ravel()[same & ~hit]).all()
    np.testing.assert_allclose(view.depth.ravel()[hit], depth[hit], rtol=1e-12)
    normal = np.einsum("nc,ncx->nx", hits.barycentric, mesh.normals[hits.triangle])[hit]
    found = compute_view_normals(mesh, camera, view).reshape(-1, 3)
    np.testing.assert_allclose(found[hit], normal / np.linalg.norm(normal, axis=1, keepdims=True), atol=1e-10)
    assert not found[same & ~hit].any()


@pytest.mark.parametrize("at_once", [1, 33, 64, 500, 1 << 20])
def test_a_view_is_the_same_for_any_ray_block_size(at_once, monkeypatch):
    rng = np.random.default_rng(4)
    mesh = mesh_of(rng.uniform(-1.0, 1.0, (60, 3)), np.arange(60).reshape(-1, 3).tolist())
    view = orthographic([0.0, 0.0, 0.0], [1, 0, 0], [0, 0, 1], 2.0, 33, 3.0)
    whole = cast_view(make_embree_caster(mesh), mesh, view)
    assert 0.1 < (whole.triangle >= 0).mean() < 1.0
    monkeypatch.setattr("hnf_core.scene.raycast.RAYS_PER_BLOCK", at_once)
    banded = cast_view(make_embree_caster(mesh), mesh, view)
    for name in ("depth", "triangle", "face_id"):
        assert getattr(banded, name).tobytes() == getattr(whole, name).tobytes()
