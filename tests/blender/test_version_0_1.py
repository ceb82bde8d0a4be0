"""Files that version 0.1.0 wrote (tests/fixtures/version-0.1) are read as it read them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.cli import main
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.stroke_status import Freshness
from hnf_core.export.wav import read_wav

FILES = Path(__file__).resolve().parents[1] / "fixtures" / "version-0.1"


def test_a_run_over_its_results_finds_everything_done(tmp_path):
    shutil.copytree(FILES, tmp_path, dirs_exist_ok=True)
    out = tmp_path / "touched"
    before = (out / "along.wav").read_bytes()
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert [stroke["fresh"] for stroke in report["strokes"]] == [True]
    assert report["counts"]["renders"] == 0
    assert (out / "along.wav").read_bytes() == before


def test_its_cache_serves_a_run_without_its_report(tmp_path):
    shutil.copytree(FILES, tmp_path, dirs_exist_ok=True)
    out = tmp_path / "touched"
    before = read_wav(out / "along.wav")
    (out / "report.json").unlink()
    (out / "along.wav").unlink()
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(out)]) == 0
    assert json.loads((out / "report.json").read_text())["counts"]["close_ups"] == 0
    assert_same_signal(read_wav(out / "along.wav"), before)


def test_a_scene_that_it_baked_is_up_to_date():
    bpy.ops.wm.open_mainfile(filepath=str(FILES / "baked.blend"))
    scene = bpy.context.scene
    refresh_status(scene)
    assert [status.freshness for status in STATE.get_statuses(scene).values()] == [Freshness.FRESH]
    assert read_tokens(bpy.data.objects["Plate"].data) is not None


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--material", str(FILES / "cork.hnf")], "cork-hnf.wav"),
        (["--weights", str(FILES / "cork.safetensors")], "cork-weights.wav"),
    ],
)
def test_its_materials_and_weights_give_its_signals(options, expected, tmp_path):
    out = tmp_path / "x.wav"
    assert main(["synth", *options, "--stroke", "left-right-soft", "--out", str(out)]) == 0
    assert_same_signal(read_wav(out), read_wav(FILES / expected))


def assert_same_signal(signal, expected):
    """Within -80 dB: processors round differently."""
    error = np.sqrt(np.mean((signal.samples - expected.samples) ** 2) / np.mean(expected.samples**2))
    assert error < 1e-4
