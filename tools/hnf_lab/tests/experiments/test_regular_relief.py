"""Regular surfaces beside the simulator: rows of the table, and a picture."""

from __future__ import annotations

import pytest

from hnf_core.field.weights import load_field
from hnf_lab.experiments.regular_relief import draw_spectrograms, make_grating, make_lattice, measure_levels


def test_a_grating_is_as_strong_as_simulated_for_every_seed():
    row = measure_levels(load_field(), [make_grating(1e-3, 10e-6)], (0.2,), seeds=3)[-1]
    assert abs(float(row.split("|")[4])) < 1.0
    low, high = (float(word) for word in row.split("|")[5].split("…"))
    assert -0.75 < low <= 0.0 <= high < 0.75


def test_spectrograms_are_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="draws pictures")
    draw_spectrograms(load_field(), [make_lattice("corduroy")], tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
