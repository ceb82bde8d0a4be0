"""The field F_Θ(material m, hand state u) → (amplitudes α, densities σΔt): architecture, evaluation, accumulation.

A conditioned ReLU network of L layers of H units has linear heads for α and σ (Haptic Neural Fields, CVPR 2026, whose
published form is `FieldConfig.published`). Here α holds an amplitude per carrier (noise band); the outputs are weighted
over past states as NeRF weights samples along a ray, by densities σ. The σ head gives σΔt, since in seconds Σw would
start at 3.5e-4 and training stall; and the N states may be past states u(t − nΔ), which unlike N heads of one state
carry memory. Fields of the shipped form are evaluated by the compiled kernel, others in numpy. There OpenBLAS adds in
an order that depends on the number of threads, so states are split into batches by their number alone, each on one BLAS
thread: results do not depend on the machine's cores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from ctypes import CDLL
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ
from ..kernel import compiled_field
from ..kernel.compiled_field import CONTACT_COLUMNS, EmissionTables, Layers, ToneArrays
from ..kernel.loader import load_kernel
from ..material.contact_model import Mechanics
from ..material.probe import get_probe
from ..progress import add_work
from ..threads import available_cpus, single_blas_thread
from .carriers import Carriers
from .contact.lattice_lines import (
    HARMONIC_SHIFTS,
    HARMONIC_START_LOG,
    LINE_COUNT,
    LINE_FLOOR_M_S2,
    LINE_GAIN_COUNT,
    compute_line_power,
    gather_sidebands,
    take_tones,
)
from .features import (
    AMPLITUDE_FLOOR_M_S2,
    DIRECTION_COLUMN,
    MECHANICS_COLUMN,
    PROBE_KINDS,
    REFERENCE_RESONANCE_HZ,
    REFERENCE_SPEED_M_S,
    TIME_SHARE_DB,
    build_inputs,
    encode_mechanics,
    input_size,
    motion_gate,
    token_normalisation,
)
from .force_noise import add_force_noise
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    build_kernel_tables,
    compute_contact_columns,
    fade_frequency,
    lateral_hand_impedance,
    reduce_along,
    time_edges_in_arc_bands,
)
from .render_weights import render_weights
from .training_ranges import TrainingRanges

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class FieldConfig:
    """Architecture of F_Θ.

    Attributes
    ----------
    hidden, layers
        Units per layer H, and number of layers L.
    states
        Number of states N.
    accumulation
        How N outputs are summed. "past": the outputs at N past states, spacing_s apart, from one α head. "heads": N
        heads of one state (published), whose carriers lag by n Δt.
    spacing_s
        Distance of past states [s], a multiple of the action's sample period.
    carriers
        Noise bands whose amplitudes α holds.
    emission
        "log": α is an amplitude exp(head). "linear": α is the head (published).
    physics
        Add the linear contact to the inputs and, weighted by a learned skip per carrier, to the log-amplitude head.
    arc_knots
        Number of values of the α head for the arc carriers (bands of wavenumber κ along the path), spread evenly over
        log κ with linear interpolation between; 0 for one value per carrier. With one each, the few training strokes
        whose tone falls on a carrier alone decide its tones (up to 28 dB off on an unseen weave).
    action_octaves
        Octaves of the positional encoding of u(t), see features.encode_action.
    directed
        False for data without directions; the field then ignores the direction.
    line_gains
        Add an output for each tone of the token's lattice, see linear_contact.compute_line_power (a lattice, such as a
        weave, sounds at tones). Needs physics, log emission and arc carriers.
    stroke_frame
        Give the network the token in the frame of the stroke instead of token and direction, see
        features.rotate_to_stroke_frame.
    force_noise
        Add friction's force noise and the response of the probe's body to the emission, see
        linear_contact.add_force_noise. Fields of recordings have learned both.

    Raises
    ------
    ValueError
        If past states are not a multiple of the action's sample period apart, or spacing_s exceeds a second.
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
    force_noise: bool = False

    def __post_init__(self) -> None:
        if self.accumulation != "past":
            if not 0.0 <= self.spacing_s <= 1.0:
                raise ValueError(f"spacing_s must lie between 0 and 1, not {self.spacing_s:g}")
            return
        steps = self.spacing_s * ACTION_RATE_HZ
        if not 0.5 < steps < ACTION_RATE_HZ + 0.5 or abs(steps - round(steps)) > 1e-9 * steps:
            step, spacing = 1.0 / ACTION_RATE_HZ, self.spacing_s
            raise ValueError(f"spacing_s must lie between 0 and 1, a whole multiple of {step:g} s, not {spacing:g}")

    @staticmethod
    def published(hidden: int = 1024, layers: int = 4) -> FieldConfig:
        """Return the paper's literal model: N heads and one constant carrier."""
        constant = Carriers(time_edges_hz=(), arc_octaves=0, constant=True)
        return FieldConfig(hidden, layers, 5, "heads", 0.0, constant, "linear", False, 0)

    @property
    def alpha_heads(self) -> int:
        """Number of α heads: N with "heads" accumulation, else 1."""
        return self.states if self.accumulation == "heads" else 1

    @property
    def stride(self) -> int:
        """Number of action samples (200 Hz) between neighbouring past states."""
        return round(self.spacing_s * ACTION_RATE_HZ)

    @property
    def alpha_outputs(self) -> int:
        """Number of values of one α head."""
        saved = self.carriers.arc_count - self.arc_knots if self.arc_knots and self.carriers.arc_count else 0
        return self.carriers.count - saved + (LINE_GAIN_COUNT if self.line_gains else 0)

    def expansion(self) -> NDArray[np.float32] | None:
        """Return the interpolation (Ka, arc_knots) from α head to arc carriers; None with a value per carrier."""
        count = self.carriers.arc_count
        if not self.arc_knots or not count:
            return None
        position = np.linspace(0.0, self.arc_knots - 1.0, count)
        return np.maximum(1.0 - np.abs(position[:, None] - np.arange(self.arc_knots)), 0.0).astype(np.float32)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return name and shape of every parameter; weight matrices are (outputs, inputs)."""
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
    """The field F_Θ: a trained or initial network with its architecture.

    Attributes
    ----------
    config
        Architecture.
    parameters
        float32 arrays by their names in FieldConfig.shapes.
    ranges
        Ranges of speed, force and materials that the field was trained on, None if untrained.
    metadata
        Training data, seed, metrics and licence, as text.
    identity
        Content hash of the weights file, UNTRAINED if there is none; see is_same_field.
    """

    config: FieldConfig
    parameters: Mapping[str, NDArray[np.float32]]
    ranges: TrainingRanges | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    identity: str = UNTRAINED

    @cached_property
    def layers(self) -> Layers:
        """Weights of layers and heads in the memory layout of the compiled kernel, packed once."""
        names = [*(f"layer{index}" for index in range(self.config.layers)), "alpha", "sigma"]
        weights, biases = ([self.parameters[f"{name}.{part}"] for name in names] for part in ("weight", "bias"))
        return Layers(weights, biases)


def is_same_field(first: Field, second: Field) -> bool:
    """Return True if both fields give the same results.

    All unsaved fields have one identity, so they are equal only if they are one object.
    """
    return first is second or (first.identity == second.identity and first.identity != UNTRAINED)


@dataclass(frozen=True)
class Emission:
    """Output of F_Θ at n states of the hand.

    alpha: (n, heads, K + tones) amplitudes per carrier, 0 at rest and out of contact, then of the tones of the lines
    that the condition names. sigma_dt: (n, N) ≥ 0, densities times Δt of the N past states.
    """

    alpha: Float
    sigma_dt: Float

    def rows(self, rows: slice) -> Emission:
        """Return the output at some of the states, as views."""
        return Emission(self.alpha[rows], self.sigma_dt[rows])

    def assign(self, rows: NDArray[np.bool_], values: Emission) -> None:
        """Assign the outputs `values` to the states selected by the mask `rows` (n,), in place."""
        self.alpha[rows], self.sigma_dt[rows] = values.alpha, values.sigma_dt


def concatenate_emissions(emissions: Sequence[Emission]) -> Emission:
    """Concatenate field outputs along the axis of states."""
    return Emission(
        np.concatenate([emission.alpha for emission in emissions]),
        np.concatenate([emission.sigma_dt for emission in emissions]),
    )


NetworkOutput = tuple[Float32, Float32]
"""Outputs of the α head and of the σ head, (n, …) each."""
NetworkFn = Callable[[Float32], NetworkOutput]
"""Function from network inputs (n, D) to the heads' outputs."""
LOG_AMPLITUDE_CEILING = 6.0
"""Largest log amplitude; its exponential, 400 m/s² in one band, is far above any touch and far below overflow."""
PAST_DENSITY = 2.3
"""Initial σΔt of each past state: 90 % of the weight on the present, 9 % on 10 ms ago.

Against simulated strokes that stop and turn five times a second the envelope errs by 6 % (sandpaper) and 10 %
(leather); with 0.69, a longer memory, by 10 % and 13 %.
"""


