"""F_Θ(m, u) → (α, σΔt): a conditioned ReLU network with one linear head for each, and its accumulation over states.

Haptic Neural Fields (CVPR 2026): L layers of H units, α and σ heads of N values. Here α holds an amplitude per
carrier, σΔt is what the σ head gives (in seconds Σw would start at 3.5e-4 and training stall), and the N states may be
past states u(t − nΔ), which unlike N heads of one state carry memory. The published form is
FieldConfig.published().
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import CDLL
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ..kernel.layers import Layers
from ..kernel.library import load_kernel
from .config import FieldConfig
from .emitter import decode_outputs, evaluate_compiled, get_emitter, kernel_supports
from .features import build_inputs
from .linear_contact import Condition
from .lines import LINE_GAIN_COUNT, compute_line_power
from .network import run_network
from .ranges import TrainingRanges
from .rendering import render_weights

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
UNTRAINED = "untrained"
"""Identity of every field that was never saved."""
NetworkOutput = tuple[Float32, Float32]
"""What the α head and the σ head say of n states, (n, …) each."""
NetworkFn = Callable[[Float32], NetworkOutput]
"""Of their inputs (n, D)."""

LOG_AMPLITUDE_CEILING = 6.0
"""exp of it is 400 m/s² in one band: far above any touch, far below overflow."""

PAST_DENSITY = 2.3
"""σΔt of each past state: 90 % of the weight on the present, 9 % on 10 ms ago. Against simulated strokes that stop and
turn five times a second the envelope errs by 6 % (sandpaper) and 10 % (leather); with 0.69, a longer memory, by 10 %
and 13 %."""


@dataclass(frozen=True)
class Field:
    """Architecture, parameters (float32, by name as in FieldConfig.shapes), training ranges, metadata, and identity
    (content hash of the weights, UNTRAINED where there is no file of them; see same_field)."""

    config: FieldConfig
    parameters: Mapping[str, NDArray[np.float32]]
    ranges: TrainingRanges | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    identity: str = UNTRAINED

    @cached_property
    def layers(self) -> Layers:
        """Of float32 parameters, as the kernel takes them: put in order once."""
        names = [*(f"layer{index}" for index in range(self.config.layers)), "alpha", "sigma"]
        weights, biases = ([self.parameters[f"{name}.{part}"] for name in names] for part in ("weight", "bias"))
        return Layers(weights, biases)


def is_same_field(first: Field, second: Field) -> bool:
    """Whether what one made may stand for what the other would make. Two that were never saved have one name."""
    return first is second or (first.identity == second.identity and first.identity != UNTRAINED)


@dataclass(frozen=True)
class Emission:
    """alpha: (n, heads, K), 0 at rest and out of contact. sigma_dt: (n, N) ≥ 0."""

    alpha: Float
    sigma_dt: Float

    def rows(self, rows: slice) -> Emission:
        return Emission(self.alpha[rows], self.sigma_dt[rows])

    def assign(self, rows: NDArray[np.bool_], values: Emission) -> None:
        """In these rows, what is given of them."""
        self.alpha[rows], self.sigma_dt[rows] = values.alpha, values.sigma_dt


def find_kernel(model: Field) -> CDLL | None:
    """The kernel, where it knows fields of this form: then what a state gives is the same to the last bit whatever
    others are asked for beside it."""
    return load_kernel() if kernel_supports(model.config) and model.parameters["skip"].dtype == np.float32 else None


def get_network(model: Field) -> NetworkFn:
    """F_Θ's layers and heads."""
    compiled = find_kernel(model)
    if compiled is None:
        return partial(run_network, model.parameters, model.config.layers)
    return partial(model.layers.evaluate, compiled)


def evaluate(model: Field, condition: Condition, network: NetworkFn | NetworkOutput | None = None) -> Emission:
    """F_Θ at each of n states, in float32 products (as the torch twin). answer: what stands for the network, or what it
    would have answered."""
    config, weights, compiled = model.config, model.parameters, find_kernel(model)
    if network is None:
        network = get_network(model)
    if compiled is None:
        return _evaluate_numpy(model, condition, network if callable(network) else lambda _: network)
    emitter = get_emitter(config, weights["skip"].tobytes(), condition.probe, LOG_AMPLITUDE_CEILING)
    if callable(network):
        alpha, sigma = evaluate_compiled(compiled, emitter, condition, network)
    else:
        alpha, sigma = decode_outputs(compiled, emitter, condition, network[0]), network[1]
    return Emission(alpha[:, None, :], np.logaddexp(0.0, sigma.astype(np.float64)))


