"""Stress: the table in docs/numerics.md, and the precision that each stage needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stress_table import stress_files, stress_table

from hnf_core.field.config import FieldConfig
from hnf_core.field.field import Field, evaluate, initial_parameters
from hnf_core.field.timeline import condition_of, states_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "numerics.md"


def test_the_page_lists_every_case():
    """Every case of this suite → stands in this table in the words of its test"""
    assert len(stress_files()) >= 6
    assert stress_table() in PAGE.read_text(encoding="utf-8")


def test_narrow_types():
    """F_Θ's layers in float32, float16, bfloat16 → amplitudes within −110, −45, −30 dB of float64's"""
    torch = pytest.importorskip("torch", reason="the twin needs torch (train extra)")
    from precision_tables import decibels, emission_in, example_stroke

    config, rng = FieldConfig(hidden=32, layers=2), np.random.default_rng(0)
    start = initial_parameters(config, 0)
    field = Field(config, {k: (v + 0.05 * rng.standard_normal(v.shape)).astype(np.float32) for k, v in start.items()})
    stroke = example_stroke(0.2)
    exact = emission_in(field, stroke, torch.float64)
    own = evaluate(field, condition_of(stroke, *states_of(stroke)))
    assert decibels(own.alpha, exact.alpha) < -110.0
    types = (torch.float32, torch.float16, torch.bfloat16)
    errors = [decibels(emission_in(field, stroke, dtype).alpha, exact.alpha) for dtype in types]
    assert errors == sorted(errors)
    assert all(error < bound for error, bound in zip(errors, (-110.0, -45.0, -30.0), strict=True))
