"""The predicted route in a background job: equal bytes in line and in the child, and its entry in the plan."""

from __future__ import annotations

import shutil

import bpy
import pytest
from job_scene import NOTHING, bake, kept
from predicted_scene import PHOTO_PLATE, photo_plate, small_weights, use_weights
from touch_scene import line_stroke

from hnf_blender.jobs.baked_data import make_plan
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_cost import PREDICTION_SECONDS, Work, measure_slowness
from hnf_core.tactile.unet import DEFAULT_WEIGHTS

pytestmark = pytest.mark.usefixtures("lone_bake")


@pytest.mark.skipif(not DEFAULT_WEIGHTS.is_file(), reason="a child process reads the weights that are shipped")
def test_the_child_and_its_twin_in_line_give_equal_bytes(lone_bake) -> None:
    plate = photo_plate()
    line_stroke("Along", surface=plate)
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    in_line = kept()
    assert list(in_line["bakes"]) == ["Along"]
    assert "prior" in STATE.get_statuses(bpy.context.scene)["Along"].routes
    assert bpy.ops.hnf.purge(what="ALL") == {"FINISHED"}
    assert kept() == NOTHING
    shutil.rmtree(lone_bake)
    ended = bake()
    assert ended.ok, ended
    assert kept() == in_line


def test_the_plan_lists_predicted_surfaces_and_their_time(tmp_path, monkeypatch) -> None:
    plate = photo_plate()
    line_stroke("Along", surface=plate)
    scene, layer = bpy.context.scene, bpy.context.view_layer
    use_weights(monkeypatch, tmp_path / "gone.safetensors")
    without = make_plan(scene, layer)
    use_weights(monkeypatch, small_weights(tmp_path / "small.safetensors"))
    plan = make_plan(scene, layer)
    said = f"material '{PHOTO_PLATE}': no relief in its shader; one is estimated from its picture."
    assert said in [line.what for line in plan.lines if line.kind == "note"]
    assert said not in [line.what for line in without.lines]
    seconds = Work(rendering_s=2 * PREDICTION_SECONDS).estimate_seconds(measure_slowness())
    assert plan.seconds == pytest.approx(without.seconds + seconds)
    bpy.data.objects["Along"].hnf_stroke.material = "oak-wood"
    assert said not in [line.what for line in make_plan(scene, layer).lines]