def evaluate(model: Field, condition: Condition, network: NetworkFn | NetworkOutput | None = None) -> Emission:
    """Evaluate F_Θ at n states.

    Parameters
    ----------
    model
        The field.
    condition
        The n states of the hand, with the materials touched.
    network
        Replacement of the field's network: a function, or its outputs. None for the network itself.

    Returns
    -------
    Emission
        Amplitudes and densities, computed in float32 as in torch.
    """
    emission, carriers = _evaluate_contact(model, condition, network), model.config.carriers
    if not model.config.force_noise:
        return emission
    alpha = reduce_along(emission.alpha, condition, carriers)
    return Emission(add_force_noise(alpha, condition, carriers), emission.sigma_dt)


def _evaluate_contact(model: Field, condition: Condition, network: NetworkFn | NetworkOutput | None) -> Emission:
    """Evaluate what F_Θ has learned, by the compiled kernel if it supports the field."""
    config, parameters, kernel = model.config, model.parameters, find_kernel(model)
    if network is None:
        network = get_network(model)
    if kernel is None:
        return _evaluate_numpy(model, condition, network if callable(network) else lambda _: network)
    emitter = get_emitter(config, parameters["skip"].tobytes(), condition.probe, LOG_AMPLITUDE_CEILING)
    if callable(network) or _has_tones(config, condition):
        run = network if callable(network) else lambda _: network
        alpha, sigma = evaluate_compiled(kernel, emitter, condition, run)
    else:
        alpha, sigma = decode_outputs(kernel, emitter, condition, network[0]), network[1]
    return Emission(alpha[:, None, :], np.logaddexp(0.0, sigma.astype(np.float64)))


