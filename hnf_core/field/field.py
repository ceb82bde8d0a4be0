"""F_Θ(m, u) → (α, σΔt): a conditioned ReLU network with one linear head for each, and its accumulation over states.

Haptic Neural Fields (CVPR 2026): L layers of H units, α and σ heads of N values. Here α holds an amplitude per
carrier, σΔt is what the σ head gives (in seconds Σw would start at 3.5e-4 and training stall), and the N states may be
past states u(t − nΔ), which unlike N heads of one state carry memory. The published form is
FieldConfig.published().

The architecture of F_Θ: its layers and heads, what its states are, and which carriers its emissions drive.

The layers and heads of F_Θ on many states: bytes that do not depend on how many cores a machine has to spare.

OpenBLAS adds in another order on another number of threads. So states go through in portions that follow from their
number alone, each on one thread of BLAS, as many at once as there are cores where that is worth the trouble.

F_Θ at many states by the compiled kernel, for fields of the shipped form: the twin in C of what field.py does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from ctypes import CDLL
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ
from ..kernel import compiled_field as kernel_field
from ..kernel.compiled_field import CONTACT_COLUMNS, EmissionTables, Layers
from ..kernel.loader import load_kernel
from ..material.contact_model import Mechanics
from ..threads import available_cpus, single_blas_thread
from .carriers import Carriers
from .features import (
    AMPLITUDE_FLOOR_M_S2,
    DIRECTION_COLUMN,
    MECHANICS_COLUMN,
    PROBE_NAMES,
    REFERENCE_RESONANCE_HZ,
    REFERENCE_SPEED_M_S,
    TIME_SHARE_DB,
    build_inputs,
    encode_mechanics,
    input_size,
    motion_gate,
    token_normalisation,
)
from .linear_contact import (
    FORCE_FLOOR_N,
    HARMONIC_SHIFTS,
    HARMONIC_START_LOG,
    LINE_FLOOR_M_S2,
    LINE_GAIN_COUNT,
    SPEED_FLOOR_M_S,
    Condition,
    compute_contact_columns,
    compute_line_power,
    lateral_hand_impedance,
    time_edges_in_arc_bands,
)
from .surface_spectrum import build_kernel_tables
from .temporal_rendering import render_weights
from .training_ranges import TrainingRanges

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class FieldConfig:
    """Architecture.

    hidden, layers: H and L. states: N. accumulation: "past" = N past states, spacing_s apart, sharing one α head;
    "heads" = N heads of one state (published), whose carriers lag n Δt. emission: "log" = α is an amplitude exp(head);
    "linear" = α is the head (published). physics: add the linear contact to the inputs and, per carrier and weighted
    by a learned skip, to the log-amplitude head. arc_knots: values the α head gives for the arc carriers, spread evenly
    over log κ and read linearly between; 0 = one per carrier. With one each, the few training strokes whose tone falls
    on a carrier decided alone how loud that carrier's tones are (up to 28 dB off on an unseen weave). action_octaves:
    of the positional encoding of u(t), features.encode_action. directed: False for data that never told directions
    apart; the field then ignores d. line_gains: an output for each tone of the token's lattice, see lines; needs
    physics, log emission and arc carriers. stroke_frame: the network sees the token in the frame of the stroke instead
    of token and d, see features.seen_from. Raises ValueError where past states are not a whole number of action
    samples apart, one at least, and no distance of states is more than a second.
    """

    hidden: int = 256
    layers: int = 4
    states: int = 5
    accumulation: Literal["past", "heads"] = "past"
    spacing_s: float = 0.01
    carriers: Carriers = field(default_factory=Carriers)
    emission: Literal["log", "linear"] = "log"
    physics: bool = True
    arc_knots: int = 25
    action_octaves: int = 0
    directed: bool = True
    line_gains: bool = False
    stroke_frame: bool = False

    def __post_init__(self) -> None:
        if self.accumulation != "past":
            if not 0.0 <= self.spacing_s <= 1.0:
                raise ValueError(f"spacing_s must lie between 0 and 1, not {self.spacing_s:g}")
            return
        steps = self.spacing_s * ACTION_RATE_HZ
        if not 0.5 < steps < ACTION_RATE_HZ + 0.5 or abs(steps - round(steps)) > 1e-9 * steps:
            step, given = 1.0 / ACTION_RATE_HZ, self.spacing_s
            raise ValueError(f"spacing_s must lie between 0 and 1, a whole multiple of {step:g} s, not {given:g}")

    @staticmethod
    def published(hidden: int = 1024, layers: int = 4, states: int = 5) -> FieldConfig:
        """The paper's literal model: N heads, one constant carrier."""
        constant = Carriers(time_edges_hz=(), arc_octaves=0, constant=True)
        return FieldConfig(hidden, layers, states, "heads", 0.0, constant, "linear", False, 0)

    @property
    def alpha_heads(self) -> int:
        return self.states if self.accumulation == "heads" else 1

    @property
    def stride(self) -> int:
        """Action samples between neighbouring past states."""
        return round(self.spacing_s * ACTION_RATE_HZ)

    @property
    def alpha_outputs(self) -> int:
        """Values of one α head."""
        spared = self.carriers.arc_count - self.arc_knots if self.arc_knots and self.carriers.arc_count else 0
        return self.carriers.count - spared + (LINE_GAIN_COUNT if self.line_gains else 0)

    def expansion(self) -> NDArray[np.float32] | None:
        """(Ka, arc_knots) linear interpolation from knots to arc carriers, or None where each has its own value."""
        count = self.carriers.arc_count
        if not self.arc_knots or not count:
            return None
        place = np.linspace(0.0, self.arc_knots - 1.0, count)
        return np.maximum(1.0 - np.abs(place[:, None] - np.arange(self.arc_knots)), 0.0).astype(np.float32)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every parameter; weight matrices are (outputs, inputs)."""
        width = input_size(self.carriers, self.physics, self.action_octaves)
        shapes: dict[str, tuple[int, ...]] = {}
        for layer in range(self.layers):
            shapes[f"layer{layer}.weight"] = (self.hidden, width if layer == 0 else self.hidden)
            shapes[f"layer{layer}.bias"] = (self.hidden,)
        outputs = self.alpha_heads * self.alpha_outputs
        shapes["alpha.weight"], shapes["alpha.bias"] = (outputs, self.hidden), (outputs,)
        shapes["sigma.weight"], shapes["sigma.bias"] = (self.states, self.hidden), (self.states,)
        if self.physics:
            shapes["skip"] = (self.carriers.count,)
        return shapes


UNTRAINED = "untrained"
"""Identity of every field that was never saved."""


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


def evaluate(model: Field, condition: Condition, network: NetworkFn | NetworkOutput | None = None) -> Emission:
    """F_Θ at each of n states, in float32 products (as the torch twin). answer: what stands for the network, or what it
    would have answered."""
    config, weights, kernel = model.config, model.parameters, find_kernel(model)
    if network is None:
        network = get_network(model)
    if kernel is None:
        return _evaluate_numpy(model, condition, network if callable(network) else lambda _: network)
    emitter = get_emitter(config, weights["skip"].tobytes(), condition.probe, LOG_AMPLITUDE_CEILING)
    if callable(network):
        alpha, sigma = evaluate_compiled(kernel, emitter, condition, network)
    else:
        alpha, sigma = decode_outputs(kernel, emitter, condition, network[0]), network[1]
    return Emission(alpha[:, None, :], np.logaddexp(0.0, sigma.astype(np.float64)))


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


def get_network(model: Field) -> NetworkFn:
    """F_Θ's layers and heads."""
    kernel = find_kernel(model)
    if kernel is None:
        return partial(run_network, model.parameters, model.config.layers)
    return partial(model.layers.evaluate, kernel)


