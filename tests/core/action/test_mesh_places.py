"""Contact points on a mesh, found by UV or in space, and their agreement with the contacts of a stroke."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.contacts import StrokeSamples, find_contacts, plan_patches
from hnf_core.action.surface_point import compute_uv_barycentric, find_point_at_uv, find_point_near, select_slot
from hnf_core.errors import SceneError
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.touch_request import parse_touch_query

SIDE = 0.1
unit = st.floats(0.0, 1.0)


def square(uv=True, height=0.0, slot=0) -> TriangleMesh:
    """A flat square of two triangles (one polygon) in x, y, facing +z; UVs run 0–1 along them."""
    corners = np.array([(0.0, 0.0, height), (SIDE, 0.0, height), (SIDE, SIDE, height), (0.0, SIDE, height)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32)
    return TriangleMesh(
        vertices=corners,
        triangles=triangles,
        face=np.zeros(2, dtype=np.int32),
        slot=np.full(2, slot, dtype=np.int32),
        normals=np.tile([0.0, 0.0, 1.0], (2, 3, 1)),
        uv=corners[triangles][..., :2] / SIDE if uv else None,
    )


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """One mesh of several, their faces counted on."""
    vertices, triangles, face, start = [], [], [], 0
    for number, mesh in enumerate(meshes):
        vertices.append(mesh.vertices)
        triangles.append(mesh.triangles + start)
        face.append(mesh.face + number)
        start += len(mesh.vertices)
    return TriangleMesh(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(face).astype(np.int32),
        np.concatenate([mesh.slot for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
    )


@settings(max_examples=60, deadline=None)
@given(unit, unit)
def test_every_uv_of_the_square_is_where_its_uv_says(u, v) -> None:
    place = find_point_at_uv(square(), (u, v))
    assert place.point == pytest.approx([u * SIDE, v * SIDE, 0.0], abs=1e-9)
    assert place.uv == pytest.approx([u, v], abs=1e-9)
    assert place.patch.x_axis == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert place.notes == ()


@settings(max_examples=60, deadline=None)
@given(unit, unit)
def test_a_place_by_uv_is_the_place_in_space(u, v) -> None:
    by_uv = find_point_at_uv(square(), (u, v))
    in_space = find_point_near(square(), by_uv.point)
    assert in_space.point == pytest.approx(by_uv.point, abs=1e-9)
    assert in_space.patch.normal == pytest.approx(by_uv.patch.normal)
    assert in_space.uv == pytest.approx(by_uv.uv, abs=1e-7)


def test_a_point_gets_the_same_patch_as_a_stroke_contact() -> None:
    mesh, count = square(), 5
    point = np.tile([0.03, 0.04, 0.0], (count, 1))
    samples = StrokeSamples(
        np.arange(count) / 100.0, point, np.tile([1.0, 0.0, 0.0], (count, 1)), np.zeros(count), np.zeros(count),
        np.ones(count),
    )  # fmt: skip
    (patch,), _ = plan_patches(find_contacts(samples, mesh))
    own = find_point_at_uv(mesh, (0.3, 0.4)).patch
    assert own.slot == patch.slot
    assert own.size_m == patch.size_m
    for name in ("centre", "x_axis", "normal"):
        assert getattr(own, name) == pytest.approx(getattr(patch, name), abs=1e-9)


def test_a_uv_outside_every_face_is_told_with_what_there_is() -> None:
    with pytest.raises(SceneError, match=r"no face has the UV \(1.5, 0.5\)") as told:
        find_point_at_uv(square(), (1.5, 0.5), where="object 'Plate'")
    assert "(0, 0) and (1, 1)" in str(told.value)


def test_a_mesh_without_uvs_says_what_to_do() -> None:
    with pytest.raises(SceneError, match="Unwrap it"):
        find_point_at_uv(square(uv=False), (0.5, 0.5))
    place = find_point_near(square(uv=False), np.array([0.05, 0.05, 0.0]))
    assert not place.tangent_known
    assert place.uv is None


def test_overlapping_uvs_give_the_first_face_and_a_note() -> None:
    mesh = joined(square(height=0.2), square())
    place = find_point_at_uv(mesh, (0.25, 0.5), where="object 'Plate'")
    assert place.face == 0
    assert place.point[2] == pytest.approx(0.2)
    assert "1 more face has the same UV" in place.notes[0]
    three = find_point_at_uv(joined(square(), square(), square()), (0.25, 0.5))
    assert "2 more faces have" in three.notes[0]


def test_a_slot_parts_islands_that_overlap() -> None:
    mesh = joined(square(height=0.2), square(slot=1))
    place = find_point_at_uv(select_slot(mesh, 1), (0.25, 0.5))
    assert place.notes == ()
    assert (place.point[2], place.face, place.patch.slot) == (0.0, 1, 1)
    assert find_point_near(select_slot(mesh, 1), np.array([0.05, 0.05, 0.001])).patch.slot == 1
    with pytest.raises(SceneError, match="no face of it"):
        find_point_at_uv(select_slot(mesh, 7), (0.25, 0.5))
    with pytest.raises(SceneError, match="no face of it"):
        find_point_near(select_slot(mesh, 7), np.zeros(3))


def test_neighbours_that_share_an_edge_do_not_overlap() -> None:
    """The square's own diagonal and corners lie on both of its triangles."""
    for uv in ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0)):
        assert find_point_at_uv(square(), uv).notes == ()


def test_a_place_off_the_surface_is_refused_with_its_distance() -> None:
    assert find_point_near(square(), np.array([0.05, 0.05, 0.004])).point[2] == pytest.approx(0.0)
    with pytest.raises(SceneError, match="30 mm away"):
        find_point_near(square(), np.array([0.05, 0.05, 0.03]))
    with pytest.raises(SceneError):
        find_point_near(square(), np.array([np.nan, 0.0, 0.0]))


def test_triangles_without_uv_area_hold_nothing() -> None:
    flat = np.zeros((1, 3, 2))
    assert (compute_uv_barycentric(flat, np.zeros(2)) == -1.0).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(-10, 10), st.floats(-10, 10), st.text(min_size=1, max_size=12).filter(lambda name: name.strip()))
def test_words_of_a_place_are_read_back(u, v, name) -> None:
    place = parse_touch_query(f"{name}:{u!r},{v!r}")
    assert (place.target, place.at) == (name, (u, v))
    assert parse_touch_query(place.name).at == pytest.approx(place.at, rel=1e-8)


def test_queries_parse_names_with_colons_and_3d_points() -> None:
    assert parse_touch_query("Cup:left:0.1,0.2").target == "Cup:left"
    assert parse_touch_query("Cup:1,2,-3e-1").at == (1.0, 2.0, -0.3)


@pytest.mark.parametrize(
    "text", ["Cup", "Cup:", ":0.5,0.5", "Cup:0.5", "Cup:a,b", "Cup:nan,0", "Cup:1,2,3,4", "Cup:inf,1"]
)
def test_words_that_are_no_place_are_refused(text) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="OBJECT:u,v"):
        parse_touch_query(text)
