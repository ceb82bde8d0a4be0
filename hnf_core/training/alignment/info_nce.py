"""Symmetric InfoNCE: each picture must find its own touch among those of the batch, and each touch its picture."""

from __future__ import annotations

import torch
from torch import Tensor

TEMPERATURE = 0.07
"""As van den Oord et al. (2018) is used by CMC (Tian et al. 2020) and by the paper."""


def compute_info_nce(vision: Tensor, touch: Tensor, temperature: float = TEMPERATURE) -> Tensor:
    """Mean of −log p(touch i | vision i) and −log p(vision i | touch i) over a batch; a scalar.

    vision, touch: (n, d) of length 1; row i of one belongs to row i of the other. p is the softmax of the cosines over
    the temperature. By log-sum-exp, in float32 at least whatever autocast says: no exponential of a logit is ever
    formed, so that neither 1 / 0.07 nor thousands of rows cost precision. 0 is never reached: n rows at right angles
    give log(1 + (n − 1) exp(−1 / temperature)).
    """
    with torch.autocast(vision.device.type, enabled=False):
        wide = torch.promote_types(torch.promote_types(vision.dtype, touch.dtype), torch.float32)
        logits = vision.to(wide) @ touch.to(wide).T / temperature
        right = logits.diagonal()
        return (0.5 * (logits.logsumexp(dim=0) + logits.logsumexp(dim=1)) - right).mean()
