"""Two strokes with one action, as by Alt D: edits of one leave the other unchanged."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane
from stroke_builders import LINE, add_stroke, key, keyed_fcurves, read

pytestmark = pytest.mark.usefixtures("operators")

KEYS = ((1, 1.0), (10, 2.0), (20, 0.5))


def keys_of(stroke):
    force = next(each for each in keyed_fcurves(stroke) if each.data_path == "hnf_stroke.force")
    return [(round(float(x), 3), round(float(y), 4)) for x, y in (point.co for point in force.keyframe_points)]


def select(*objects):
    layer = bpy.context.view_layer
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = objects[-1] if objects else None


@pytest.fixture
def twins():
    """A keyed stroke and its linked duplicate, the first one active."""
    add_plane()
    stroke = add_stroke(LINE, name="A")
    key(stroke, "force", *KEYS)
    select(stroke)
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.view_layer.objects.active
    assert twin.animation_data.action == stroke.animation_data.action
    select(twin, stroke)
    return stroke, twin


@pytest.mark.parametrize("fit_time", [False, True])
def test_copying_the_force_of_a_linked_duplicate_loses_neither(twins, fit_time):
    stroke, twin = twins
    before = read(stroke).samples.force
    assert bpy.ops.hnf.stroke_copy_force(fit_time=fit_time) == {"FINISHED"}
    for each in twins:
        assert keys_of(each) == [(float(frame), value) for frame, value in KEYS]
        assert np.allclose(read(each).samples.force, before, atol=1e-5)
    assert twin.animation_data.action != stroke.animation_data.action


def test_a_later_copy_changes_the_one_that_takes_it_alone(twins):
    stroke, twin = twins
    twin.hnf_stroke.start = 5.0
    assert bpy.ops.hnf.stroke_copy_force(fit_time=False) == {"FINISHED"}
    assert keys_of(twin) == [(frame + 4.0, value) for frame, value in KEYS]
    assert keys_of(stroke) == [(float(frame), value) for frame, value in KEYS]


def test_handles_and_kinds_go_with_the_keys(twins):
    stroke, twin = twins
    curve = next(each for each in keyed_fcurves(stroke) if each.data_path == "hnf_stroke.force")
    curve.keyframe_points[0].interpolation = "LINEAR"
    curve.keyframe_points[1].handle_left_type = curve.keyframe_points[1].handle_right_type = "FREE"
    curve.keyframe_points[1].handle_right = (13.0, 2.5)
    curve.extrapolation = "LINEAR"
    assert bpy.ops.hnf.stroke_copy_force(fit_time=False) == {"FINISHED"}
    taken = next(each for each in keyed_fcurves(twin) if each.data_path == "hnf_stroke.force")
    assert taken.extrapolation == "LINEAR"
    assert [point.interpolation for point in taken.keyframe_points] == ["LINEAR", "BEZIER", "BEZIER"]
    assert tuple(taken.keyframe_points[1].handle_right) == pytest.approx((13.0, 2.5))


def test_moving_a_linked_duplicate_moves_it_alone(twins):
    stroke, twin = twins
    select(stroke, twin)
    assert bpy.ops.hnf.stroke_move(frame=11.0) == {"FINISHED"}
    assert keys_of(twin) == [(frame + 10.0, value) for frame, value in KEYS]
    assert keys_of(stroke) == [(float(frame), value) for frame, value in KEYS]


def test_copying_an_unkeyed_force_leaves_shared_keys_intact(twins):
    stroke, twin = twins
    plain = add_stroke(LINE, name="Plain")
    plain.hnf_stroke.force = 1.25
    select(twin, plain)
    assert bpy.ops.hnf.stroke_copy_force() == {"FINISHED"}
    assert np.allclose(read(twin).samples.force, 1.25)
    assert keys_of(stroke) == [(float(frame), value) for frame, value in KEYS]
