"""Strokes on moving, turned, scaled and deforming surfaces: choice of the surface, and the hash."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere, datablock_names
from stroke_builders import LINE, act, add_stroke, key, keyed_fcurves, read

from hnf_blender.bridge.stroke.place_primitive import place_primitive
from hnf_blender.bridge.stroke.read_stroke import hash_path, hash_touch
from hnf_core.errors import SceneError, StrokeError

# Places and motion


def test_off_surface_and_zero_length():
    add_plane(size=0.1)
    obj = add_stroke([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
    _, contacts, _, action = act(obj)
    off = contacts.time[~contacts.on_surface]
    assert len(off)
    assert not action.contact[~contacts.on_surface].any()
    assert action.contact[contacts.on_surface].all()
    press = add_stroke([(0.01, 0.0, 0.0)], name="Press", law="PROGRESS")
    key(press, "force", (1, 0.0), (5, 2.0), (9, 0.0))
    stroke, _, _, action = act(press)
    assert stroke.length_m == 0.0
    assert not action.speed.any()
    assert action.force.max() == pytest.approx(2.0, rel=1e-3)
    still = add_stroke([(0.01, 0.0, 0.0)], name="Still")
    with pytest.raises(StrokeError, match="stroke 'Still': it has no length, and its force has no keyframes"):
        read(still)


def uneven(name="Ground"):
    line = np.linspace(-0.06, 0.06, 25)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line))
    vertices = np.stack([x, y, 2.0 * x * y + x * x], 1)
    i = (np.arange(24)[:, None] * 25 + np.arange(24)).ravel()
    return add_mesh(name, vertices, np.stack([i, i + 1, i + 26, i + 25], 1), uv=lambda co: (co.x, co.y), smooth=True)


CURVED = [(x, y, 2 * x * y + x * x) for x, y in [(-0.04, -0.02), (-0.01, 0.01), (0.02, 0.0), (0.03, 0.03)]]


def assert_same_action(first, second, atol=1e-6):
    assert len(first.speed) == len(second.speed)
    for name in ("direction", "speed", "force", "position"):
        assert np.allclose(getattr(first, name), getattr(second, name), atol=atol), name


@pytest.mark.parametrize("parented", [False, True])
def test_moving_and_turning_the_scene_changes_nothing(parented):
    from mathutils import Euler, Matrix

    ground, obj = uneven(), add_stroke(CURVED, kind="BEZIER")
    if parented:
        obj.parent = ground
    *_, before = act(obj)
    motion = Matrix.Translation((1.0, -2.0, 3.0)) @ Euler((0.5, -1.1, 2.0)).to_matrix().to_4x4()
    ground.matrix_world = motion
    if not parented:
        obj.matrix_world = motion
    bpy.context.view_layer.update()
    *_, after = act(obj)
    assert_same_action(before, after)


def test_uvs_turned_by_90_degrees_swap_along_and_across():
    plane = add_plane()
    obj = add_stroke(LINE)
    *_, before = act(obj)
    for loop in plane.data.uv_layers[0].uv:
        loop.vector = (-loop.vector[1], loop.vector[0])
    plane.data.update()
    bpy.context.view_layer.update()
    *_, after = act(obj)
    assert np.allclose(before.direction, [1, 0], atol=1e-6)
    assert np.allclose(after.direction, [0, 1], atol=1e-6)


def test_object_scale_and_scale_length():
    plane, obj = add_plane(), add_stroke(LINE)
    obj.parent = plane
    _, _, small_patches, small = act(obj)
    plane.scale = (2, 2, 2)
    bpy.context.view_layer.update()
    stroke, _, _, double = act(obj)
    assert stroke.length_m == pytest.approx(0.12)
    assert double.speed.max() == pytest.approx(small.speed.max())
    assert double.duration_s == pytest.approx(small.duration_s + 0.6, abs=0.006)
    plane.scale = (1, 1, 1)
    bpy.context.view_layer.update()
    stroke, _, patches, action = act(obj, metres_per_unit=0.5)
    assert stroke.length_m == pytest.approx(0.03)
    assert action.speed.max() == pytest.approx(0.1, rel=1e-6)
    assert patches[0].size_m == small_patches[0].size_m


def test_unequal_scale_is_measured_on_the_surface():
    plane, obj = add_plane(), add_stroke([(0, 0, 0), (0.03, 0.03, 0)])
    obj.parent = plane
    plane.scale = (2, 1, 1)
    bpy.context.view_layer.update()
    stroke, _, _, action = act(obj)
    assert stroke.length_m == pytest.approx(np.hypot(0.06, 0.03))
    assert np.allclose(action.direction, np.array([2, 1]) / np.sqrt(5), atol=1e-6)


def test_surface_is_the_nearest_visible_or_the_chosen():
    add_plane("Near", z=-0.001)
    far, hidden = add_plane("Far", z=-0.004), add_plane("Hidden")
    hidden.hide_render = True
    add_plane("Elsewhere").location.x = 5.0
    empty = bpy.data.objects.new("Empty mesh", bpy.data.meshes.new("Empty mesh"))
    bpy.context.scene.collection.objects.link(empty)
    obj = add_stroke(LINE)
    assert read(obj).object_name == "Near"
    obj.hnf_stroke.surface = far
    assert read(obj).object_name == "Far"
    obj.hnf_stroke.surface = hidden
    with pytest.raises(SceneError, match=r"object 'Hidden': it is hidden, and stroke 'Scrape' touches it\. Show"):
        read(obj)
    hidden.hide_render = False
    hidden.hide_set(True)
    with pytest.raises(SceneError, match="object 'Hidden': it is hidden"):
        read(obj)
    obj.hnf_stroke.surface = empty
    with pytest.raises(SceneError, match=r"object 'Empty mesh'.*no faces"):
        read(obj)
    bpy.context.scene.collection.objects.unlink(far)
    obj.hnf_stroke.surface = far
    with pytest.raises(SceneError, match=r"object 'Far': it is not in this scene.*or link the object to this scene"):
        read(obj)


def test_no_mesh_at_all():
    with pytest.raises(StrokeError, match="stroke 'Scrape': there is no visible mesh"):
        read(add_stroke(LINE))


def linear(obj):
    for fcurve in keyed_fcurves(obj):
        for point in fcurve.keyframe_points:
            point.interpolation = "LINEAR"


def test_sliding_surface_adds_its_speed():
    plane = add_plane(size=0.6)
    plane.location = (0, 0, 0)
    plane.keyframe_insert("location", frame=1)
    plane.location = (-0.1, 0, 0)
    plane.keyframe_insert("location", frame=49)
    linear(plane)
    bpy.context.scene.frame_set(1)
    obj = add_stroke(LINE)
    obj.location.z = 0.001  # an unkeyed change of the artist's
    bpy.context.view_layer.update()
    names = datablock_names()
    stroke, _, _, action = act(obj)
    assert stroke.samples.moving
    assert np.allclose(action.speed[1:-1], np.abs(stroke.samples.velocity)[1:-1] + 0.05, atol=2e-4)
    assert plane.location.x == 0.0
    assert obj.location.z == pytest.approx(0.001)
    assert datablock_names() == names


def test_turntable_under_a_resting_hand():
    """A record player: nothing but the surface turns, and the hand feels ω r."""
    disc = add_plane(size=0.3)
    disc.rotation_euler.z = 0.0
    disc.keyframe_insert("rotation_euler", frame=1)
    disc.rotation_euler.z = 2.0
    disc.keyframe_insert("rotation_euler", frame=49)
    linear(disc)
    obj = add_stroke([(0.08, 0, 0)], law="DURATION", duration_s=1.5)
    _, contacts, _, action = act(obj)
    assert np.allclose(action.speed[2:-2], 0.08, rtol=2e-3)
    radius = np.linalg.norm(contacts.point[:, :2], axis=1)
    assert np.allclose(radius, 0.08, atol=1e-6)
    assert action.position[-1] == pytest.approx(0.08 * 1.5, rel=1e-2)


def test_a_shared_moving_parent_adds_no_relative_motion():
    carrier = bpy.data.objects.new("Carrier", None)
    bpy.context.scene.collection.objects.link(carrier)
    carrier.keyframe_insert("location", frame=1)
    carrier.location = (3, 1, 0)
    carrier.keyframe_insert("location", frame=30)
    plane, obj = add_plane(), add_stroke(LINE)
    plane.parent = obj.parent = carrier
    bpy.context.scene.frame_set(1)
    stroke, _, _, action = act(obj)
    assert not stroke.samples.moving
    assert action.speed.max() == pytest.approx(0.1, rel=1e-5)


def test_shape_keys_that_move_the_surface():
    plane = add_plane(size=0.6)
    plane.shape_key_add(name="Basis")
    shifted = plane.shape_key_add(name="Shifted", from_mix=False)
    for point in shifted.data:
        point.co.x -= 0.1
    shifted.value = 0.0
    shifted.keyframe_insert("value", frame=1)
    shifted.value = 1.0
    shifted.keyframe_insert("value", frame=49)
    linear(plane.data.shape_keys)
    bpy.context.scene.frame_set(1)
    obj = add_stroke(LINE)
    stroke, contacts, _, action = act(obj)
    assert stroke.deforming is not None
    assert np.allclose(action.speed, np.abs(stroke.samples.velocity) + 0.05, atol=1e-4)
    # In the material's own coordinates the hand has come 0.06 + 0.05 t.
    assert contacts.point[-1, 0] == pytest.approx(0.03 + 0.05 * stroke.samples.time[-1], abs=1e-4)


def test_armature_deforms_the_surface():
    plane = add_plane(size=0.6)
    armature = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", armature)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.edit_bones.new("Bone")
    bone.head, bone.tail = (0, 0, 0), (0, 0.1, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    group = plane.vertex_groups.new(name="Bone")
    group.add(range(4), 1.0, "REPLACE")
    plane.modifiers.new("Armature", "ARMATURE").object = rig
    pose = rig.pose.bones["Bone"]
    pose.location = (0, 0, 0)
    pose.keyframe_insert("location", frame=1)
    pose.location = (0.1, 0, 0)
    pose.keyframe_insert("location", frame=49)
    linear(rig)
    bpy.context.scene.frame_set(1)
    stroke, _, _, action = act(add_stroke([(0.0, 0, 0)], law="DURATION", duration_s=1.0))
    assert stroke.deforming is not None
    assert np.allclose(action.speed, 0.05, atol=1e-4)
    assert np.allclose(action.direction, [-1, 0], atol=1e-3)


def lift_by_shape_key():
    """A cloth that a shape key lifts by 0.2 m and turns over one side within a second."""
    cloth = add_plane(size=0.4)
    cloth.shape_key_add(name="Basis")
    up = cloth.shape_key_add(name="Up", from_mix=False)
    for point in up.data:
        point.co.z += 0.2 + 0.5 * point.co.x
    for frame, value in ((1, 0.0), (25, 1.0)):
        up.value = value
        up.keyframe_insert("value", frame=frame)
    return cloth


def swing_by_armature():
    """A plate skinned to a bone that turns by 90 degrees within a second."""
    plate = add_plane(size=0.4)
    armature = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", armature)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.edit_bones.new("Bone")
    bone.head, bone.tail = (-0.5, 0, 0), (-0.5, 0.1, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    plate.vertex_groups.new(name="Bone").add(range(4), 1.0, "REPLACE")
    plate.modifiers.new("Armature", "ARMATURE").object = rig
    plate.parent = rig  # as glTF and FBX files are
    pose = rig.pose.bones["Bone"]
    pose.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (25, 1.57)):
        pose.rotation_euler.y = angle
        pose.keyframe_insert("rotation_euler", frame=frame)
    return plate


@pytest.mark.parametrize("deform", [lift_by_shape_key, swing_by_armature])
@pytest.mark.parametrize(("now", "start"), [(1, 1.0), (1, 12.5), (20, 1.0), (25, 25.0)])
def test_a_ready_stroke_rides_on_a_skin_that_moves_away(deform, now, start):
    surface = deform()
    scene = bpy.context.scene
    scene.frame_set(now)
    placed = place_primitive(scene, surface, None, "default", 1.0, start_frame=start)
    _, contacts, _, action = act(placed.curve)
    assert contacts.on_surface.all()
    assert scene.frame_current == now  # and the artist's time stays
    # What is felt is what the same path gives on the shape of its start, standing still.
    scene.frame_set(1)
    still = bpy.data.meshes.new_from_object(
        surface.evaluated_get(at_frame(scene, start)), preserve_all_data_layers=True, depsgraph=at_frame(scene, start)
    )
    other = bpy.data.objects.new("Still", still)
    other.matrix_world = surface.evaluated_get(at_frame(scene, start)).matrix_world
    scene.collection.objects.link(other)
    scene.frame_set(now)
    placed.curve.hnf_stroke.surface, placed.curve.parent = other, other
    bpy.context.view_layer.update()
    expected = act(placed.curve)[3]
    assert np.allclose(action.speed, expected.speed, atol=2e-3)  # a plate that is stretched, in the shape of now
    assert np.allclose(action.force, expected.force)


def at_frame(scene, frame):
    scene.frame_set(int(frame), subframe=frame % 1.0)
    return bpy.context.evaluated_depsgraph_get()


def test_without_riding_the_skin_moves_away_from_under_a_stroke():
    surface = lift_by_shape_key()
    placed = place_primitive(bpy.context.scene, surface, None, "default", 1.0)
    assert placed.curve.hnf_stroke.rides
    placed.curve.hnf_stroke.rides = False
    assert act(placed.curve)[1].on_surface.mean() < 0.3
    still = add_plane("Still", size=0.1, z=1.0)
    assert not place_primitive(bpy.context.scene, still, None, "default", 1.0).curve.hnf_stroke.rides


def test_still_modifiers_are_ignored_and_simulations_are_refused():
    plane = add_plane()
    plane.modifiers.new("Wave", "WAVE").height = 0.0
    assert read(add_stroke(LINE)).deforming is None
    plane.modifiers.new("Cloth", "CLOTH")
    with pytest.raises(SceneError, match=r"object 'Plane': it is simulated \(modifier 'Cloth'\)"):
        read(bpy.data.objects["Scrape"])


def test_sphere_keeps_the_speed_of_the_curve():
    add_sphere(radius=0.05)
    angles = np.linspace(-0.6, 0.6, 9)
    obj = add_stroke([(0.05 * np.sin(a), 0.0, 0.05 * np.cos(a)) for a in angles], kind="BEZIER")
    stroke, contacts, _, action = act(obj)
    assert contacts.on_surface.all()
    assert np.allclose(action.speed, np.abs(stroke.samples.velocity), rtol=1e-6)
    assert contacts.uv_known.all()


def hashes(stroke):
    return hash_path(stroke), hash_touch(stroke, stroke.seed)


def test_hash_follows_everything_that_is_felt():
    add_plane()
    obj = add_stroke(LINE)
    first = hashes(read(obj))
    assert hashes(read(obj)) == first
    seen = {first}
    for name, value in (("force", 2.0), ("seed", 3), ("probe", "finger"), ("speed_mm_s", 80.0)):
        setattr(obj.hnf_stroke, name, value)
        seen.add(hashes(read(obj)))
    obj.data.splines[0].points[1].co.y = 0.01
    bpy.context.view_layer.update()
    seen.add(hashes(read(obj)))
    assert len(seen) == 6
