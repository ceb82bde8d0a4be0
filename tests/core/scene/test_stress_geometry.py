"""Stress: meshes of every size, place and shape, and what rays and the nearest point make of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from stress_meshes import PLACES, joined, mesh_of, plate, rays

from hnf_core.action.contacts import (
    StrokeSamples,
    action_from_contacts,
    find_contacts,
    find_nearest_on_triangles,
    plan_patches,
)
from hnf_core.action.stroke_placement import find_placements
from hnf_core.errors import SceneError
from hnf_core.progress import count_work
from hnf_core.scene.camera import orthographic
from hnf_core.scene.raycast import cast_view, compute_view_normals
from reference.geometry import ReferenceGeometry

CASTERS = ["reference", "embree"]


def caster(kind, mesh):
    if kind == "reference":
        return ReferenceGeometry(mesh)
    pytest.importorskip("embreex", reason="the fast caster needs embreex")
    from hnf_core.scene.raycast import make_embree_caster

    return make_embree_caster(mesh)


def hits(kind, mesh, size=1.0, shift=(0.0, 0.0, 0.0)):
    return caster(kind, mesh).cast(*rays(size, shift))


@pytest.mark.parametrize("kind", CASTERS)
@pytest.mark.parametrize("size", [1e-30, 1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e30])
def test_size(kind, size):
    """A mesh 1e-30 to 1e30 times as large → rays meet the same triangles, distances grow with it to 1e-14"""
    plain, found = hits(kind, plate()), hits(kind, plate(size), size)
    assert (plain.triangle >= 0).all()
    np.testing.assert_array_equal(found.triangle, plain.triangle)
    np.testing.assert_allclose(found.distance / size, plain.distance, rtol=1e-14)
    np.testing.assert_allclose(found.barycentric, plain.barycentric, atol=1e-12)


@pytest.mark.parametrize("kind", CASTERS)
@pytest.mark.parametrize("far", [1e4, 1e6])
def test_far_from_the_origin(kind, far):
    """A mesh 10 km, 1000 km from the origin → the same triangles; distances to 8 ε of the way there"""
    shift = (far, -far, far)
    plain, found = hits(kind, plate()), hits(kind, plate(shift=shift), shift=shift)
    np.testing.assert_array_equal(found.triangle, plain.triangle)
    assert np.abs(found.distance - plain.distance).max() < 8.0 * np.finfo(np.float64).eps * far


@pytest.mark.parametrize("kind", CASTERS)
@pytest.mark.parametrize("far", [1e4, 1e6])
def test_a_piece_far_away(kind, far):
    """A mesh with one face 10 km, 1000 km off → the rest loses nothing, in float32's tree too"""
    lone = [[[far, far, 0.0], [far + 1.0, far, 0.0], [far, far + 1.0, 0.0]]]
    plain, found = hits(kind, plate()), hits(kind, joined(plate(), lone))
    np.testing.assert_array_equal(found.triangle, plain.triangle)
    np.testing.assert_array_equal(found.distance, plain.distance)


@pytest.mark.parametrize("kind", CASTERS)
def test_a_stray_vertex(kind):
    """A vertex of no face, 1e30 m off or not a number → is not looked at"""
    stray = np.array([[1e30, 0.0, 0.0], [np.nan, np.inf, 0.0]])
    mesh = dataclasses.replace(plate(), vertices=np.concatenate([plate().vertices, stray]))
    np.testing.assert_array_equal(hits(kind, mesh).distance, hits(kind, plate()).distance)


@pytest.mark.parametrize("kind", CASTERS)
@pytest.mark.parametrize("width", [0.0, 1e-300, 1e-16, 1e-10])
def test_faces_without_area(kind, width):
    """Faces without area on a surface (points, lines, 1e-10 wide) → every ray meets the surface, at its distance"""
    plain = hits(kind, plate())
    origins, directions = rays()
    place = origins + plain.distance[:, None] * directions
    across = np.array([0.1, 0.03, 0.0])
    thin = np.stack([place - across, place + across, place + width * np.array([-0.03, 0.1, 0.0])], axis=1)
    mesh = joined(joined(plate(), thin), np.repeat(place[:, None], 3, axis=1))
    found = hits(kind, mesh)
    assert (found.triangle >= 0).all()
    assert np.isfinite(found.barycentric).all()
    np.testing.assert_allclose(found.distance, plain.distance, rtol=1e-12)
    nearest = find_nearest_on_triangles(place + np.array([0.0, 0.0, 1e-3]), mesh.corner_positions())
    assert nearest.distance.max() <= 1e-3 * (1.0 + 1e-9)
    assert np.isfinite(nearest.barycentric).all()


@pytest.mark.parametrize("kind", CASTERS)
def test_only_faces_without_area(kind):
    """Nothing but faces without area → no ray meets them, and none crashes"""
    line = [[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]]]
    found = hits(kind, mesh_of(np.reshape(line, (3, 3)), [[0, 1, 2]]))
    assert (found.triangle == -1).all()
    assert np.isinf(found.distance).all()