def _has_tones(config: FieldConfig, condition: Condition) -> bool:
    """Return True if the field gives the tones of the condition's lines apart from its carriers."""
    return condition.lines is not None and config.line_gains


Evaluator = Callable[[Field, Condition], Emission]
"""Function that evaluates a field at n states: `evaluate`, or a replacement such as a table."""
BATCH_STATES = 512
"""States in a batch of evaluate_batched: enough for every core, with 6 MB of intermediate results."""


def evaluate_batched(model: Field, condition: Condition, evaluator: Evaluator = evaluate) -> Emission:
    """Evaluate F_Θ at any number of states, BATCH_STATES at a time; `evaluator` evaluates one batch."""
    if len(condition.speed) <= BATCH_STATES:
        return evaluator(model, condition)
    starts = range(0, len(condition.speed), BATCH_STATES)
    return concatenate_emissions(
        [evaluator(model, condition.rows(slice(start, start + BATCH_STATES))) for start in starts]
    )


def accumulate(config: FieldConfig, emission: Emission, first: int = 0) -> Float:
    """Weight the outputs of past states to amplitudes (n − first, heads, K) at each state from `first` on.

    Parameters
    ----------
    config
        Architecture.
    emission
        Output of F_Θ at all n states, evenly sampled at the action rate.
    first
        First state of the result; earlier states only contribute as past states.

    Returns
    -------
    ndarray
        For "past" accumulation one head, else N heads, whose carriers lag by n Δt.

    Notes
    -----
    "past": Σ_n w_n α(u_{i − n·stride}), with σ_n of the same past state. Before the first state nothing is emitted,
    and σ is that of the first state. "heads": w_n α_n of each state. The weights are those of
    render_weights.render_weights.
    """
    if config.accumulation == "heads":
        return np.asarray(render_weights(emission.sigma_dt[first:])[:, :, None] * emission.alpha[first:])
    alpha, lags = emission.alpha[:, 0], config.stride * np.arange(config.states)
    past_row = np.maximum(np.arange(first, len(alpha))[:, None] - lags, 0)
    weights = render_weights(emission.sigma_dt[past_row, np.arange(config.states)])
    amplitude = weights[:, :1] * alpha[first:]
    buffer = np.empty_like(amplitude)
    for state, lag in enumerate(lags[1:], 1):
        begin = max(lag - first, 0)
        if begin < len(amplitude):
            past = alpha[first + begin - lag : len(alpha) - lag]
            amplitude[begin:] += np.multiply(weights[begin:, state, None], past, out=buffer[begin:])
    return np.asarray(amplitude[:, None, :])


