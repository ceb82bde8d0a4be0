"""The estimate of a bake's time: what it counts, and what costs nothing. No time is asserted."""

from __future__ import annotations

import json

import pytest
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene

from hnf_blender.cli import main
from hnf_blender.touch import bake_cost
from hnf_blender.touch.bake_cost import FIGURE_SECONDS, FIRST_FIGURE_SECONDS, NO_WORK, VIEW_SECONDS, Work


def read_plan(capsys, *words):
    capsys.readouterr()
    assert main(["touch", *words, "--plan", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_rendering_is_shared_by_cores_and_the_rest_is_not(monkeypatch):
    work = Work(2.0, 1.0) + Work(1.0, 0.5)
    for cores, rendering_s in ((1, 3.0), (2, 3.0 * 0.7), (6, 3.0 * 0.5)):
        monkeypatch.setattr(bake_cost, "available_cpus", lambda cores=cores: cores)
        assert work.estimate_seconds(2.0) == pytest.approx(2.0 * (rendering_s + 1.5))


def test_pictures_cost_their_views_and_figures():
    assert bake_cost.estimate_pictures(0, 0, is_lit=True) == NO_WORK
    drawing = bake_cost.estimate_pictures(3, 1, is_lit=False)
    assert drawing == Work(VIEW_SECONDS, 3 * FIGURE_SECONDS + FIRST_FIGURE_SECONDS)
    assert bake_cost.estimate_pictures(3, 1, is_lit=True).rendering_s > drawing.rendering_s


def test_a_computation_here_takes_some_time():
    assert bake_cost.measure_slowness() == bake_cost.measure_slowness() > 0.0


def test_shared_cached_and_fresh_places_are_not_counted_again(tmp_path, capsys):
    ridge_plate()
    line_stroke("Along")
    line_stroke("Again")
    scene, out = str(save_scene(tmp_path / "scene.blend")), tmp_path / "out"
    cold = read_plan(capsys, scene, "--out", str(out), "--no-pictures")
    first, second = (entry["work"] for entry in cold["needed"])
    assert first["rendering_s"] > 0.0
    assert second == {"rendering_s": 0.0, "single_s": bake_cost.SYNTHESIS_SECONDS}
    started = sum(sum(entry["work"].values()) for entry in cold["needed"]) + bake_cost.START_SECONDS
    assert cold["estimate"]["processor_seconds"] == pytest.approx(cold["slowness"] * started, abs=0.051)
    assert cold["views"] == 1  # both strokes lie in one
    assert main(["touch", scene, "--out", str(out), "--no-pictures"]) == 0
    fresh = read_plan(capsys, scene, "--out", str(out), "--no-pictures")
    assert (fresh["needed"], fresh["estimate"]["seconds"]) == ([], 0.0)
    cached = read_plan(capsys, scene, "--out", str(out), "--no-pictures", "--seed", "5")
    assert [entry["work"] for entry in cached["needed"]] == [second, second]
    placed = read_plan(capsys, scene, "--out", str(out), "--stroke", "left-right-soft", "--on", PLATE, "--no-pictures")
    (entry,) = (each for each in placed["needed"] if "left-right" in each["stroke"])
    assert entry["work"]["single_s"] == bake_cost.SYNTHESIS_SECONDS + bake_cost.PLACEMENT_SECONDS
