"""examples/touch_scene.py, run as a user would: one WAV for a stroke, and a line that names its material."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "tests" / "fixtures" / "version-0.1" / "scene.blend"


def test_the_example_touches_a_scene(tmp_path):
    shutil.copy(SCENE, tmp_path)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "touch_scene.py"), "scene.blend", "touched"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=250,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "m/s² RMS" in done.stdout.splitlines()[-1]
    assert len(list((tmp_path / "touched").glob("*.wav"))) == 1
