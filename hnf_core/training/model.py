"""F_Θ in torch, with gradients: the same parameters, names and arithmetic as hnf_core.field.field."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..field.contact.lattice_lines import HARMONIC_SHIFTS, HARMONIC_START_LOG, LINE_COUNT, LINE_GAIN_COUNT
from ..field.field import LOG_AMPLITUDE_CEILING, FieldConfig


def render_weights(sigma_dt: Tensor) -> Tensor:
    """Compute NeRF weights (..., N) from densities σΔt (..., N): w_n = exp(−Σ_{j<n} σ_jΔt) · (1 − exp(−σ_nΔt)).

    Gradients are finite for σΔt in [0, ∞]. float16 and bfloat16 are accumulated in float32, float32 and float64 in
    float64, gradients likewise.
    """
    narrow = sigma_dt.dtype in (torch.float16, torch.bfloat16)
    density = sigma_dt.to(torch.float32 if narrow else torch.float64)
    before = functional.pad(density[..., :-1], (1, 0))
    step = 1
    while step < before.shape[-1]:  # As field.render_weights.prefix_sums.
        before = torch.cat([before[..., :step], before[..., step:] + before[..., :-step]], dim=-1)
        step *= 2
    # The gradient of expm1 is computed as expm1 + 1, which loses exp(−x) for large x; 1 − exp(−x) loses x for small x.
    absorbed = torch.where(density < 0.5, -torch.expm1(-density), 1.0 - torch.exp(-density))
    return (torch.exp(-before) * absorbed).to(sigma_dt.dtype)


class FieldNetwork(nn.Module):
    """F_Θ as a torch module: inputs x (n, D), prior (n, K), gate (n, K) → alpha (n, heads, K), sigma_dt (n, N).

    Parameters
    ----------
    config
        Architecture.
    parameters
        float32 arrays by their names in FieldConfig.shapes.
    """

    def __init__(self, config: FieldConfig, parameters: Mapping[str, NDArray[np.float32]]) -> None:
        super().__init__()
        self.config = config
        expansion = config.expansion()
        self.expansion = None if expansion is None else torch.tensor(expansion)
        self.weights = nn.ParameterDict(
            {name.replace(".", "_"): nn.Parameter(torch.tensor(value)) for name, value in parameters.items()}
        )

    def evaluate_heads(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the α head (n, heads, outputs), before prior and gate, and σΔt (n, N), for inputs x (n, D)."""
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
        """Compute amplitudes α (n, heads, K) from the α head, the prior (n, K) and the gate (n, K).

        prior: log amplitudes of the linear contact, which the head corrects; with line gains it has further columns
        (tones), see field.features.Inputs. gate: factor 0 … 1 for rest and contact.
        """
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
        """Return alpha (n, heads, K) and sigma_dt (n, N)."""
        head, sigma_dt = self.evaluate_heads(x)
        return self.compute_emission(head, prior, gate), sigma_dt

    def compute_steady_amplitude(self, x: Tensor, prior: Tensor, gate: Tensor) -> Tensor:
        """Compute the amplitudes (n, K) of long steady strokes, where all past states are equal."""
        alpha, sigma_dt = self(x, prior, gate)
        return accumulate_steady(alpha, sigma_dt)

    def to_numpy_parameters(self) -> dict[str, NDArray[np.float32]]:
        """Return the parameters by their names in FieldConfig.shapes."""
        return {name: self.weights[name.replace(".", "_")].detach().numpy().copy() for name in self.config.shapes()}


def compute_line_power(gains: Tensor, columns: Tensor, count: int) -> Tensor:
    """Compute the power (n, count) of a regular surface's tones in each of `count` arc carriers.

    gains: (n, LINE_GAIN_COUNT) learned log gains of tones and harmonics. columns: (n, 3 LINE_COUNT) of
    field.linear_contact.encode_line_prior. Same as field.linear_contact.compute_line_power.
    """
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
    """Weight α (n, 1, K) by densities σΔt (n, N) for a state that lasts longer than the past states reach; (n, K)."""
    return render_weights(sigma_dt).sum(dim=-1)[:, None] * alpha[:, 0]
