"""Stress: scenes whose unit, size or place is far from what a hand touches."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere
from mathutils import Matrix
from stroke_builders import act, add_stroke, key, read

from hnf_blender.bridge.scene.meshes import BlenderGeometry, hash_mesh, read_surface
from hnf_core.errors import HnfError, SceneError, StrokeError
from reference.geometry import ReferenceGeometry

LINE = np.array([(-0.01, 0.002, 0.0495), (0.0, 0.004, 0.0505), (0.01, -0.002, 0.0495)])


def clear():
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)


def touched(units=1.0, place=(0.0, 0.0, 0.0)):
    """A stroke on a ball, drawn in a scene of so many units a metre; what became of it."""
    clear()
    metres = 1.0 / units
    ball = add_sphere(radius=0.05, segments=24, rings=12)
    ball.scale = (units,) * 3
    stroke = add_stroke([tuple(point) for point in LINE * units], law="DURATION", duration=0.5)
    for obj in (ball, stroke):
        obj.location = place
    bpy.context.view_layer.update()
    return act(stroke, metres)


@pytest.mark.parametrize("units", [1e-6, 1e-3, 1e3, 1e6])
def test_units(units):
    """A scene and its unit 10⁶ times smaller or larger together → the same contacts and u(t), to float32's digits"""
    _, contacts, patches, action = touched()
    _, found, again, scaled = touched(units)
    assert contacts.on_surface.all()
    assert len(again) == len(patches)
    np.testing.assert_array_equal(found.on_surface, contacts.on_surface)
    np.testing.assert_allclose(found.point, contacts.point, atol=1e-8)
    for name in ("speed", "force", "position", "direction"):
        np.testing.assert_allclose(getattr(scaled, name), getattr(action, name), atol=2e-6)


@pytest.mark.parametrize("far", [1024.0, 10_240.0])
def test_far_from_the_origin(far):
    """A scene moved by 10 km → the same contacts, within 1e-7 of the way: what Blender's float32 matrices hold"""
    _, contacts, _, action = touched()
    _, found, _, moved = touched(place=(far, -far, far))
    bound = 1e-7 * far
    np.testing.assert_allclose(found.point, contacts.point, atol=bound)
    np.testing.assert_allclose(moved.speed, action.speed, atol=bound / 0.5)
    assert found.on_surface.all()


@pytest.mark.parametrize("unit", [1e-6, 1e7])
def test_a_wrong_unit(unit):
    """An object 0.1 µm or 1000 km across, since its unit is off by 10⁶ → SceneError that names it and Units"""
    add_sphere("Mug", radius=0.05)
    with pytest.raises(SceneError, match=r"'Mug': it is .* m across") as caught:
        read_surface(bpy.data.objects["Mug"], bpy.context.evaluated_depsgraph_get(), unit * (1.0 if unit > 1 else 0.1))
    assert "Units" in caught.value.remedy


