"""`hnf bench scale`: its counted work. No time is asserted."""

from __future__ import annotations

import bpy

from hnf_blender.bridge.splat_cloud import TOUCHABLE_SURFACES
from hnf_blender.props.object_cache import STROKES
from hnf_core.progress import count_work
from hnf_lab.bench.harness import BenchOptions, run_sizes
from hnf_lab.blender_bench import scale
from hnf_lab.blender_bench.scenes import (
    add_crowd,
    add_relief_plate,
    add_strokes,
    draw_tab,
    open_empty_file,
    register_tab,
)


def test_others_beside_a_touched_object_cost_no_work(tmp_path):
    alone, own = scale.measure_among_others(BenchOptions(repeats=1, quick=True), tmp_path)
    assert own.work == alone.work == {"renders": 3, "rays": alone.work["rays"], "F_Θ calls": 1}
    assert (own.ratio_to, own.ratio.count) == (alone.method, 1)


def test_work_follows_what_is_touched(tmp_path):
    """Not the faces or the other materials of an object; strokes over one place share its close-up."""
    options = BenchOptions(repeats=1, quick=True)
    lines = {
        line.name: line
        for line in (*scale.make_face_sweeps(options, tmp_path), *scale.make_touch_sweeps(options, tmp_path))
    }
    work = {name: run_sizes("scale", line, options)[-1].work for name, line in lines.items()}
    close_up = work["of the touched object"]
    assert (close_up["renders"], close_up["F_Θ calls"]) == (2, 1)  # a small view chooses the sampling
    assert work["on the touched object"] == close_up
    apart, shared = work["over places of their own"], work["over one place"]
    assert (apart["renders"], apart["F_Θ calls"], apart["rays"]) == (4, 2, 2 * close_up["rays"])
    assert (shared["renders"], shared["F_Θ calls"]) == (2, 2)
    assert shared["rays"] < 1.01 * close_up["rays"]


def looks_of_a_redraw(others: int) -> int:
    """Objects that are looked at while the tab is drawn a second time."""
    open_empty_file()
    add_strokes(2, add_relief_plate(8), apart=False, length_m=0.01)
    add_crowd(others, own_meshes=False)
    scene, layer = bpy.context.scene, bpy.context.view_layer
    layer.update()
    with register_tab():
        with count_work() as work:
            assert draw_tab(scene, layer) > 10
        assert work.total("objects") >= 2 * len(scene.objects)
        with count_work() as work:
            draw_tab(scene, layer)
        with count_work() as alone:  # who looks at two objects and finds two strokes has looked at them alone
            assert [obj.name for obj in STROKES.list_objects(scene)] == ["Stroke 0", "Stroke 1"]
            assert TOUCHABLE_SURFACES.list_objects(scene) == []
    assert alone.amounts["objects"] == [2, 0]
    assert set(work.amounts["objects"]) == {2, 0}
    return work.total("objects")


def test_a_redraw_looks_at_strokes_alone():
    assert looks_of_a_redraw(1) == looks_of_a_redraw(40)


def test_the_cost_of_a_redraw_is_a_line_of_its_own():
    options = BenchOptions(repeats=1, quick=True)
    for line in scale.make_panel_sweeps(options):
        (row,) = run_sizes("scale", line, options)
        assert row.seconds.median > 0.0, row
