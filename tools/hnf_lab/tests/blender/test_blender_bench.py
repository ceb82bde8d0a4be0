"""The benches that need Blender give their rows. No time is asserted."""

from __future__ import annotations

import json

import bpy
import pytest
from job_scene import my_folders

from hnf_blender.cli import main
from hnf_blender.jobs import manager
from hnf_blender.jobs.bake_process import get_process
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_patches import FIRST_PASS_PIXELS, PATCH_PIXELS
from hnf_lab.bench.harness import BenchOptions
from hnf_lab.blender_bench import bake, waiting_times
from hnf_lab.cli.bench_catalogue import BENCHES


def test_every_bench_has_a_name_of_its_own():
    names = [bench.name for bench in BENCHES]
    assert len(set(names)) == len(names)
    assert {"enable", "responsiveness", "authoring", "preview", "bake"} <= set(names)


def test_switching_the_add_on_on_loads_nothing_heavy():
    numpy, addon = waiting_times.measure_enable(BenchOptions(repeats=1))
    assert (numpy.method, addon.ratio_to) == ("import numpy", "import numpy")
    assert addon.ratio.median == pytest.approx(addon.cpu.median / numpy.cpu.median)
    assert addon.note.endswith("heavy ones: none")
    assert addon.peak_mb > 0.0


def test_a_heavy_package_is_named():
    assert waiting_times.EnableRun(0.1, 0.1, 1.0, ("hnf_blender", "torch.nn", "scipy")).heavy_packages == (
        "scipy",
        "torch",
    )


def test_every_kind_of_call_is_seen_and_nothing_is_left():
    handlers = list(bpy.app.handlers.depsgraph_update_post)
    rows = {row.method: row for row in waiting_times.measure_responsiveness(BenchOptions(repeats=1, quick=True))}
    assert {
        "save a copy", "start", "cancel", "handler", "look at what changed", "tick, child at work", "tick, commit",
        "draw the tab",
    } <= rows.keys()  # fmt: skip
    first, again = rows[waiting_times.FIRST_BAKE], rows[waiting_times.NEXT_BAKE]
    assert (again.ratio_to, again.ratio.count) == (first.method, 1)
    assert get_process() is None
    assert rows["handler"].seconds.count > 1
    assert rows["tick, child at work"].seconds.count > 1
    assert all(row.seconds.lowest > 0.0 for row in rows.values())
    assert list(bpy.app.handlers.depsgraph_update_post) == handlers
    assert not manager.is_running()
    assert my_folders() == []
    assert (STATE.job, STATE.get_statuses(bpy.context.scene), STATE.dirty_names) == (None, {}, set())


def test_a_bake_is_told_with_its_error_in_every_way():
    fine, *ways = bake.measure_bake(BenchOptions(repeats=1, quick=True))
    assert fine.error is None
    rows = {row.method: row for row in ways}
    image = "an image of 0.5 mm texels, "
    pattern = {"cold, 128 pixels", "cold, 256 pixels", "close-ups kept", "nothing changed"}
    assert rows.keys() == pattern | {f"{image}fine", f"{image}256 pixels at once", f"{image}a first look of 32"}
    usual = rows["cold, 256 pixels"]
    assert rows["cold, 128 pixels"].error > usual.error
    assert rows["close-ups kept"].error == rows["nothing changed"].error == usual.error < -10.0
    assert usual.ratio is None
    assert rows["close-ups kept"].ratio_to == rows["nothing changed"].ratio_to == usual.method
    assert rows[f"{image}a first look of 32"].ratio_to == f"{image}256 pixels at once"
    assert rows[f"{image}a first look of 32"].error < -30.0
    assert my_folders() == []


def test_what_is_shipped_is_among_the_sizes():
    assert (bake.FIRST_PASS_PIXELS, bake.DEFAULT_PIXELS) == (FIRST_PASS_PIXELS, PATCH_PIXELS)
    assert bake.DEFAULT_PIXELS in bake.COMPARED_PIXELS


def test_the_command_line_knows_them(capsys):
    assert main(["bench", "enable", "--repeats", "1", "--json"]) == 0
    assert [row["bench"] for row in json.loads(capsys.readouterr().out)] == ["enable", "enable"]


def test_a_stroke_is_drawn_and_placed():
    drawn, placed = waiting_times.measure_authoring(BenchOptions(repeats=2, quick=True))
    assert drawn.seconds.count == placed.seconds.count == 2
    samples, knots = (int(word) for word in drawn.note.replace(" samples →", "").replace(" knots", "").split())
    assert 2 <= knots < samples == 100
    assert placed.method.startswith("place ")
