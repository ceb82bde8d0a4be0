"""A photograph is touched in Blender with and without its name, as `hnf touch` would."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.material.library import get_material, load_library
from hnf_core.tactile.unet import DIFFUSION, REGRESSION
from hnf_lab.evaluation.photographs.measure import touch_photograph
from hnf_lab.evaluation.tactile_map.end_to_end import compare_networks


def write_photograph(path: Path) -> Path:
    image = pytest.importorskip("matplotlib.image")
    grain = np.random.default_rng(0).random((256, 256, 1))
    image.imsave(path, np.clip(0.3 + 0.3 * grain * np.array([0.4, 0.5, 1.0]), 0.0, 1.0))
    return path


def test_a_name_decides_and_without_one_it_could_be_many_things(tmp_path: Path) -> None:
    (named, sure), (nameless, unsure) = touch_photograph("Denim", write_photograph(tmp_path / "x.png"), tmp_path)
    assert (named, nameless) == (True, False)
    assert sure.main_material.library is get_material("denim")
    assert sure.main_material.likely == ()
    felt = unsure.main_material
    assert len(felt.likely) == 3
    assert "denim" not in felt.reason
    assert felt.library.mechanics not in [material.mechanics for material in load_library()]
    assert felt.confidence < 0.5 < sure.main_material.confidence


def test_a_photograph_is_touched_with_either_network(tmp_path: Path) -> None:
    image = write_photograph(tmp_path / "x.png")
    first, second = compare_networks([image], [REGRESSION, DIFFUSION], side_m=0.07)
    assert first.strokes == second.strokes == 1
    assert first.predicted_patches == second.predicted_patches > 0
    assert second.map_db > 0.1
    assert np.isfinite(second.vibration_db)
    assert 0.0 < second.confidence < 0.5
