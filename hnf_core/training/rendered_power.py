"""What F_Θ, rendered over time, leads one to expect of a window: the torch side of the expected-power likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..field.config import FieldConfig
from ..field.features import build_inputs
from ..field.linear_contact import Condition
from ..field.rendering import STEP_S
from ..material.mechanics import Mechanics
from .expectation import compute_expectation_matrices
from .likelihood import compute_arc_density
from .model import FieldNetwork, render_weights
from .windows import States, Windows

Float = NDArray[np.float64]

SPEED_NODES = 96
"""Speeds at which the arc carriers' expectation is tabulated, evenly in log: within a tenfold range their step is
smaller than a carrier is wide."""
STATES_PER_CHUNK = 4096


@dataclass(frozen=True)
class RenderedInputs:
    """F_Θ's inputs at the states that windows need (s of them), and where each window finds its own.

    x: (s, D). prior, gate: (s, K). phase: (s, K) radians by which a carrier turns in one Δt. speed: (s,) index into
    the tabulated speeds. at: (n, Q, P) rows of the above: node by past state (P = 1 for "heads"). alive: (n, Q, P)
    0 where that past lies before the recording. share: (Q,).
    """

    x: Tensor
    prior: Tensor
    gate: Tensor
    phase: Tensor
    speed: Tensor
    state_rows: Tensor
    alive: Tensor
    share: Tensor


def make_speed_table(states: States) -> Float:
    """(SPEED_NODES,) m/s over the speeds that occur."""
    moving = states.speed[states.speed > 1e-3]
    low, high = (float(moving.min()), float(moving.max())) if len(moving) else (0.01, 0.1)
    return np.geomspace(low, max(high, 1.01 * low), SPEED_NODES)


def build_rendered_inputs(
    config: FieldConfig, states: States, windows: Windows, token: NDArray[np.float32], mechanics: Mechanics
) -> RenderedInputs:
    """Everything that stays the same while the network learns."""
    past = config.states if config.accumulation == "past" else 1
    wanted = windows.node[:, :, None] - config.stride * np.arange(past)
    alive = wanted >= windows.first[windows.node][:, :, None]
    used, at = np.unique(np.where(alive, wanted, windows.node[:, :, None]), return_inverse=True)
    parts = [
        _build_state_inputs(config, states, used[low : low + STATES_PER_CHUNK], token, mechanics)
        for low in range(0, len(used), STATES_PER_CHUNK)
    ]
    x, prior, gate = (torch.tensor(np.concatenate(column)) for column in zip(*parts, strict=True))
    speed = states.speed[used]
    carriers, phase = config.carriers, np.zeros((len(used), config.carriers.count), dtype=np.float32)
    if config.accumulation == "heads":
        edges = carriers.time_edges()
        phase[:, carriers.time_slice] = np.pi * (edges[1:] + edges[:-1]) * STEP_S
        phase[:, carriers.arc_slice] = 2.0 * np.pi * speed[:, None] * carriers.arc_centres() * STEP_S
    table = np.log(make_speed_table(states))
    nearest = np.rint((np.log(np.maximum(speed, 1e-6)) - table[0]) / (table[1] - table[0]))
    return RenderedInputs(
        x, prior, gate, torch.tensor(phase), torch.tensor(np.clip(nearest, 0, SPEED_NODES - 1).astype(np.int64)),
        torch.tensor(at.reshape(wanted.shape)), torch.tensor(alive.astype(np.float32)),
        torch.tensor(windows.node_weight, dtype=torch.float32),
    )  # fmt: skip


class RenderedPower:
    """Expected power of windows, (rows, 107), given a network. speeds: from speed_table."""

    def __init__(self, config: FieldConfig, speeds: Float) -> None:
        used = speeds if config.carriers.arc_count else speeds[:1]
        time, arc = compute_expectation_matrices(config.carriers, used)
        self.config = config
        self.time = torch.tensor(time, dtype=torch.float32)
        self.arc = torch.tensor(arc, dtype=torch.float32)

    def __call__(self, network: FieldNetwork, inputs: RenderedInputs, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Also the α head's raw outputs of those rows, for regularisation."""
        carriers, at = self.config.carriers, inputs.state_rows[rows]
        flat = at.reshape(-1)
        head, sigma_dt = network.evaluate_heads(inputs.x[flat])
        alpha = network.compute_emission(head, inputs.prior[flat], inputs.gate[flat])
        if self.config.accumulation == "past":
            memory = sigma_dt.reshape(*at.shape, -1).diagonal(dim1=-2, dim2=-1)
            weight = render_weights(memory) * inputs.alive[rows]
            amplitude = (weight[..., None] * alpha.reshape(*at.shape, -1)).sum(dim=-2)
            power = amplitude.square()
        else:
            lag = torch.arange(self.config.states, dtype=torch.float32)[None, :, None] * inputs.phase[flat][:, None, :]
            emitted = render_weights(sigma_dt)[..., None] * alpha
            real, imaginary = (emitted * torch.cos(lag)).sum(dim=1), (emitted * torch.sin(lag)).sum(dim=1)
            power = (real.square() + imaginary.square()).reshape(*at.shape[:2], -1)
        out = torch.einsum("q,rqk,kb->rb", inputs.share, power[..., carriers.time_slice], self.time)
        if carriers.arc_count:
            speed = inputs.speed[at[..., 0]]
            dense = compute_arc_density(power[..., carriers.arc_slice].flatten(0, 1), speed.flatten(), self.arc)
            out = out + torch.einsum("q,rqb->rb", inputs.share, dense.reshape(*speed.shape, -1))
        return out, head


def _build_state_inputs(
    config: FieldConfig, states: States, rows: NDArray[np.int64], token: NDArray[np.float32], mechanics: Mechanics
) -> tuple[NDArray[np.float32], ...]:
    condition = Condition(
        tokens=np.tile(token.astype(np.float64), (len(rows), 1)),
        mechanics=(mechanics,),
        material=np.zeros(len(rows), dtype=np.int32),
        direction=states.direction[rows],
        speed=states.speed[rows],
        force=states.force[rows],
        contact=states.contact[rows],
        probe=states.probe,
    )
    inputs = build_inputs(condition, config.carriers, config.physics, config.action_octaves, config.directed)
    return inputs.x.astype(np.float32), inputs.prior.astype(np.float32), inputs.gate.astype(np.float32)
