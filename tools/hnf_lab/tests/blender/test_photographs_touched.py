"""A photograph is touched in Blender with and without its name, as `hnf touch` would."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.material.library import get_material, load_library
from hnf_lab.evaluation.photographs.measure import touch_photograph


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
