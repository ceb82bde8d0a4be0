"""Cropping of a mesh around points: rays within reach hit the same triangles as in the whole mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.scene.camera import Patch
from hnf_core.scene.mesh import TriangleMesh, crop_mesh
from hnf_core.scene.raycast import cast_view, compute_view_normals
from reference.geometry import ReferenceGeometry


def random_mesh(seed: int, count: int = 60, size: float = 0.02) -> TriangleMesh:
    """Triangles anywhere within 0.1 m, some of them long."""
    random = np.random.default_rng(seed)
    middle = random.uniform(-0.05, 0.05, (count, 1, 3))
    corners = middle + size * random.standard_normal((count, 3, 3)) * random.choice([0.2, 1.0, 5.0], (count, 1, 1))
    index = np.arange(count, dtype=np.int32)
    normals = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None], 3, axis=1)
    uv = random.uniform(0.0, 1.0, (count, 3, 2))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3), 7 * index,
                        index % 3, normals, uv)  # fmt: skip


@given(st.integers(0, 10**6), st.integers(1, 5), st.floats(1e-3, 0.1))
def test_a_crop_drops_only_triangles_out_of_reach_of_all_points(seed, count, reach):
    mesh = random_mesh(seed)
    places = np.random.default_rng(seed + 1).uniform(-0.1, 0.1, (count, 3))
    near = crop_mesh(mesh, places, reach)
    corners = mesh.corner_positions()
    low, high = corners.min(axis=1), corners.max(axis=1)
    expected = [
        k for k in range(len(low)) if any((low[k] <= p + reach).all() and (high[k] >= p - reach).all() for p in places)
    ]
    assert near.face.tolist() == mesh.face[expected].tolist()
    np.testing.assert_array_equal(near.corner_positions(), corners[expected])
    np.testing.assert_array_equal(near.normals, mesh.normals[expected])
    np.testing.assert_array_equal(near.slot, mesh.slot[expected])
    np.testing.assert_array_equal(near.uv, mesh.uv[expected])
    assert len(near.vertices) == 3 * len(expected)


@pytest.mark.parametrize("seed", range(8))
def test_a_close_up_of_the_near_part_is_that_of_the_whole(seed):
    mesh, random = random_mesh(seed), np.random.default_rng(seed)
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    x_axis = np.cross(normal, [0.0, 0.0, 1.0])
    patch = Patch(mesh.corner_positions()[seed].mean(axis=0), x_axis / np.linalg.norm(x_axis), normal, 0)
    near = crop_mesh(mesh, [patch.centre], patch.reach_m)
    assert 0 < len(near.triangles) < len(mesh.triangles)
    camera = patch.camera(24)
    whole, part = (cast_view(ReferenceGeometry(each), each, camera) for each in (mesh, near))
    np.testing.assert_array_equal(part.depth, whole.depth)
    np.testing.assert_array_equal(part.face_id, whole.face_id)
    normals = [compute_view_normals(*each) for each in ((mesh, camera, whole), (near, camera, part))]
    np.testing.assert_array_equal(*normals)
    assert (whole.face_id >= 0).any()


def test_a_place_without_anything_near_leaves_nothing():
    near = crop_mesh(random_mesh(0), [(9.0, 9.0, 9.0)], 0.01)
    assert (near.triangles.shape, near.vertices.shape) == ((0, 3), (0, 3))
