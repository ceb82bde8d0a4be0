"""Synthesis with F_Θ's layers in bfloat16: measured here, and no way of the product."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from ..field import field as module


def has_bfloat16() -> bool:
    """Is there a torch to compute in it?"""
    return importlib.util.find_spec("torch") is not None


def in_bfloat16(function: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
    """What function returns where F_Θ's layers and heads keep every number in bfloat16."""
    from ..training.narrow import heads

    with patch.object(module, "heads", heads):
        return function()
