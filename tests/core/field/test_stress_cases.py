"""Stress: the table in docs/numerics.md, and the precision that each stage needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.field.field import Field, FieldConfig, evaluate, initial_parameters
from hnf_core.field.stroke import build_condition, resample_action
from hnf_lab.experiments.stress_table import format_stress_table, list_stress_files

PAGE = Path(__file__).resolve().parents[3] / "docs" / "numerics.md"


def test_the_page_lists_every_case():
    """Every case of this suite → stands in this table in the words of its test"""
    assert len(list_stress_files()) >= 6
    assert format_stress_table() in PAGE.read_text(encoding="utf-8")


def test_narrow_types():
    """F_Θ's layers in float32, float16, bfloat16 → amplitudes within −110, −45, −30 dB of float64's"""
    torch = pytest.importorskip("torch", reason="the twin needs torch (train extra)")
    from hnf_lab.experiments.numerics import compute_error_db, evaluate_in_type, make_example_stroke

    config, rng = FieldConfig(hidden=32, layers=2), np.random.default_rng(0)
    start = initial_parameters(config, 0)
    field = Field(config, {k: (v + 0.05 * rng.standard_normal(v.shape)).astype(np.float32) for k, v in start.items()})
    stroke = make_example_stroke(0.2)
    exact = evaluate_in_type(field, stroke, torch.float64)
    own = evaluate(field, build_condition(stroke, *resample_action(stroke)))
    assert compute_error_db(own.alpha, exact.alpha) < -110.0
    types = (torch.float32, torch.float16, torch.bfloat16)
    errors = [compute_error_db(evaluate_in_type(field, stroke, dtype).alpha, exact.alpha) for dtype in types]
    assert errors == sorted(errors)
    assert all(error < bound for error, bound in zip(errors, (-110.0, -45.0, -30.0), strict=True))
