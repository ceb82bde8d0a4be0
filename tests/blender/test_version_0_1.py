"""Files that version 0.1.0 wrote (tests/fixtures/version-0.1) are read, and what has changed since is told."""

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
from hnf_blender.touch.bake_status import Freshness
from hnf_core.export.wav import read_wav

FILES = Path(__file__).resolve().parents[1] / "fixtures" / "version-0.1"


def test_a_run_over_its_results_makes_them_anew(tmp_path):
    """The library has been fitted to recordings since, and reliefs are read as finely as their source resolves."""
    shutil.copytree(FILES, tmp_path, dirs_exist_ok=True)
    out = tmp_path / "touched"
    before = read_wav(out / "along.wav")
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert [stroke["fresh"] for stroke in report["strokes"]] == [False]
    after = read_wav(out / "along.wav")
    assert (after.sample_rate, len(after.samples)) == (before.sample_rate, len(before.samples))
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert [stroke["fresh"] for stroke in report["strokes"]] == [True]


def test_its_cache_beside_a_run_without_its_report_is_no_harm(tmp_path):
    shutil.copytree(FILES, tmp_path, dirs_exist_ok=True)
    out = tmp_path / "touched"
    (out / "report.json").unlink()
    (out / "along.wav").unlink()
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(out)]) == 0
    assert read_wav(out / "along.wav").rms > 0.0


def test_a_scene_that_it_baked_opens_and_is_out_of_date():
    """Its materials have other constants today; a stroke that feels different now is never told to be up to date."""
    bpy.ops.wm.open_mainfile(filepath=str(FILES / "baked.blend"))
    scene = bpy.context.scene
    refresh_status(scene)
    assert [status.freshness for status in STATE.get_statuses(scene).values()] == [Freshness.STALE]
    assert read_tokens(bpy.data.objects["Plate"].data) is not None


@pytest.mark.parametrize(
    ("options", "expected", "level_db"),
    [
        (["--material", str(FILES / "cork.hnf")], "cork-hnf.wav", 2.0),
        (["--weights", str(FILES / "cork.safetensors")], "cork-weights.wav", 1.0),
    ],
)
def test_its_materials_and_weights_are_felt_as_they_were(options, expected, level_db, tmp_path):
    """The same token, seed and path under today's pen, whose body answers presses too."""
    out = tmp_path / "x.wav"
    assert main(["synth", *options, "--stroke", "left-right-soft", "--out", str(out)]) == 0
    samples, before = read_wav(out).samples, read_wav(FILES / expected).samples
    assert np.corrcoef(samples, before)[0, 1] > 0.9
    assert abs(10.0 * np.log10(np.mean(samples**2) / np.mean(before**2))) < level_db
