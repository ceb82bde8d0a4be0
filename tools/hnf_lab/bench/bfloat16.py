"""The layers of F_Θ in bfloat16 with torch, since numpy has no such type.

Used by `hnf bench synth` only, as few processors have bfloat16 products.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def evaluate_heads_bfloat16(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """Evaluate like hnf_core.field.field.heads, with every number in bfloat16."""
    weights = {name: torch.from_numpy(value).to(torch.bfloat16) for name, value in parameters.items()}
    with torch.inference_mode():
        hidden = torch.from_numpy(x).to(torch.bfloat16)
        for layer in range(layers):
            linear = torch.nn.functional.linear(hidden, weights[f"layer{layer}.weight"], weights[f"layer{layer}.bias"])
            hidden = torch.relu(linear)
        alpha, sigma = (
            torch.nn.functional.linear(hidden, weights[f"{head}.weight"], weights[f"{head}.bias"]).float().numpy()
            for head in ("alpha", "sigma")
        )
    return alpha, sigma