BATCH_ROWS = 96
"""States at most; an even number of portions of one size, so that two cores end together."""
MIN_THREADED_MULTIPLICATIONS = 1 << 26
"""Multiplications: about a millisecond of one core."""


def run_network(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """Outputs of the α head and of the σ head, (n, …) each, for inputs x (n, D)."""
    portions = np.array_split(x, 2 * -(-len(x) // (2 * BATCH_ROWS))) if len(x) > BATCH_ROWS else [x]
    multiplications = len(x) * sum(value.size for value in parameters.values() if value.ndim == 2)
    with single_blas_thread():
        if len(portions) > 1 and multiplications > MIN_THREADED_MULTIPLICATIONS:
            with ThreadPoolExecutor(min(len(portions), available_cpus())) as pool:
                found = list(pool.map(lambda portion: _forward(parameters, layers, portion), portions))
        else:
            found = [_forward(parameters, layers, portion) for portion in portions]
    return np.concatenate([alpha for alpha, _ in found]), np.concatenate([sigma for _, sigma in found])


def _forward(parameters: Mapping[str, Float32], layers: int, hidden: Float32) -> tuple[Float32, Float32]:
    for layer in range(layers):
        hidden = hidden @ parameters[f"layer{layer}.weight"].T
        hidden += parameters[f"layer{layer}.bias"]
        np.maximum(hidden, 0.0, out=hidden)
    alpha, sigma = (hidden @ parameters[f"{head}.weight"].T + parameters[f"{head}.bias"] for head in ("alpha", "sigma"))
    return alpha, sigma


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


def find_kernel(model: Field) -> CDLL | None:
    """The kernel, where it knows fields of this form: then what a state gives is the same to the last bit whatever
    others are asked for beside it."""
    return load_kernel() if kernel_supports(model.config) and model.parameters["skip"].dtype == np.float32 else None


def kernel_supports(config: FieldConfig) -> bool:
    """Whether the kernel knows a field of this form."""
    carriers = config.carriers
    shipped = config.physics and config.emission == "log" and config.alpha_heads == 1 and not config.action_octaves
    return shipped and not carriers.constant and carriers.time_count > 0 and carriers.arc_count > 0


def evaluate_compiled(
    kernel: CDLL, emitter: EmissionTables, condition: Condition, network: Callable[[Float32], tuple[Float32, Float32]]
) -> tuple[Float, Float32]:
    """alpha (n, K), and what the σ head answers. answer: inputs (n, D) → both heads' (n, …)."""
    tokens, motion, touch = _state_columns(condition)
    known = np.array([encode_fixed_inputs(each, condition.probe) for each in condition.mechanics])
    x, expected = kernel_field.compute_inputs(kernel, emitter, tokens, known[condition.material], motion, touch)
    head, sigma = network(x)
    return kernel_field.decode_head(
        kernel, emitter, np.ascontiguousarray(head, dtype=np.float32), motion, expected
    ), sigma


def decode_outputs(kernel: CDLL, emitter: EmissionTables, condition: Condition, head: Float32) -> Float:
    """alpha (n, K) of what the α head has answered (n, outputs)."""
    return kernel_field.decode_known_head(
        kernel, emitter, *_state_columns(condition), np.ascontiguousarray(head, dtype=np.float32)
    )


@lru_cache(maxsize=16)
def get_emitter(config: FieldConfig, skip: bytes, probe: str, ceiling: float) -> EmissionTables:
    """skip: the parameter's float32 numbers. ceiling: of a log amplitude."""
    carriers = config.carriers
    shift, scale = token_normalisation()
    knots = config.arc_knots or carriers.arc_count
    place = np.linspace(0.0, knots - 1.0, carriers.arc_count)
    knot = np.minimum(place.astype(np.int64), max(knots - 2, 0))
    return EmissionTables(
        build_kernel_tables(carriers, *lateral_hand_impedance(probe)), token_shift=shift, token_scale=scale,
        time_edge=time_edges_in_arc_bands(carriers),
        skip=np.frombuffer(skip, dtype=np.float32).astype(np.float64), knot=knot, knot_share=place - knot,
        harmonic_shift=np.array(HARMONIC_SHIFTS), harmonic_start=np.array(HARMONIC_START_LOG),
        inputs=input_size(carriers, config.physics), fixed_at=MECHANICS_COLUMN,
        fixed=DIRECTION_COLUMN - MECHANICS_COLUMN,
        direction_at=DIRECTION_COLUMN, outputs=config.alpha_outputs, stroke_frame=config.stroke_frame,
        directed=config.directed, line_gains=config.line_gains, quiet_power=AMPLITUDE_FLOOR_M_S2**2,
        quiet_line_power=LINE_FLOOR_M_S2**2, time_share=10.0 ** (TIME_SHARE_DB / 10.0), ceiling=ceiling,
        pace=REFERENCE_SPEED_M_S,
        pitch=REFERENCE_RESONANCE_HZ,
    )  # fmt: skip


def encode_fixed_inputs(mechanics: Mechanics, probe: str) -> tuple[float, ...]:
    """Of a material under a probe, what no state changes: inputs from MECHANICS_AT on."""
    return (*encode_mechanics(mechanics), *(float(name == probe) for name in PROBE_NAMES))


def _state_columns(condition: Condition) -> tuple[Float, Float, Float]:
    """Of n states: tokens (n, TOKEN_DIM), and the columns MOTION and TOUCH."""
    touch, resonance = compute_contact_columns(condition)
    motion = np.empty((len(resonance), len(kernel_field.MOTION_COLUMNS)))
    motion[:, :2] = condition.direction
    np.maximum(condition.speed, SPEED_FLOOR_M_S, out=motion[:, 2])
    np.maximum(condition.force, FORCE_FLOOR_N, out=motion[:, 3])
    motion[:, 4], motion[:, 5], motion[:, 6] = touch["mass"], resonance, motion_gate(condition)
    columns = np.stack([touch[name] for name in CONTACT_COLUMNS], axis=1)
    return np.ascontiguousarray(condition.tokens, dtype=np.float64), motion, columns
