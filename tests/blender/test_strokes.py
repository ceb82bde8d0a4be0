"""Stroke objects read from real Blender data: curves, keys, laws, motion, refusals."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere, datablock_names

from hnf_blender.bridge.channels import read_channel, sample_channels
from hnf_blender.bridge.meshes import surface_mesh
from hnf_blender.bridge.splines import read_curve
from hnf_blender.bridge.strokes import read_stroke, stroke_hash, stroke_objects
from hnf_core.action.contacts import find_contacts
from hnf_core.action.curves import by_arc_length
from hnf_core.action.patches import action_from_contacts, plan_patches
from hnf_core.errors import SceneError, StrokeError


def add_stroke(points, *, name="Scrape", kind="POLY", cyclic=False, handles=None, **settings):
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new(kind)
    spline.use_cyclic_u = cyclic
    if kind == "BEZIER":
        spline.bezier_points.add(len(points) - 1)
        for k, (point, knot) in enumerate(zip(spline.bezier_points, points, strict=True)):
            point.handle_left_type = point.handle_right_type = "AUTO" if handles is None else "FREE"
            point.co = knot
            if handles is not None:
                point.handle_left, point.handle_right = handles[k]
    else:
        spline.points.add(len(points) - 1)
        for point, knot in zip(spline.points, points, strict=True):
            point.co = (*knot, 1.0) if len(knot) == 3 else knot
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    obj.hnf_stroke.is_stroke = True
    for key, value in settings.items():
        setattr(obj.hnf_stroke, key, value)
    bpy.context.view_layer.update()
    return obj


def read(obj, metres_per_unit=1.0):
    return read_stroke(obj, bpy.context.scene, bpy.context.evaluated_depsgraph_get(), metres_per_unit)


def act(obj, metres_per_unit=1.0):
    stroke = read(obj, metres_per_unit)
    touched = bpy.data.objects[stroke.object_name]
    mesh = surface_mesh(touched, bpy.context.evaluated_depsgraph_get(), metres_per_unit).mesh
    contacts = find_contacts(stroke.samples, stroke.surface(mesh))
    patches, index = plan_patches(contacts)
    return stroke, contacts, patches, action_from_contacts(contacts, patches, index, stroke.probe)


def key(obj, name, *keys):
    for frame, value in keys:
        setattr(obj.hnf_stroke, name, value)
        obj.keyframe_insert(f"hnf_stroke.{name}", frame=frame)


LINE = [(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)]
SPLINES = [(0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.3, 0.1, 0.1), (0.4, 0.4, 0.2), (0.2, 0.5, 0.1), (0.0, 0.3, 0.0)]


# Curves


def tessellated(obj):
    """Blender's own evaluation of the curve."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = np.array([tuple(vertex.co) for vertex in mesh.vertices])
    evaluated.to_mesh_clear()
    return points