@pytest.mark.parametrize("scale", [1e-6, 1e-4, 1.0, 1e4, 1e6])
def test_hashes_of_every_scale(scale):
    """Objects scaled by 1e-6 to 1e6 → turned the same hash, 1 % larger another; tiny ones had all the same"""

    def hashed(factor, angle):
        ball.matrix_world = Matrix.Rotation(angle, 4, "X") @ Matrix.Scale(factor, 4)
        bpy.context.view_layer.update()
        return hash_mesh(ball, bpy.context.evaluated_depsgraph_get(), 1.0 / scale)

    ball = add_sphere(segments=8, rings=4)
    plain = hashed(scale, 0.0)
    assert hashed(scale, 0.5) == plain
    assert hashed(1.01 * scale, 0.0) != plain


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_blenders_tree(size):
    """Blender's own tree on a mesh 1e-12 or 1e12 m wide, with faces without area → the triangles of the reference"""
    from hnf_core.scene.mesh import TriangleMesh

    rng = np.random.default_rng(0)
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.1], [1.0, 1.0, 0.0], [-1.0, 1.0, -0.1]])
    flat = np.array([[-0.9, -0.2, 0.05], [0.9, 0.2, 0.05], [0.0, 0.0, 0.05]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], dtype=np.int32)
    index = np.arange(3, dtype=np.int32)
    vertices = np.concatenate([corners, flat]) * size
    mesh = TriangleMesh(vertices, triangles, index, index * 0, np.tile([0.0, 0.0, 1.0], (3, 3, 1)))
    origins = np.concatenate([rng.uniform(-0.9, 0.9, (50, 2)), np.ones((50, 1))], axis=1) * size
    directions = np.tile([0.02, 0.01, -1.0], (50, 1))
    found, exact = (made(mesh).cast(origins, directions) for made in (BlenderGeometry, ReferenceGeometry))
    np.testing.assert_array_equal(found.triangle, exact.triangle)
    np.testing.assert_allclose(found.distance, exact.distance, rtol=1e-12)


def test_a_stroke_of_two_milliseconds():
    """A stroke keyed over 2 ms, or over an hour → StrokeError with the stroke's name, its length and the bound"""
    add_plane()
    stroke = add_stroke([(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)], law="PROGRESS")
    for frames, words in (((1.0, 1.05), "0.005 s is the least"), ((1.0, 1.0 + 24.0 * 3600.0), "600 s is the most")):
        stroke.animation_data_clear()
        key(stroke, "progress", (frames[0], 0.0), (frames[1], 1.0))
        with pytest.raises(StrokeError, match=words) as caught:
            read(stroke)
        assert "'Scrape'" in str(caught.value)


def test_a_hand_too_fast():
    """A stroke of 60 km in a second, since its unit is off by 10⁶ → StrokeError with its speed, before any render"""
    add_plane()
    stroke = add_stroke([(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)], law="DURATION", duration=1.0)
    with pytest.raises(StrokeError, match=r"'Scrape': the hand moves at .* m/s") as caught:
        read(stroke, 1e6)
    assert "unit scale" in caught.value.remedy


def test_a_curve_of_many_points():
    """A drawn curve of 100 000 points → a stroke along it, its ends where they were drawn"""
    add_plane(size=0.2)
    turn = np.linspace(0.0, 40.0, 100_000)
    points = np.stack([0.001 * turn * np.cos(turn), 0.001 * turn * np.sin(turn), np.zeros_like(turn)], axis=1)
    curve = bpy.data.curves.new("Long", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(len(points) - 1)
    spline.points.foreach_set("co", np.concatenate([points, np.ones((len(points), 1))], axis=1).ravel())
    obj = bpy.data.objects.new("Long", curve)
    bpy.context.scene.collection.objects.link(obj)
    obj.hnf_stroke.is_stroke = True
    obj.hnf_stroke.law, obj.hnf_stroke.duration = "DURATION", 0.5
    bpy.context.view_layer.update()
    stroke = read(obj)
    np.testing.assert_allclose(stroke.samples.point[[0, -1]], points[[0, -1]], atol=1e-6)
    assert np.isfinite(stroke.samples.tangent).all()


def test_flat_faces_of_an_object():
    """An object of faces without area beside true ones → read, touched, and no error that is not the project's"""
    mug = add_mesh(
        "Mug", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 0), (0, 0, 0), (0.5, 0, 0)],
        [(0, 1, 2, 3), (4, 5, 6)],
    )  # fmt: skip
    mug.scale = (0.05, 0.05, 0.05)
    bpy.context.view_layer.update()
    try:
        _, contacts, _, action = act(add_stroke([(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)], law="DURATION", duration=0.2))
    except HnfError as error:
        pytest.fail(str(error))
    assert contacts.on_surface.all()
    assert np.isfinite(action.direction).all()
    assert np.isfinite(contacts.normal).all()
