"""Stroke objects read from Blender data: curves, keys, motion profiles, and refusals."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from builders import add_plane, datablock_names
from stroke_builders import LINE, SPLINES, act, add_stroke, key, keyed_fcurves, read

from hnf_blender.bridge.stroke.animation import read_channel, sample_channels
from hnf_blender.bridge.stroke.read_stroke import list_strokes, read_curve
from hnf_core.action.curves import build_arc_curve
from hnf_core.errors import StrokeError

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
    arc = build_arc_curve(read_curve(obj))
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
    assert [obj.name for obj in list_strokes(bpy.context.scene)] == ["A", "B"]


@pytest.mark.parametrize("interpolation", ["BEZIER", "LINEAR", "CONSTANT", "BOUNCE"])
def test_keys_are_blenders_own_values(interpolation):
    obj = add_stroke(LINE)
    key(obj, "force", (1, 0.0), (7.5, 3.0), (9, 0.5), (40, 2.0))
    for curve_ in keyed_fcurves(obj):
        for point in curve_.keyframe_points:
            point.interpolation = interpolation
    frames = np.arange(-3, 45, 0.17)
    channel = read_channel(obj, "force", bpy.context.scene)
    assert channel.source == "keyed"
    assert channel.last_frame == 40
    (values,) = sample_channels(obj, bpy.context.scene, (channel,), frames)
    expected = [keyed_fcurves(obj)[0].evaluate(frame) for frame in frames]
    away = np.abs(frames[:, None] - [1, 7.5, 9, 40]).min(axis=1) > 1e-3
    assert np.allclose(values[away], np.array(expected)[away], atol=2e-5)


def test_overshooting_handles_match_blender_and_force_is_clamped():
    obj = add_stroke(LINE)
    add_plane()
    key(obj, "force", (1, 0.0), (10, 1.0), (20, 0.0))
    points = keyed_fcurves(obj)[0].keyframe_points
    for point in points:
        point.handle_left_type = point.handle_right_type = "FREE"
    points[0].handle_right = (5, -12.0)
    points[1].handle_left = (-30, -40.0)
    frames = np.arange(1, 20, 0.25)
    (values,) = sample_channels(obj, bpy.context.scene, (read_channel(obj, "force", bpy.context.scene),), frames)
    assert values.min() < -1
    assert np.allclose(values, [keyed_fcurves(obj)[0].evaluate(frame) for frame in frames], atol=1e-4)
    stroke = read(obj)
    assert stroke.samples.force.min() == 0.0
    assert stroke.samples.force.max() == pytest.approx(1.0, abs=1e-3)
    assert stroke.notes == ()
    points[1].co = (10, 70.0)
    stroke = read(obj)
    assert stroke.samples.force.max() == 20.0
    (note,) = stroke.notes
    assert "reaches 70 N and is held at 20 N" in note


def test_extrapolation_and_noise_follow_blender():
    obj = add_stroke(LINE)
    key(obj, "force", (5, 1.0), (10, 2.0))
    fcurve = keyed_fcurves(obj)[0]
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
    for fcurve in keyed_fcurves(obj):
        for point in fcurve.keyframe_points:
            point.interpolation = "LINEAR"
    stroke, _, _, action = act(obj)
    seconds = 1.001 / 30
    assert stroke.motion_profile == "PROGRESS"
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
    assert stroke.motion_profile == "PROGRESS"
    assert "speed timing is not used" in stroke.notes[0]


def test_nan_keyframes_name_stroke_and_frame():
    add_plane()
    obj = add_stroke(LINE)
    key(obj, "force", (1, 1.0), (12.5, 2.0), (20, 1.0))
    keyed_fcurves(obj)[0].keyframe_points[1].co = (12.5, math.nan)
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
    for point in keyed_fcurves(obj)[0].keyframe_points:
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
