"""Synthesis with F_Θ's layers in bfloat16: measured here, and no way of the product."""

from __future__ import annotations

import importlib.util
from functools import partial

from ..field.field import Emission, Field, evaluate
from ..field.linear_contact import Condition


def has_bfloat16() -> bool:
    """Is there a torch to compute in it?"""
    return importlib.util.find_spec("torch") is not None


def evaluate_in_bfloat16(model: Field, condition: Condition) -> Emission:
    """evaluate(), with every number of F_Θ's layers and heads in bfloat16."""
    from ..training.narrow import evaluate_heads_bfloat16

    return evaluate(model, condition, partial(evaluate_heads_bfloat16, model.parameters, model.config.layers))