def steady_amplitude(config: FieldConfig, emission: Emission) -> Float:
    """Compute the amplitudes (n, heads, K) of states that last longer than N past states reach back."""
    weights = render_weights(emission.sigma_dt)
    if config.accumulation == "heads":
        return np.asarray(weights[:, :, None] * emission.alpha)
    return np.asarray(weights.sum(axis=1)[:, None, None] * emission.alpha)


def initial_parameters(config: FieldConfig, seed: int) -> dict[str, NDArray[np.float32]]:
    """Draw initial parameters: He initialisation of the layers (He et al. 2015, eq. 10).

    With physics the heads start at 0, so that an untrained field gives the amplitudes of the linear contact. σΔt starts
    at PAST_DENSITY with "past" accumulation, at softplus(0) = 0.69 with "heads".
    """
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
    """Return the function inputs (n, D) → outputs of both heads, which runs F_Θ's layers in the kernel or in numpy."""
    kernel = find_kernel(model)
    run_layers = (
        partial(run_network, model.parameters, model.config.layers)
        if kernel is None
        else partial(model.layers.evaluate, kernel)
    )

    def evaluate_layers(x: Float32) -> NetworkOutput:
        add_work("states", len(x))
        return run_layers(x)

    return evaluate_layers


BATCH_ROWS = 96
"""Largest number of states in a batch. Batches are even in number and equal in size, so that two cores finish
together."""
MIN_THREADED_MULTIPLICATIONS = 1 << 26
"""Fewest multiplications for which threads pay: about a millisecond of one core."""


