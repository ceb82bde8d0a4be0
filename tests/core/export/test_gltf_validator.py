"""Khronos's own glTF validator over files of this writer, where node and its package are here."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from touched_surfaces import rough_tone, touched_sheet

from hnf_core.export.gltf import write_glb
from hnf_core.export.options import ExportOptions
from hnf_core.export.touched_surface import TouchedSurface

TOOL = Path(__file__).parents[3] / "tools" / "validate_gltf.js"
INSTALL = "npm install --prefix build/node --no-save gltf-validator@2.0.0-dev.3.10"
SURFACES = {
    "whole": touched_sheet(),
    "without a UV map": touched_sheet(uv=False),
    "without a bake": touched_sheet(baked=False),
    "without a way": touched_sheet(path=False),
}


def validated(*paths: Path) -> subprocess.CompletedProcess[str]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not here")
    done = subprocess.run([node, TOOL, *paths], capture_output=True, text=True, timeout=120)
    if "Cannot find module 'gltf-validator'" in done.stderr:
        pytest.skip(f"the package gltf-validator is not here: {INSTALL}")
    return done


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
def test_the_validator_finds_no_error_and_no_warning(tmp_path: Path, surface: TouchedSurface) -> None:
    path = tmp_path / "x.glb"
    write_glb(path, rough_tone(), ExportOptions(surface=surface))
    done = validated(path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "x.glb: 0 errors, 0 warnings" in done.stdout


def test_the_validator_tells_a_broken_file(tmp_path: Path) -> None:
    """Else silence would pass for soundness."""
    path = tmp_path / "x.glb"
    write_glb(path, rough_tone(), ExportOptions(surface=touched_sheet()))
    path.write_bytes(path.read_bytes().replace(b"NORMAL", b"NORMEL"))
    assert validated(path).returncode == 1