@pytest.mark.parametrize("kind", CASTERS)
@pytest.mark.parametrize(
    ("vertices", "words"),
    [
        (np.full((3, 3), 5.0), "lies within 0 m"),
        (1e-70 * np.eye(3), "lies within"),
        (1e70 * np.eye(3), r"reaches \d+e\+\d+ m"),
        (np.where(np.eye(3), np.nan, 0.0), "not a number"),
        (np.where(np.eye(3), np.inf, 0.0), "not a number"),
    ],
    ids=["a point", "1e-70 m", "1e70 m", "NaN", "inf"],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # of the normals that the test itself takes
def test_no_place(kind, vertices, words):
    """All of a mesh in one point, 1e-70 m or 1e70 m wide, a corner NaN or infinite → SceneError with its size"""
    with pytest.raises(SceneError, match=words):
        caster(kind, mesh_of(vertices, [[0, 1, 2]]))


@pytest.mark.parametrize("kind", CASTERS)
def test_infinite_depth(kind):
    """A camera that looks past the mesh → depth ∞, ids −1, normals 0, no NaN"""
    camera = orthographic([0.45, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0.5, 8, 1.0)
    view = cast_view(caster(kind, plate()), plate(), camera)
    missed = view.triangle < 0
    assert 0 < missed.sum() < missed.size
    assert np.isinf(view.depth[missed]).all()
    normal = compute_view_normals(plate(), camera, view)
    assert not normal[missed].any()
    assert np.isfinite(view.depth[~missed]).all()
    np.testing.assert_allclose(np.linalg.norm(normal[~missed], axis=-1), 1.0, atol=1e-12)


@pytest.mark.parametrize("kind", CASTERS)
def test_a_patch_of_one_micrometre(kind):
    """A patch of 1 µm, seen from 10 mm → depths to 1e-11 m of the facet's plane"""
    camera = orthographic([0.1, 0.1, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1e-6, 8, 0.3)
    flat = mesh_of([[-1, -1, 0], [1, -1, 0], [0, 1, 1e-3]], [[0, 1, 2]])
    view = cast_view(caster(kind, flat), flat, camera)
    points = camera.unproject(camera.pixel_centres(), view.depth)
    assert np.ptp(points[..., 0]) == pytest.approx(7e-6 / 8.0, rel=1e-6)
    np.testing.assert_allclose(points[..., 2], 5e-4 * (points[..., 1] + 1.0), atol=1e-11)


def stroke_over(shift=(0.0, 0.0, 0.0), count=41) -> StrokeSamples:
    time = np.arange(count) / 200.0
    x = np.linspace(-0.02, 0.02, count)
    point = np.stack([x, 0.3 * x, np.full(count, 1e-3)], axis=1) + np.asarray(shift)
    tangent = np.tile(np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3), (count, 1))
    way = np.hypot(1.0, 0.3) * (x - x[0])
    return StrokeSamples(time, point, tangent, way, np.gradient(way, time), np.ones(count))


@pytest.mark.parametrize("far", [1e4, 1e6])
def test_contacts_far_away(far):
    """A stroke and its surface moved by 10 km, 1000 km → the same contacts and u(t), within 16 ε of the way"""
    shift = np.array([far, far, -far])
    bound = 16.0 * np.finfo(np.float64).eps * far
    (here, u), (there, v) = (touched(stroke_over(move), plate(0.1, move, cells=5)) for move in (np.zeros(3), shift))
    np.testing.assert_array_equal(here.triangle, there.triangle)
    assert np.abs(there.point - shift - here.point).max() < bound
    assert np.abs(there.distance - here.distance).max() < bound
    assert here.on_surface.all()
    np.testing.assert_allclose(there.normal, here.normal, atol=bound / 0.01)
    np.testing.assert_allclose(v.speed, u.speed, rtol=bound / 0.01)
    np.testing.assert_allclose(v.direction, u.direction, atol=bound / 0.01)


def touched(samples, mesh):
    contacts = find_contacts(samples, mesh)
    patches, index = plan_patches(contacts)
    return contacts, action_from_contacts(contacts, patches, index)


def test_a_dense_mesh_far_away_needs_no_more_pairs():
    """Nearest points on 10 km of coordinates → as few triangles are looked at as at the origin"""
    looked = []
    points = np.concatenate([0.1 * PLACES, np.full((len(PLACES), 1), 1e-3)], axis=1)
    for shift in (0.0, 1e4):
        with count_work() as work:
            find_nearest_on_triangles(points + shift, plate(0.1, (shift,) * 3, cells=40).corner_positions())
        looked.append(work.total("nearest_pairs"))
    assert 0 < looked[1] <= 1.1 * looked[0]


def test_places_on_what_is_too_small_or_large():
    """A primitive on a plate of 1 µm → no place; of 10 km → at its largest, 60 mm"""

    def path_of(size):
        return np.stack([np.linspace(-0.5, 0.5, 9) * size, np.zeros(9)], axis=1)

    tiny, huge = plate(1e-6, cells=4), plate(1e4, cells=4)
    assert list(find_placements(tiny, caster("embree", tiny), 0, path_of)) == []
    first = next(find_placements(huge, caster("embree", huge), 0, path_of))
    assert first.size_m == 60e-3
    assert np.isfinite(first.centre).all()
