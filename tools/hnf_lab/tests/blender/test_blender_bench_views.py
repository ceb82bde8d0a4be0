"""The bench of views: its rows, and comparison of times at equal error. No time is asserted."""

from __future__ import annotations

import numpy as np
import pytest

from hnf_blender.bridge.cycles import make_overview_camera
from hnf_core.scene.raycast import cast_view, make_embree_caster
from hnf_lab.bench.harness import BenchOptions, run_with_peak
from hnf_lab.blender_bench import views
from hnf_lab.blender_bench import views as views_scene
from hnf_lab.blender_bench.views import (
    AT_EQUAL_ERROR,
    Rectangle,
    TimedRenders,
    compute_ratio_at_equal_error,
    expand_rectangle,
    find_patch,
)


def timed(error, *cpus):
    return TimedRenders(walls=list(cpus), cpus=list(cpus), error=error, patch_error=error)


def compared(mine, theirs):
    return compute_ratio_at_equal_error(mine, dict(enumerate(theirs)), lambda one: one.error)


def test_time_is_compared_where_the_errors_are_equal():
    theirs = [timed(0.1, 1.0, 2.0), timed(0.001, 100.0, 200.0)]
    assert compared(timed(0.1, 1.0, 1.0), theirs).lowest == pytest.approx(0.5)
    between = compared(timed(0.01, 1.0, 1.0), theirs)  # halfway along a straight line of logarithms: 10 s and 20 s
    assert (between.highest, between.lowest, between.count) == (pytest.approx(0.1), pytest.approx(0.05), 2)


def test_equal_error_uses_the_slowest_time_or_none():
    theirs = [timed(0.01, 4.0), timed(0.1, 1.0)]
    assert compared(timed(0.002, 1.0), theirs).median == pytest.approx(0.25)
    assert compared(timed(0.0, 1.0), theirs).median == pytest.approx(0.25)
    assert compared(timed(0.2, 1.0), theirs) is None


def test_a_patch_lies_on_the_surface_with_a_margin_in_the_image():
    camera = make_overview_camera([[0, 0, 0]], [0, -1, 0], 0.1, 64, 48)
    depth = np.full((48, 64), np.inf, dtype=np.float32)
    depth[2, 50] = 0.1
    patch = find_patch(camera, depth)
    side = round(0.02 * camera.intrinsics[0, 0] / 0.1)
    left, top = 50 - side // 2, max(0, 2 - side // 2)
    assert 4 < side < 48
    assert patch == Rectangle(left, top, min(side, 64 - left), min(side, 48 - top))
    assert np.isfinite(patch.crop(depth)).any()
    around = expand_rectangle(patch, camera)
    assert (around.top, around.left) == (0, max(0, patch.left - 8))
    assert around.left + around.width == min(64, patch.left + patch.width + 8)


def test_the_world_mesh_is_every_solid_where_it_stands():
    scene = views_scene.make_three_balls()
    mesh = views_scene.make_world_mesh(scene)
    assert len(mesh.triangles) == 2 + 3 * (2 * 24 + 10 * 24 * 2)
    camera = views_scene.place_cameras(scene, 1, 64, 48)[0]
    depth = cast_view(make_embree_caster(mesh), mesh, camera).depth
    middle, _ = camera.project([[0.0, 0.0, 0.06]])
    top = depth[int(middle[0, 1]), int(middle[0, 0])]
    assert top == pytest.approx(float(camera.project([[0.0, 0.0, 0.06]])[1][0]), rel=0.05)


def test_both_ways_show_the_same_picture_and_every_row_comes():
    rows = {row.method: row for row in views.measure_views(BenchOptions(repeats=1, quick=True))}
    assert set(rows) == {
        "BlenderProc's way, 1", "BlenderProc's way, 4", "the same without its denoiser, 4", "ours, 1", "ours, 4",
        "touched patches only, 4", "depth: BlenderProc's way, 1", "depth: Cycles without light", "depth: rays",
        "look, 1", "look, 4",
    }  # fmt: skip
    colour = [row for method, row in rows.items() if row.error_unit.startswith("of sRGB")]
    assert len(colour) == 6
    assert all(0.0 < row.error < 0.08 for row in colour)  # another camera or light is off by 0.2 and more
    if run_with_peak(list)[1] is not None:  # the system tells
        assert all(row.peak_mb is not None for row in colour)
    assert rows["ours, 4"].error < rows["ours, 1"].error
    assert rows["BlenderProc's way, 4"].error < rows["BlenderProc's way, 1"].error
    assert all((row.ratio is None) == (row.ratio_to == "") for row in colour)
    assert rows["ours, 4"].ratio_to in {AT_EQUAL_ERROR, ""}
    assert rows["depth: rays"].error < 1e-6
    assert rows["depth: Cycles without light"].error < 1e-3
    assert rows["depth: BlenderProc's way, 1"].error < 1e-3
    assert rows["look, 4"].error < rows["look, 1"].error < 0.5  # dB: one sample at the pixel's centre is enough
    assert all("three balls" in row.note for method, row in rows.items() if not method.startswith("look"))