def assert_same_curve(obj, resolution, cut=2e-5):
    """Every point of Blender's tessellation lies on our curve, in order, and the lengths agree as its chords do."""
    obj.data.resolution_u = resolution
    obj.data.splines[0].resolution_u = resolution
    bpy.context.view_layer.update()
    points = tessellated(obj)
    arc = by_arc_length(read_curve(obj))
    if obj.data.splines[0].use_cyclic_u:
        points = np.concatenate([points, points[:1]])
    ours = arc.point_at(np.linspace(0, arc.length, 5001))
    nearest = [np.linalg.norm(ours - point, axis=1) for point in points[:: max(1, len(points) // 60)]]
    assert max(distance.min() for distance in nearest) < 0.6 * arc.length / 5000 + 1e-6
    order = [int(distance.argmin()) for distance in nearest][1:-1]
    assert order == sorted(order)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert arc.length * (1 - cut) <= chords <= arc.length * (1 + 1e-6)


def test_bezier_is_blenders():
    assert_same_curve(add_stroke(SPLINES, kind="BEZIER"), 256)
    assert_same_curve(add_stroke(SPLINES, kind="BEZIER", cyclic=True), 256)
    free = [((x - 0.1, y, z + 0.05), (x + 0.02, y + 0.3, z)) for x, y, z in SPLINES]
    assert_same_curve(add_stroke(SPLINES, kind="BEZIER", handles=free), 256)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("cyclic", [False, True])
def test_nurbs_is_blenders(order, cyclic):
    for endpoint in (False, True):
        for bezier in (False, True):
            points = [(*point, 1.0 + 0.7 * (k % 3)) for k, point in enumerate(SPLINES)]
            obj = add_stroke(points, kind="NURBS", cyclic=cyclic)
            spline = obj.data.splines[0]
            spline.order_u, spline.use_endpoint_u, spline.use_bezier_u = order, endpoint, bezier
            # Blender 4.x steps across knots, where these low orders bend.
            assert_same_curve(obj, 256, cut=2e-3 if order < 4 else 2e-5)
            bpy.data.objects.remove(obj)


def test_poly_is_blenders():
    assert_same_curve(add_stroke(SPLINES), 1)
    assert_same_curve(add_stroke(SPLINES, cyclic=True), 1)


def test_curves_that_cannot_be_strokes_are_refused_by_name():
    obj = add_stroke(LINE)
    obj.data.splines.new("POLY").points.add(1)
    with pytest.raises(StrokeError, match="stroke 'Scrape': the curve has 2 splines"):
        read_curve(obj)
    obj = add_stroke(LINE, name="Bent")
    obj.modifiers.new("Hook", "HOOK")
    with pytest.raises(StrokeError, match=r"stroke 'Bent': its modifier 'Hook' moves the drawn points\. Apply"):
        read_curve(obj)
    obj = add_stroke(LINE, name="Broken")
    obj.data.splines[0].points[0].co = (math.nan, 0, 0, 1)
    with pytest.raises(StrokeError, match="stroke 'Broken': the curve's points are not all finite"):
        read_curve(obj)
    obj = add_stroke(LINE, name="Keyed")
    obj.shape_key_add()
    with pytest.raises(StrokeError, match="stroke 'Keyed': its curve has shape keys"):
        read_curve(obj)
    obj = add_stroke(LINE, name="Drifting")
    obj.data.splines[0].points[0].keyframe_insert("co", frame=1)
    with pytest.raises(StrokeError, match="stroke 'Drifting': its curve points are keyframed"):
        read_curve(obj)
    with pytest.raises(StrokeError, match="stroke 'Plane': it is a mesh object"):
        read_curve(add_plane())


# Keys and laws


def test_only_unmuted_strokes_of_the_scene():
    add_stroke(LINE, name="B")
    add_stroke(LINE, name="A")
    add_stroke(LINE, name="C", mute=True)
    add_stroke(LINE, name="D", is_stroke=False)
    assert [obj.name for obj in stroke_objects(bpy.context.scene)] == ["A", "B"]


@pytest.mark.parametrize("interpolation", ["BEZIER", "LINEAR", "CONSTANT", "BOUNCE"])
def test_keys_are_blenders_own_values(interpolation):
    obj = add_stroke(LINE)
    key(obj, "force", (1, 0.0), (7.5, 3.0), (9, 0.5), (40, 2.0))
    for curve_ in _fcurves(obj):
        for point in curve_.keyframe_points:
            point.interpolation = interpolation
    frames = np.arange(-3, 45, 0.17)
    channel = read_channel(obj, "force", bpy.context.scene)
    assert channel.source == "keyed"
    assert channel.last_frame == 40
    (values,) = sample_channels(obj, bpy.context.scene, (channel,), frames)
    expected = [_fcurves(obj)[0].evaluate(frame) for frame in frames]
    away = np.abs(frames[:, None] - [1, 7.5, 9, 40]).min(axis=1) > 1e-3
    assert np.allclose(values[away], np.array(expected)[away], atol=2e-5)


def _fcurves(obj):
    from hnf_blender import compat

    return compat.fcurves_of(obj)


def test_handles_that_overshoot_are_blenders_and_clamped_at_the_end():
    obj = add_stroke(LINE)
    add_plane()
    key(obj, "force", (1, 0.0), (10, 1.0), (20, 0.0))
    points = _fcurves(obj)[0].keyframe_points
    for point in points:
        point.handle_left_type = point.handle_right_type = "FREE"
    points[0].handle_right = (5, -12.0)
    points[1].handle_left = (-30, -40.0)
    frames = np.arange(1, 20, 0.25)
    (values,) = sample_channels(obj, bpy.context.scene, (read_channel(obj, "force", bpy.context.scene),), frames)
    assert values.min() < -1
    assert np.allclose(values, [_fcurves(obj)[0].evaluate(frame) for frame in frames], atol=1e-4)
    stroke = read(obj)
    assert stroke.samples.force.min() == 0.0
    assert stroke.samples.force.max() == pytest.approx(1.0, abs=1e-3)
    points[1].co = (10, 70.0)
    assert read(obj).samples.force.max() == 20.0


def test_extrapolation_and_noise_follow_blender():
    obj = add_stroke(LINE)
    key(obj, "force", (5, 1.0), (10, 2.0))
    fcurve = _fcurves(obj)[0]
    fcurve.extrapolation = "LINEAR"
    noise = fcurve.modifiers.new("NOISE")
    noise.strength = 0.3
    frames = np.arange(0, 20, 0.5)
    (values,) = sample_channels(obj, bpy.context.scene, (read_channel(obj, "force", bpy.context.scene),), frames)
    assert np.allclose(values, [fcurve.evaluate(frame) for frame in frames], atol=1e-6)


def test_progress_keys_between_frames_drive_the_hand():
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = 30, 1.001
    add_plane()
    obj = add_stroke(LINE, start=10.5)
    key(obj, "progress", (10.5, 0.0), (25.25, 1.0), (40.0, 0.2))
    for fcurve in _fcurves(obj):
        for point in fcurve.keyframe_points:
            point.interpolation = "LINEAR"
    stroke, _, _, action = act(obj)
    seconds = 1.001 / 30
    assert stroke.law == "PROGRESS"
    assert stroke.samples.time[-1] == pytest.approx(29.5 * seconds, abs=0.005)
    turn = 14.75 * seconds
    expected = np.interp(stroke.samples.time, [0, turn, 2 * turn], [0, 0.06, 0.012])
    assert np.allclose(stroke.samples.position, expected, atol=1e-9)
    forward = stroke.samples.time < turn - 0.01
    assert np.allclose(action.speed[forward], 0.06 / turn, rtol=1e-6)
    assert np.allclose(action.direction[forward], [1, 0])
    backward = (stroke.samples.time > turn + 0.01) & (stroke.samples.time < 2 * turn - 0.01)
    assert np.allclose(action.direction[backward], [-1, 0])
    assert np.allclose(stroke.frames, 10.5 + stroke.samples.time / seconds)


def test_speed_and_duration_laws():
    add_plane()
    obj = add_stroke(LINE, law="SPEED", speed_mm_s=50.0, force=0.7)
    _, _, _, action = act(obj)
    assert action.speed.max() == pytest.approx(0.05, rel=1e-6)
    assert action.duration_s == pytest.approx(0.06 / 0.05 + 0.1, abs=0.005)
    assert np.allclose(action.force, 0.7)
    obj.hnf_stroke.law, obj.hnf_stroke.duration_s = "DURATION", 2.0
    _, _, _, action = act(obj)
    assert action.duration_s == pytest.approx(2.0, abs=0.005)
    assert action.position[-1] == pytest.approx(0.06, rel=1e-6)
    obj.hnf_stroke.law = "PROGRESS"
    with pytest.raises(StrokeError, match=r"stroke 'Scrape': its progress has no keyframes\. Key progress"):
        read(obj)
    key(obj, "progress", (1, 0.0), (25, 1.0))
    obj.hnf_stroke.law = "SPEED"
    stroke = read(obj)
    assert stroke.law == "PROGRESS"
    assert "speed law is not used" in stroke.notes[0]


def test_nan_keyframes_name_stroke_and_frame():
    add_plane()
    obj = add_stroke(LINE)
    key(obj, "force", (1, 1.0), (12.5, 2.0), (20, 1.0))
    _fcurves(obj)[0].keyframe_points[1].co = (12.5, math.nan)
    with pytest.raises(StrokeError, match=r"stroke 'Scrape': the force keyframe at frame 12\.5 is not a number"):
        read(obj)


def test_drivers_are_evaluated():
    scene = bpy.context.scene
    add_plane()
    obj = add_stroke(LINE, law="DURATION", duration_s=1.0)
    obj.driver_add("hnf_stroke.force").driver.expression = "frame / 10"
    scene.frame_set(7)
    names = datablock_names()
    obj.location.y = 0.001
    stroke = read(obj)
    assert stroke.samples.time[-1] == pytest.approx(1.0)
    assert np.allclose(stroke.samples.force, stroke.frames / 10, atol=1e-4)
    assert scene.frame_current == 7
    assert obj.hnf_stroke.force == pytest.approx(0.7)
    assert obj.location.y == pytest.approx(0.001)
    assert datablock_names() == names


def test_drivers_that_look_at_the_scene_are_refused():
    add_plane()
    obj = add_stroke(LINE)
    driver = obj.driver_add("hnf_stroke.force").driver
    variable = driver.variables.new()
    variable.targets[0].id_type, variable.targets[0].id = "SCENE", bpy.context.scene
    variable.targets[0].data_path = "frame_current"
    driver.expression = variable.name
    with pytest.raises(StrokeError, match="stroke 'Scrape': the driver of its force reads the scene"):
        read(obj)


def test_nla_is_evaluated():
    add_plane()
    obj = add_stroke(LINE)
    key(obj, "force", (1, 0.0), (11, 5.0))
    action = obj.animation_data.action
    for point in _fcurves(obj)[0].keyframe_points:
        point.interpolation = "LINEAR"
    track = obj.animation_data.nla_tracks.new()
    strip = track.strips.new("lift", 1, action)
    slot = getattr(obj.animation_data, "action_slot", None)
    if slot is not None:
        strip.action_slot = slot
    obj.animation_data.action = None
    strip.scale = 2.0
    channel = read_channel(obj, "force", bpy.context.scene)
    assert channel.source == "driven"
    assert channel.last_frame == pytest.approx(21)
    (values,) = sample_channels(obj, bpy.context.scene, (channel,), np.array([1.0, 6.0, 11.5, 21.0]))
    assert np.allclose(values, [0.0, 1.25, 2.625, 5.0], atol=1e-4)


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
    with pytest.raises(SceneError, match="object 'Far': it is not in this scene"):
        read(obj)


def test_no_mesh_at_all():
    with pytest.raises(StrokeError, match="stroke 'Scrape': there is no visible mesh"):
        read(add_stroke(LINE))


def linear(obj):
    for fcurve in _fcurves(obj):
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


def test_hand_and_surface_under_one_moving_parent_are_at_rest_together():
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


def test_still_modifiers_cost_nothing_and_simulations_are_refused():
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


def test_hash_follows_everything_that_is_felt():
    add_plane()
    obj = add_stroke(LINE)
    first = stroke_hash(read(obj))
    assert stroke_hash(read(obj)) == first
    seen = {first}
    for name, value in (("force", 2.0), ("seed", 3), ("probe", "finger"), ("speed_mm_s", 80.0), ("material", "oak")):
        setattr(obj.hnf_stroke, name, value)
        seen.add(stroke_hash(read(obj)))
    obj.data.splines[0].points[1].co.y = 0.01
    bpy.context.view_layer.update()
    seen.add(stroke_hash(read(obj)))
    assert len(seen) == 7
