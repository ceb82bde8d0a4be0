"""The plan before a bake, the stored results of a bake, and their removal."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from job_scene import NOTHING, PLATE, kept, line_stroke, small_scene
from touch_scene import save_scene

from hnf_blender.bridge.scene.stored_data import count_token_bytes
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.bake_storage import count_stored_bytes


@pytest.fixture(autouse=True)
def lone(warm_bake):
    return warm_bake


def lines(kind: str) -> list[str]:
    return [f"{line.what}: {line.why}" for line in STATE.plan.lines if line.kind == kind]


def plan():
    assert bpy.ops.hnf.plan() == {"FINISHED"}
    return STATE.plan


def size_kept() -> int:
    return sum(count_stored_bytes(obj) for obj in bpy.data.objects) + sum(
        count_token_bytes(mesh) for mesh in bpy.data.meshes
    )


def test_the_plan_says_what_is_needed_fresh_and_left_out() -> None:
    plate, _ = small_scene()
    line_stroke("Quiet", surface=plate, mute=True)
    broken = line_stroke("Broken", surface=add_plane("Hidden", 0.1, z=1.0))
    bpy.data.objects["Hidden"].hide_render = True
    before = plan()
    assert lines("needed") == [f"stroke 'Along' on '{PLATE}': Not baked yet."]
    assert before.seconds > 0.0
    assert lines("skipped") == ["object 'Hidden': hidden", "stroke 'Quiet': muted"]
    (failed,) = lines("failed")
    assert "it is hidden" in failed
    assert kept() == NOTHING
    bpy.data.objects.remove(broken)
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    after = plan()
    assert lines("needed") == []
    assert len(lines("fresh")) == 1
    assert after.seconds == 0.0
    assert after.bytes_after == size_kept()


def test_the_size_is_known_before_it_is_kept() -> None:
    small_scene()
    expected = plan().bytes_after
    bpy.ops.hnf.bake()
    assert expected == pytest.approx(size_kept(), rel=0.3)


def test_a_plan_explains_staleness_and_needs_no_bake_for_force() -> None:
    _, stroke = small_scene()
    bpy.ops.hnf.bake()
    stroke.hnf_stroke.probe = "finger"
    plan()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FORCE
    assert lines("needed") == []
    stroke.location.x += 1e-3
    plan()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.STALE
    (needed,) = lines("needed")
    assert "path" in needed


def test_force_where_nothing_was_touched_is_stale() -> None:
    """The stroke lifts off half way; then it does not, and nobody has looked at what is there."""
    _, stroke = small_scene()
    for fcurve in list(_fcurves(stroke)):
        for key in fcurve.keyframe_points:
            key.co.y = 1.0 if key.co.x < 4.0 else 0.0
        fcurve.update()
    bpy.ops.hnf.bake()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH
    for fcurve in list(_fcurves(stroke)):
        for key in fcurve.keyframe_points:
            key.co.y = 1.0
        fcurve.update()
    plan()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.STALE
    assert "no contact" in STATE.get_statuses(bpy.context.scene)["Along"].why


def test_only_the_active_stroke() -> None:
    plate, along = small_scene()
    line_stroke("Beside", surface=plate, force=2.0)
    bpy.context.view_layer.objects.active = along
    assert bpy.ops.hnf.bake(only_active=True) == {"FINISHED"}
    assert list(kept()["bakes"]) == ["Along"]


def test_a_stroke_that_fails_is_said_and_the_others_are_kept() -> None:
    plate, _ = small_scene()
    line_stroke("In the air", surface=plate, centre=(0.0, 0.0, 1.0))
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    assert not STATE.last_job.ok
    assert STATE.last_job.written == 2
    assert "In the air" in STATE.last_job.message
    assert list(kept()["bakes"]) == ["Along"]


def test_purging_everything_leaves_strokes_and_choices(tmp_path) -> None:
    plate, stroke = small_scene()
    plate.active_material.hnf_touch.library = "oak-wood"
    bpy.ops.hnf.bake()
    size = size_kept()
    assert size > 0
    keys = [tuple(key.co) for fcurve in _fcurves(stroke) for key in fcurve.keyframe_points]
    assert bpy.ops.hnf.purge(what="ALL") == {"FINISHED"}
    assert kept() == NOTHING
    assert size_kept() == 0
    assert not [each.name for each in plate.data.attributes if each.name.startswith("hnf")]
    assert not [
        name for name in (*plate.data.keys(), *stroke.keys()) if name.startswith("hnf_") and name != "hnf_stroke"
    ]
    assert plate.active_material.hnf_touch.library == "oak-wood"
    assert [tuple(key.co) for fcurve in _fcurves(stroke) for key in fcurve.keyframe_points] == keys
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.UNBAKED
    assert bpy.ops.hnf.purge(what="ALL") == {"CANCELLED"}
    save_scene(tmp_path / "purged.blend")


def test_purging_what_is_stale_leaves_what_is_true() -> None:
    plate, _ = small_scene()
    moved = line_stroke("Moved", surface=plate, force=2.0)
    bpy.ops.hnf.bake()
    moved.location.x += 1e-3
    bpy.context.view_layer.update()
    assert bpy.ops.hnf.purge(what="STALE") == {"FINISHED"}
    assert list(kept()["bakes"]) == ["Along"]
    assert list(kept()["tokens"]) == [PLATE]
    plate.data.vertices[0].co.z += 0.01
    plate.data.update()
    bpy.context.view_layer.update()
    assert bpy.ops.hnf.purge(what="STALE") == {"FINISHED"}
    assert kept() == NOTHING


def _fcurves(obj):
    from hnf_blender import compat

    return compat.fcurves_of(obj)
