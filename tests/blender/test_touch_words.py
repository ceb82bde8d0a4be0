"""--stroke in words, through the whole job: the same signal as the fixed name, and the force and speed said."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest
from touch_scene import PLATE, ridge_plate, save_scene, signals, touch

from hnf_blender.bridge.stroke.read_stroke import read_stroke
from hnf_blender.cli import main
from hnf_core.action.action import read_action_csv
from hnf_core.action.parse_stroke import FORCE_LIMITS_N
from hnf_core.export.wav import read_wav


def test_words_give_what_the_fixed_name_gives(tmp_path) -> None:
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    words = ("--stroke", "left-right-hard", "--on", PLATE, "--stroke", "scrape left to right, hard", "--on", PLATE)
    code, report = touch(scene, out, *words)
    assert code == 0
    fixed, said = report["strokes"]
    assert [fixed["name"], said["name"]] == [f"left-right-hard on {PLATE}", f"left-right-hard on {PLATE} 2"]
    first, second = (read_wav(out / entry["wav"]).samples for entry in (fixed, said))
    np.testing.assert_array_equal(first, second)
    assert np.abs(first).max() > 0.1


def test_direction_force_and_speed_are_those_said(tmp_path) -> None:
    """2 mm ridges under 80 mm/s give 40 Hz; the stroke in the baked file runs from right to left with 1.5 N."""
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    words = ("--stroke", "scrape right to left, 1.5 N, 80 mm/s", "--on", PLATE)
    code, report = touch(scene, out, *words)
    assert code == 0
    (entry,) = report["strokes"]
    assert entry["name"] == f"right-left-1.5n-80mm-s on {PLATE}"
    for file in (entry["wav"], entry["picture"]):
        assert (out / file).is_file()
        assert set(file) <= set("abcdefghijklmnopqrstuvwxyz0123456789-.")
    signal = signals(out, report)[entry["name"]]
    middle = signal.samples[2000:6000] * np.hanning(4000)
    power, frequency = np.abs(np.fft.rfft(middle, 1 << 16)) ** 2, np.fft.rfftfreq(1 << 16, 1e-4)
    low = (frequency > 20) & (frequency < 75)
    assert frequency[low][power[low].argmax()] == pytest.approx(40.0, rel=0.02)
    bpy.ops.wm.open_mainfile(filepath=str(out / report["baked_blend"]))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    stroke = read_stroke(bpy.data.objects[entry["name"]], bpy.context.scene, depsgraph, 1.0)
    assert stroke.length_m == pytest.approx(0.06, rel=0.01)
    assert stroke.samples.force.max() == pytest.approx(1.5, rel=1e-5)
    assert np.abs(stroke.samples.velocity).max() == pytest.approx(0.08, rel=0.01)
    np.testing.assert_allclose(stroke.samples.tangent, np.tile([-1.0, 0.0, 0.0], (len(stroke.frames), 1)), atol=1e-3)
    code, again = touch(scene, out, *words)
    assert (code, again["strokes"][0]["fresh"]) == (0, True)


def test_taps_and_steps_go_through_the_whole_job(tmp_path) -> None:
    """Two taps are two bursts with silence between them; the table of the touch says the same."""
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    code, report = touch(scene, out, "--stroke", "tap twice hard, then slide slowly to the left", "--on", PLATE)
    assert code == 0
    (entry,) = report["strokes"]
    assert entry["name"] == f"tap-2-times-2n-then-line-right-left-etc on {PLATE}"
    samples = signals(out, report)[entry["name"]].samples
    rms = [float(np.sqrt(np.mean(samples[round(1e4 * a) : round(1e4 * b)] ** 2))) for a, b in
           ((0.04, 0.14), (0.35, 0.5), (0.54, 0.64), (0.85, 0.95), (1.3, 2.3))]  # fmt: skip
    assert min(rms[0], rms[2], rms[4]) > 10.0 * max(rms[1], rms[3])
    table = tmp_path / "said.csv"
    words = ["export", str(out / entry["wav"]), "--format", "action", "--out", str(table)]
    assert main([*words, "--scene", str(out / report["baked_blend"])]) == 0
    action = read_action_csv(table)
    assert np.sum(np.diff(action.contact.astype(int)) == 1) == 3
    assert action.force.max() == pytest.approx(2.0, rel=1e-4)
    assert action.speed.max() == pytest.approx(0.04, rel=1e-2)


def test_out_of_range_is_in_the_report_and_stays_there(tmp_path) -> None:
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    words = ("--stroke", "scrape, 1 N", "--on", PLATE, "--stroke", "scrape, 20 N", "--on", PLATE)
    code, report = touch(scene, out, *words)
    assert code == 0
    inside, outside = report["strokes"]
    assert not any("Force" in text for text in inside["warnings"])
    (said,) = (text for text in outside["warnings"] if text.startswith("Force reaches 20 N, trained on"))
    assert outside["confidence"] < 0.5 * inside["confidence"]
    assert f"stroke '{outside['name']}': {said}" in report["warnings"]
    _, again = touch(scene, out, *words)
    assert [stroke["fresh"] for stroke in again["strokes"]] == [True, True]
    assert f"stroke '{outside['name']}': {said}" in again["warnings"]
    assert json.loads((out / "report.json").read_text())["strokes"][1]["warnings"] == outside["warnings"]


def test_every_force_that_words_may_name_is_one_a_stroke_holds() -> None:
    """Blender clamps a property to its limits without a word; words beyond them must be refused instead."""
    curve = bpy.data.objects.new("Any", bpy.data.curves.new("Any", "CURVE"))
    for force in FORCE_LIMITS_N:
        curve.hnf_stroke.force = force
        assert curve.hnf_stroke.force == pytest.approx(force)


def test_refused_words_are_named_before_any_work(tmp_path, capsys) -> None:
    ridge_plate()
    code, report = touch(save_scene(tmp_path / "s.blend"), tmp_path / "out", "--stroke", "scrap it", "--on", PLATE)
    assert (code, report) == (2, {})
    assert "the word 'scrap' is unknown" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