def run_network(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """Evaluate the layers in numpy: outputs of the α head and the σ head, (n, …) each, for inputs x (n, D)."""
    batches = np.array_split(x, 2 * -(-len(x) // (2 * BATCH_ROWS))) if len(x) > BATCH_ROWS else [x]
    multiplications = len(x) * sum(value.size for value in parameters.values() if value.ndim == 2)
    with single_blas_thread():
        if len(batches) > 1 and multiplications > MIN_THREADED_MULTIPLICATIONS:
            with ThreadPoolExecutor(min(len(batches), available_cpus())) as pool:
                outputs = list(pool.map(lambda batch: _forward(parameters, layers, batch), batches))
        else:
            outputs = [_forward(parameters, layers, batch) for batch in batches]
    return np.concatenate([alpha for alpha, _ in outputs]), np.concatenate([sigma for _, sigma in outputs])


def _forward(parameters: Mapping[str, Float32], layers: int, hidden: Float32) -> tuple[Float32, Float32]:
    """Evaluate the layers and both heads for one batch of inputs (n, D)."""
    for layer in range(layers):
        hidden = hidden @ parameters[f"layer{layer}.weight"].T
        hidden += parameters[f"layer{layer}.bias"]
        np.maximum(hidden, 0.0, out=hidden)
    alpha, sigma = (hidden @ parameters[f"{head}.weight"].T + parameters[f"{head}.bias"] for head in ("alpha", "sigma"))
    return alpha, sigma


def _evaluate_numpy(model: Field, condition: Condition, network: NetworkFn) -> Emission:
    """Evaluate F_Θ in numpy, for fields of any form; gives what the compiled kernel gives."""
    config, parameters = model.config, model.parameters
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
    prior, line_columns = np.split(inputs.prior, [config.carriers.count], axis=1)
    tones, lines, arcs = None, condition.lines, config.carriers.arc_count
    if lines is not None and gains is not None:
        level, low = np.split(line_columns, [2 * LINE_COUNT], axis=1)
        power = np.exp(2.0 * level).reshape(len(head), 2, LINE_COUNT)
        tones = take_tones(gains, power, low.astype(np.intp), lines, arcs, LOG_AMPLITUDE_CEILING)
        frequency = lines.compute_tone_wavenumbers() * np.maximum(condition.speed, SPEED_FLOOR_M_S)[:, None]
        tones *= fade_frequency(frequency) * motion_gate(condition)[:, None]
        with np.errstate(divide="ignore"):  # What is taken has no level.
            line_columns = np.concatenate([0.5 * np.log(power.reshape(len(head), -1)), low], axis=1)
    expansion, first = config.expansion(), config.carriers.arc_slice.start
    if expansion is not None:
        alpha = np.concatenate([alpha[..., :first], alpha[..., first:] @ expansion.T], axis=-1)
    if config.physics:
        alpha = alpha + (parameters["skip"] * prior)[:, None, :]
    if config.emission == "log":
        alpha = np.exp(np.minimum(alpha, LOG_AMPLITUDE_CEILING))
    if gains is not None:
        line_power = compute_line_power(gains, line_columns, config.carriers.arc_count, LOG_AMPLITUDE_CEILING)
        alpha[:, 0, config.carriers.arc_slice] = np.sqrt(np.square(alpha[:, 0, config.carriers.arc_slice]) + line_power)
    alpha *= inputs.gate[:, None, :]
    if tones is not None and lines is not None:
        scatter = _get_pitch_scatter(condition)
        gather_sidebands(alpha[:, 0, config.carriers.arc_slice], tones, lines, scatter, config.carriers)
        alpha = np.concatenate([alpha, tones[:, None, :]], axis=-1)
    return Emission(alpha, np.logaddexp(0.0, sigma.astype(np.float64)))


def find_kernel(model: Field) -> CDLL | None:
    """Return the compiled library if it supports this field, else None.

    With the kernel the result of a state does not depend on the batch it is in, to the last bit.
    """
    return load_kernel() if kernel_supports(model.config) and model.parameters["skip"].dtype == np.float32 else None


def kernel_supports(config: FieldConfig) -> bool:
    """Return True if the compiled kernel supports fields of this architecture."""
    carriers = config.carriers
    has_shipped_form = (
        config.physics and config.emission == "log" and config.alpha_heads == 1 and not config.action_octaves
    )
    return has_shipped_form and not carriers.constant and carriers.time_count > 0 and carriers.arc_count > 0


def evaluate_compiled(
    kernel: CDLL, emitter: EmissionTables, condition: Condition, network: Callable[[Float32], tuple[Float32, Float32]]
) -> tuple[Float, Float32]:
    """Evaluate F_Θ by the compiled kernel: α (n, K), and the σ head's outputs (n, N).

    network: function inputs (n, D) → outputs of α head and σ head, (n, …) each.
    """
    tokens, motion, touch = _state_columns(condition)
    fixed = np.array([encode_fixed_inputs(mechanics, condition.probe) for mechanics in condition.mechanics])
    x, prior = compiled_field.compute_inputs(kernel, emitter, tokens, fixed[condition.material], motion, touch)
    head, sigma = network(x)
    head, lines = np.ascontiguousarray(head, dtype=np.float32), condition.lines
    if lines is None or not emitter.has_line_gains:
        return compiled_field.decode_head(kernel, emitter, head, motion, prior), sigma
    arrays = ToneArrays(
        emitter, lines.column, lines.pitch_wavenumber, lines.wavenumber, _get_pitch_scatter(condition)
    )  # fmt: skip
    compiled_field.take_tones(kernel, emitter, head, motion, prior, arrays)
    alpha = compiled_field.decode_head(kernel, emitter, head, motion, prior)
    compiled_field.gather_sidebands(kernel, emitter, arrays, alpha)
    return np.concatenate([alpha, arrays.tones], axis=1), sigma


def _get_pitch_scatter(condition: Condition) -> Float:
    """Return the scatter of pitch (n,) of the material of each state [m]."""
    return np.array([properties.pitch_scatter_m or 0.0 for properties in condition.mechanics])[condition.material]


def decode_outputs(kernel: CDLL, emitter: EmissionTables, condition: Condition, head: Float32) -> Float:
    """Compute the amplitudes α (n, K) from known outputs of the α head (n, outputs), without running the network."""
    return compiled_field.decode_known_head(
        kernel, emitter, *_state_columns(condition), np.ascontiguousarray(head, dtype=np.float32)
    )


@lru_cache(maxsize=16)
def get_emitter(config: FieldConfig, skip: bytes, probe: str, ceiling: float) -> EmissionTables:
    """Return the kernel's tables of a field, cached.

    skip: weight of the linear contact's log amplitude per carrier, the parameter's float32 bytes. ceiling: largest log
    amplitude.
    """
    carriers = config.carriers
    shift, scale = token_normalisation()
    knots = config.arc_knots or carriers.arc_count
    position = np.linspace(0.0, knots - 1.0, carriers.arc_count)
    knot = np.minimum(position.astype(np.int64), max(knots - 2, 0))
    return EmissionTables(
        build_kernel_tables(carriers, *lateral_hand_impedance(get_probe(probe))), token_shift=shift, token_scale=scale,
        time_edge=time_edges_in_arc_bands(carriers), skip=np.frombuffer(skip, dtype=np.float32).astype(np.float64),
        knot=knot, knot_share=position - knot, harmonic_shift=np.array(HARMONIC_SHIFTS),
        harmonic_start=np.array(HARMONIC_START_LOG), inputs=input_size(carriers, config.physics),
        fixed_at=MECHANICS_COLUMN, fixed=DIRECTION_COLUMN - MECHANICS_COLUMN, direction_at=DIRECTION_COLUMN,
        outputs=config.alpha_outputs, stroke_frame=config.stroke_frame, directed=config.directed,
        line_gains=config.line_gains, quiet_power=AMPLITUDE_FLOOR_M_S2**2, quiet_line_power=LINE_FLOOR_M_S2**2,
        time_share=10.0 ** (TIME_SHARE_DB / 10.0), ceiling=ceiling, pace=REFERENCE_SPEED_M_S,
        pitch=REFERENCE_RESONANCE_HZ,
    )  # fmt: skip


def encode_fixed_inputs(mechanics: Mechanics, probe: str) -> tuple[float, ...]:
    """Return the network inputs that depend on mechanics and probe alone; they start at column MECHANICS_COLUMN."""
    kind = get_probe(probe).kind
    return (*encode_mechanics(mechanics), *(float(name == kind) for name in PROBE_KINDS))


def _state_columns(condition: Condition) -> tuple[Float, Float, Float]:
    """Return what the kernel needs of n states: tokens (n, TOKEN_DIM), motion (n, 7) and contact (n, 9).

    Columns of the last two are MOTION_COLUMNS and CONTACT_COLUMNS.
    """
    touch, resonance = compute_contact_columns(condition)
    motion = np.empty((len(resonance), len(compiled_field.MOTION_COLUMNS)))
    motion[:, :2] = condition.direction
    np.maximum(condition.speed, SPEED_FLOOR_M_S, out=motion[:, 2])
    np.maximum(condition.force, FORCE_FLOOR_N, out=motion[:, 3])
    motion[:, 4], motion[:, 5], motion[:, 6] = touch["mass"], resonance, motion_gate(condition)
    columns = np.stack([touch[name] for name in CONTACT_COLUMNS], axis=1)
    return np.ascontiguousarray(condition.tokens, dtype=np.float64), motion, columns
