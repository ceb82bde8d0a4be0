"""Surface frames, evaluated meshes, faces traced through modifiers, hashes, and Blender's BVH against Embree."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere, datablock_names
from hypothesis import given, settings
from hypothesis import strategies as st
from mathutils import Euler, Matrix

from hnf_blender.bridge.scene.meshes import (
    BlenderGeometry,
    compute_surface_frame,
    hash_mesh,
    make_ray_caster,
    read_surface,
)
from hnf_core.errors import SceneError


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def surface(obj, metres_per_unit=1.0):
    return read_surface(obj, depsgraph(), metres_per_unit)


def turn(x, y, z):
    return np.array(Euler((x, y, z)).to_matrix())


angles = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)
matrices = st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9).map(lambda values: np.reshape(values, (3, 3)))


@settings(max_examples=60, deadline=None)
@given(matrices, angles, st.tuples(*[st.floats(-100.0, 100.0)] * 3), st.sampled_from([1.0, 0.01, 1000.0]))
def test_the_frame_is_rigid_and_stretch_ignores_rotation(linear, rotation, move, metres_per_unit):
    if np.linalg.cond(linear) > 1e3 or np.abs(linear).max() < 1e-3:
        return
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, move
    rigid, stretch = compute_surface_frame(matrix, metres_per_unit)
    np.testing.assert_allclose(rigid[:3, :3].T @ rigid[:3, :3], np.eye(3), atol=1e-10)
    assert np.linalg.det(rigid[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(rigid[:3, :3] @ stretch, metres_per_unit * linear, atol=1e-9 * metres_per_unit)
    np.testing.assert_allclose(rigid[:3, 3], metres_per_unit * np.array(move))
    turned = np.eye(4)
    turned[:3, :3] = turn(*rotation) @ linear
    again = compute_surface_frame(turned, metres_per_unit)[1]
    np.testing.assert_allclose(again, stretch, atol=2e-5 * metres_per_unit)  # the rotation is float32


def test_an_object_scaled_to_a_line_is_refused_by_name():
    with pytest.raises(SceneError, match="'Flat'"):
        compute_surface_frame(np.diag([1.0, 0.0, 0.0, 1.0]), 1.0, "object 'Flat'")


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 0.5, 3), (-1, 2, 1), (-1, -1, -1)])
def test_normals_and_winding_point_outward_whatever_the_scale(scale):
    ball = add_sphere()
    ball.scale, ball.rotation_euler, ball.location = scale, (0.3, -0.4, 2.0), (5, 6, 7)
    bpy.context.view_layer.update()
    mesh = surface(ball).mesh
    corners = mesh.corner_positions()
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(axis=1)
    assert (np.sum(winding * outward, axis=-1) > 0).all()
    assert (np.sum(mesh.normals * outward[:, None], axis=-1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1.0, atol=1e-6)


def test_the_surface_frame_maps_points_under_a_sheared_parent():
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, parent.rotation_euler = (1.0, 3.0, 0.5), (0.2, 0.1, 0.7)
    ball = add_sphere()
    ball.parent, ball.rotation_euler, ball.location = parent, (0.5, 0.6, 0.7), (1, 2, 3)
    bpy.context.view_layer.update()
    bpy.context.scene.unit_settings.scale_length = 0.01
    found = surface(ball, 0.01)
    world = np.array([list(ball.matrix_world @ vertex.co) for vertex in ball.data.vertices]) * 0.01
    there = found.mesh.vertices @ found.rigid[:3, :3].T + found.rigid[:3, 3]
    np.testing.assert_allclose(there, world, atol=1e-8)


def test_uv_slots_and_polygons_come_along():
    plane = add_plane(size=2.0)
    for name in ("a", "b"):
        plane.data.materials.append(bpy.data.materials.new(name))
    plane.data.polygons[0].material_index = 7  # past the last slot: Blender shows the last
    found = surface(plane)
    assert found.materials == ("a", "b")
    assert found.mesh.slot.tolist() == [1, 1]
    assert found.mesh.face.tolist() == [0, 0]
    np.testing.assert_allclose(found.mesh.uv, found.mesh.corner_positions()[..., :2], atol=1e-7)
    assert found.source_face.tolist() == [0]
    plane.data.uv_layers.remove(plane.data.uv_layers[0])
    plane.data.update_tag()
    assert surface(plane).mesh.uv is None


@pytest.mark.parametrize("kind", ["SUBSURF", "ARRAY", "TRIANGULATE", "MIRROR", "SOLIDIFY"])
def test_faces_are_traced_through_modifiers_that_change_topology(kind):
    plane = add_mesh(
        "Two", [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)], [(0, 1, 4, 3), (1, 2, 5, 4)]
    )
    modifier = plane.modifiers.new("m", kind)
    if kind == "SUBSURF":
        modifier.subdivision_type = "SIMPLE"
        modifier.levels = 2
    before = datablock_names()
    found = surface(plane)
    assert datablock_names() == before
    centre = found.mesh.corner_positions().mean(axis=1)
    place = np.abs(centre[:, 0]) if kind == "MIRROR" else centre[:, 0] % 2.0
    solid = np.abs(found.mesh.normals[:, 0, 2]) > 0.5  # not the rim
    expected = (place > 1.0).astype(int)
    assert solid.any()
    np.testing.assert_array_equal(found.source_face[found.mesh.face][solid], expected[solid])


def test_faces_from_another_object_have_no_source():
    plane, cutter = add_plane(size=2.0), add_sphere("Cutter", radius=0.5)
    modifier = plane.modifiers.new("join", "NODES")
    group = bpy.data.node_groups.new("join", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    other, join = group.nodes.new("GeometryNodeObjectInfo"), group.nodes.new("GeometryNodeJoinGeometry")
    other.inputs["Object"].default_value = cutter
    group.links.new(entry.outputs[0], join.inputs[0])
    group.links.new(other.outputs["Geometry"], join.inputs[0])
    group.links.new(join.outputs[0], leave.inputs[0])
    modifier.node_group = group
    found = surface(plane)
    assert sorted(set(found.source_face.tolist())) == [-1, 0]
    assert (found.source_face >= 0).sum() == 1


def test_an_object_without_faces_is_refused_by_name():
    with pytest.raises(SceneError, match="'Points'"):
        surface(add_mesh("Points", [(0, 0, 0)], []))
    empty = bpy.data.objects.new("Nothing", None)
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(SceneError, match="'Nothing'"):
        surface(empty)


def test_a_vertex_that_is_not_a_number_is_refused_by_name():
    plane = add_plane("Broken")
    plane.data.vertices[0].co.x = float("nan")
    with pytest.raises(SceneError, match="'Broken'"):
        surface(plane)


def test_a_shared_mesh_is_noted():
    plane = add_plane()
    twin = bpy.data.objects.new("twin", plane.data)
    bpy.context.scene.collection.objects.link(twin)
    assert any("shares" in note for note in surface(plane).notes)


def hash_of(obj, metres_per_unit=1.0):
    bpy.context.view_layer.update()
    return hash_mesh(obj, depsgraph(), metres_per_unit)


def test_the_hash_follows_shape_not_place():
    ball = add_sphere()
    first = hash_of(ball)
    ball.matrix_world = Matrix.Translation((10, 20, 30)) @ Euler((0.1, 0.2, 0.3)).to_matrix().to_4x4()
    assert hash_of(ball) == first
    attribute = ball.data.attributes.new("hnf_token", "INT", "FACE")
    attribute.data.foreach_set("value", np.ones(len(ball.data.polygons), np.int32))
    assert hash_of(ball) == first  # a bake must not make its own mesh stale
    seen = {first, hash_of(ball, 0.01)}
    ball.scale = (1, 1, 1.01)
    seen.add(hash_of(ball))
    ball.data.vertices[5].co.z += 1e-4
    seen.add(hash_of(ball))
    ball.data.uv_layers[0].uv[3].vector.x += 0.01
    seen.add(hash_of(ball))
    ball.modifiers.new("s", "SUBSURF")
    seen.add(hash_of(ball))
    assert len(seen) == 6


def test_blenders_tree_and_embree_hit_the_same():
    pytest.importorskip("embreex")
    ball = add_sphere()
    ball.location = (3, 4, 5)
    bpy.context.view_layer.update()
    mesh = surface(ball).mesh
    random = np.random.default_rng(0)
    origins = np.array([0, 0, 0.2]) + random.uniform(-0.04, 0.04, (2000, 3))
    directions = np.array([0, 0, -1.0]) + random.uniform(-0.2, 0.2, (2000, 3))
    ours, embree = BlenderGeometry(mesh).cast(origins, directions), make_ray_caster(mesh).cast(origins, directions)
    assert type(make_ray_caster(mesh)).__name__ == "EmbreeCaster"
    assert (embree.triangle >= 0).sum() > 1000
    inner = embree.barycentric.min(axis=1) > 1e-4
    assert (ours.triangle == embree.triangle)[inner].all()
    same = ours.triangle == embree.triangle
    np.testing.assert_array_equal(ours.distance[same], embree.distance[same])


def test_the_evaluated_frame_is_the_depsgraphs():
    plane = add_plane()
    plane.shape_key_add(name="Basis")
    key = plane.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 1.0
    key.value = 0.5
    bpy.context.view_layer.update()
    np.testing.assert_allclose(surface(plane).mesh.vertices[:, 2], 0.5)
