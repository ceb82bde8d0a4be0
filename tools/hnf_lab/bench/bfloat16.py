"""F_Θ's layers in bfloat16, which numpy does not know: for `hnf bench synth`, and used nowhere else, since processors
with products of that type are few."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def evaluate_heads_bfloat16(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """As hnf_core.field.field.heads, every number kept in bfloat16."""
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