def _evaluate_numpy(model: Field, condition: Condition, network: NetworkFn) -> Emission:
    """Every form of field, and what the kernel is tested against."""
    config, weights = model.config, model.parameters
    inputs = build_inputs(
        condition,
        config.carriers,
        config.physics,
        config.action_octaves,
        config.directed,
        config.line_gains,
        config.stroke_frame,
    )
    head, sigma = network(inputs.x.astype(np.float32))
    alpha = head.astype(np.float64).reshape(len(head), config.alpha_heads, config.alpha_outputs)
    alpha, gains = (
        (alpha[..., :-LINE_GAIN_COUNT], alpha[:, 0, -LINE_GAIN_COUNT:]) if config.line_gains else (alpha, None)
    )
    prior, tones = np.split(inputs.prior, [config.carriers.count], axis=1)
    expansion, first = config.expansion(), config.carriers.arc_slice.start
    if expansion is not None:
        alpha = np.concatenate([alpha[..., :first], alpha[..., first:] @ expansion.T], axis=-1)
    if config.physics:
        alpha = alpha + (weights["skip"] * prior)[:, None, :]
    if config.emission == "log":
        alpha = np.exp(np.minimum(alpha, LOG_AMPLITUDE_CEILING))
    if gains is not None:
        ringing = compute_line_power(gains, tones, config.carriers.arc_count, LOG_AMPLITUDE_CEILING)
        alpha[:, 0, config.carriers.arc_slice] = np.sqrt(np.square(alpha[:, 0, config.carriers.arc_slice]) + ringing)
    return Emission(alpha * inputs.gate[:, None, :], np.logaddexp(0.0, sigma.astype(np.float64)))


def accumulate(config: FieldConfig, emission: Emission, first: int = 0) -> Float:
    """Amplitudes (n − first, heads, K) of the carriers at each state of an evenly sampled action, from `first` on.

    "past": Σ_n w_n α(u_{i − n·stride}) with σ_n of that same past state, (…, 1, K); before the first sample nothing was
    emitted, and σ was that of the first. "heads": w_n α_n of each state, left apart because their carriers lag by n Δt.
    """
    if config.accumulation == "heads":
        return np.asarray(render_weights(emission.sigma_dt[first:])[:, :, None] * emission.alpha[first:])
    alpha, lags = emission.alpha[:, 0], config.stride * np.arange(config.states)
    before = np.maximum(np.arange(first, len(alpha))[:, None] - lags, 0)
    weights = render_weights(emission.sigma_dt[before, np.arange(config.states)])
    out = weights[:, :1] * alpha[first:]
    room = np.empty_like(out)
    for state, lag in enumerate(lags[1:], 1):
        at = max(lag - first, 0)
        if at < len(out):
            past = alpha[first + at - lag : len(alpha) - lag]
            out[at:] += np.multiply(weights[at:, state, None], past, out=room[at:])
    return np.asarray(out[:, None, :])


def steady_amplitude(config: FieldConfig, emission: Emission) -> Float:
    """Amplitudes (n, heads, K) when each state has lasted for longer than the memory."""
    weights = render_weights(emission.sigma_dt)
    if config.accumulation == "heads":
        return np.asarray(weights[:, :, None] * emission.alpha)
    return np.asarray(weights.sum(axis=1)[:, None, None] * emission.alpha)


def initial_parameters(config: FieldConfig, seed: int) -> dict[str, NDArray[np.float32]]:
    """He initialisation (He et al. 2015, eq. 10) of the layers; heads start at 0 where physics gives the level, so an
    untrained field is the linear contact. σΔt of past states starts at PAST_DENSITY, of heads at softplus(0) = 0.69."""
    generator = np.random.Generator(np.random.Philox(key=seed))
    parameters: dict[str, NDArray[np.float32]] = {}
    for name, shape in config.shapes().items():
        if name == "skip":
            value = np.ones(shape)
        elif name == "sigma.bias" and config.accumulation == "past":
            value = np.full(shape, np.log(np.expm1(PAST_DENSITY)))
        elif name.endswith("bias"):
            value = np.zeros(shape)
        elif name.startswith("layer"):
            value = generator.standard_normal(shape) * np.sqrt(2.0 / shape[1])
        else:
            gain = 0.0 if config.physics else 1.0
            value = gain * generator.standard_normal(shape) * np.sqrt(1.0 / shape[1])
        parameters[name] = value.astype(np.float32)
    return parameters
