"""The torch twin of hnf_core.field: the same parameters, names and arithmetic, with gradients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..field.field import LOG_AMPLITUDE_CEILING, FieldConfig
from ..field.linear_contact import HARMONIC_SHIFTS, HARMONIC_START_LOG, LINE_COUNT, LINE_GAIN_COUNT


def render_weights(sigma_dt: Tensor) -> Tensor:
    """Twin of field.rendering.render_weights: (..., N) → (..., N), gradients finite for σΔt in [0, ∞].

    float16 and bfloat16 are accumulated in float32, float32 and float64 in float64, gradients likewise.
    """
    narrow = sigma_dt.dtype in (torch.float16, torch.bfloat16)
    density = sigma_dt.to(torch.float32 if narrow else torch.float64)
    before = functional.pad(density[..., :-1], (1, 0))
    step = 1
    while step < before.shape[-1]:  # as field.rendering.prefix_sums
        before = torch.cat([before[..., :step], before[..., step:] + before[..., :-step]], dim=-1)
        step *= 2
    # expm1's own gradient, expm1 + 1, has lost exp(−x) for large x; 1 − exp(−x) has lost x for small x.
    absorbed = torch.where(density < 0.5, -torch.expm1(-density), 1.0 - torch.exp(-density))
    return (torch.exp(-before) * absorbed).to(sigma_dt.dtype)


class FieldNetwork(nn.Module):
    """F_Θ. forward: x (n, D), prior (n, K), gate (n, K) → alpha (n, heads, K), sigma_dt (n, N)."""

    def __init__(self, config: FieldConfig, parameters: Mapping[str, NDArray[np.float32]]) -> None:
        super().__init__()
        self.config = config
        expansion = config.expansion()
        self.expansion = None if expansion is None else torch.tensor(expansion)
        self.weights = nn.ParameterDict(
            {name.replace(".", "_"): nn.Parameter(torch.tensor(value)) for name, value in parameters.items()}
        )

    def evaluate_heads(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """What the layers make of x (n, D): the α head (n, heads, outputs), before prior and gate, and σΔt (n, N)."""
        config, weights = self.config, self.weights
        hidden = x
        for layer in range(config.layers):
            hidden = torch.relu(
                functional.linear(hidden, weights[f"layer{layer}_weight"], weights[f"layer{layer}_bias"])
            )
        head = functional.linear(hidden, weights["alpha_weight"], weights["alpha_bias"])
        sigma_dt = functional.softplus(functional.linear(hidden, weights["sigma_weight"], weights["sigma_bias"]))
        return head.reshape(len(head), config.alpha_heads, config.alpha_outputs), sigma_dt

    def compute_emission(self, head: Tensor, prior: Tensor, gate: Tensor) -> Tensor:
        """α (n, heads, K) from the α head, prior (n, K; more with line gains, see Inputs) and gate (n, K)."""
        config, weights, alpha = self.config, self.weights, head
        count = config.carriers.count
        if config.line_gains:
            alpha, gains = head[..., :-LINE_GAIN_COUNT], head[:, 0, -LINE_GAIN_COUNT:]
        if self.expansion is not None:
            first = config.carriers.arc_slice.start
            alpha = torch.cat([alpha[..., :first], alpha[..., first:] @ self.expansion.T], dim=-1)
        if config.physics:
            alpha = alpha + (weights["skip"] * prior[:, :count])[:, None, :]
        if config.emission == "log":
            alpha = torch.exp(torch.clamp(alpha, max=LOG_AMPLITUDE_CEILING))
        if config.line_gains:
            first, arcs = config.carriers.arc_slice.start, config.carriers.arc_count
            power = alpha[:, 0, first:].square() + compute_line_power(gains, prior[:, count:], arcs)
            alpha = torch.cat([alpha[:, 0, :first], power.sqrt()], dim=-1)[:, None, :]
        return alpha * gate[:, None, :]

    def forward(self, x: Tensor, prior: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
        head, sigma_dt = self.evaluate_heads(x)
        return self.compute_emission(head, prior, gate), sigma_dt

    def compute_steady_amplitude(self, x: Tensor, prior: Tensor, gate: Tensor) -> Tensor:
        """(n, K) amplitudes of a long steady stroke ("past" accumulation)."""
        alpha, sigma_dt = self(x, prior, gate)
        return accumulate_steady(alpha, sigma_dt)

    def to_numpy_parameters(self) -> dict[str, NDArray[np.float32]]:
        """Parameters under their names in FieldConfig.shapes."""
        return {name: self.weights[name.replace(".", "_")].detach().numpy().copy() for name in self.config.shapes()}


def compute_line_power(gains: Tensor, columns: Tensor, count: int) -> Tensor:
    """Twin of field.lines.line_power: log gains (n, GAINS), prior columns (n, 3 LINES) → (n, count)."""
    shift, start = (
        torch.tensor(HARMONIC_SHIFTS)[:, None],
        torch.tensor(HARMONIC_START_LOG, dtype=torch.float32)[:, None],
    )
    gain = gains.reshape(len(gains), 1, len(HARMONIC_SHIFTS), LINE_COUNT) + start
    level = columns[:, : 2 * LINE_COUNT].reshape(-1, 2, 1, LINE_COUNT)
    power = torch.exp(2.0 * torch.clamp(gain + level, max=LOG_AMPLITUDE_CEILING))
    index = columns[:, 2 * LINE_COUNT :].long()[:, None, None, :] + shift + torch.arange(2)[:, None, None]
    inside = (index >= 0) & (index < count)
    power = torch.where(inside, power, 0.0).flatten(1)
    return torch.zeros(len(gains), count).scatter_add(1, index.clamp(0, count - 1).flatten(1), power)


def accumulate_steady(alpha: Tensor, sigma_dt: Tensor) -> Tensor:
    """(n, 1, K), (n, N) → (n, K): a state that has lasted longer than the memory."""
    return render_weights(sigma_dt).sum(dim=-1)[:, None] * alpha[:, 0]
