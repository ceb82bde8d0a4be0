"""F_Θ's layers in bfloat16: measured here, and used nowhere, since processors that know the type are few and its errors
large. numpy has no such type, so torch computes it."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from ..field import field as module

Float32 = NDArray[np.float32]
Result = tuple[Float32, Float32]


def has_bfloat16() -> bool:
    """Is there a torch to compute in it?"""
    return importlib.util.find_spec("torch") is not None


def in_bfloat16(function: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
    """What function returns where F_Θ's layers and heads keep every number in bfloat16."""
    with patch.object(module, "heads", heads):
        return function()


def heads(parameters: Mapping[str, Float32], layers: int, x: Float32) -> Result:
    """As hnf_core.field.network.heads."""
    import torch

    narrow = {name: torch.from_numpy(value).to(torch.bfloat16) for name, value in parameters.items()}
    with torch.inference_mode():
        hidden = torch.from_numpy(x).to(torch.bfloat16)
        for layer in range(layers):
            linear = torch.nn.functional.linear(hidden, narrow[f"layer{layer}.weight"], narrow[f"layer{layer}.bias"])
            hidden = torch.relu(linear)
        alpha, sigma = (
            torch.nn.functional.linear(hidden, narrow[f"{head}.weight"], narrow[f"{head}.bias"]).float().numpy()
            for head in ("alpha", "sigma")
        )
    return alpha, sigma
