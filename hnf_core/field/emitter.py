"""F_Θ at many states by the compiled kernel, for fields of the shipped form: the twin in C of what field.py does."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CDLL
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..kernel import emission as compiled
from ..kernel.contact import CONTACT_COLUMNS
from ..kernel.emission import EmissionTables
from ..material.mechanics import Mechanics
from .config import FieldConfig
from .features import (
    AMPLITUDE_FLOOR_M_S2,
    DIRECTION_COLUMN,
    MECHANICS_COLUMN,
    PROBE_NAMES,
    REFERENCE_RESONANCE_HZ,
    REFERENCE_SPEED_M_S,
    TIME_SHARE_DB,
    encode_mechanics,
    input_size,
    motion_gate,
    token_normalisation,
)
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    compute_contact_columns,
    lateral_hand_impedance,
    time_edges_in_arc_bands,
)
from .linear_texture import build_kernel_tables
from .lines import HARMONIC_SHIFTS, HARMONIC_START_LOG, LINE_FLOOR_M_S2

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


def kernel_supports(config: FieldConfig) -> bool:
    """Whether the kernel knows a field of this form."""
    carriers = config.carriers
    shipped = config.physics and config.emission == "log" and config.alpha_heads == 1 and not config.action_octaves
    return shipped and not carriers.constant and carriers.time_count > 0 and carriers.arc_count > 0


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
        inputs=input_size(carriers, config.physics), fixed_at=MECHANICS_COLUMN, fixed=DIRECTION_COLUMN - MECHANICS_COLUMN,
        direction_at=DIRECTION_COLUMN, outputs=config.alpha_outputs, stroke_frame=config.stroke_frame,
        directed=config.directed, line_gains=config.line_gains, quiet_power=AMPLITUDE_FLOOR_M_S2**2,
        quiet_line_power=LINE_FLOOR_M_S2**2, time_share=10.0 ** (TIME_SHARE_DB / 10.0), ceiling=ceiling, pace=REFERENCE_SPEED_M_S,
        pitch=REFERENCE_RESONANCE_HZ,
    )  # fmt: skip


def encode_fixed_inputs(mechanics: Mechanics, probe: str) -> tuple[float, ...]:
    """Of a material under a probe, what no state changes: inputs from MECHANICS_AT on."""
    return (*encode_mechanics(mechanics), *(float(name == probe) for name in PROBE_NAMES))


def evaluate_compiled(
    kernel: CDLL, emitter: EmissionTables, condition: Condition, network: Callable[[Float32], tuple[Float32, Float32]]
) -> tuple[Float, Float32]:
    """alpha (n, K), and what the σ head answers. answer: inputs (n, D) → both heads' (n, …)."""
    tokens, motion, touch = _state_columns(condition)
    known = np.array([encode_fixed_inputs(each, condition.probe) for each in condition.mechanics])
    x, expected = compiled.compute_inputs(kernel, emitter, tokens, known[condition.material], motion, touch)
    head, sigma = network(x)
    return compiled.decode_head(kernel, emitter, np.ascontiguousarray(head, dtype=np.float32), motion, expected), sigma


def decode_outputs(kernel: CDLL, emitter: EmissionTables, condition: Condition, head: Float32) -> Float:
    """alpha (n, K) of what the α head has answered (n, outputs)."""
    return compiled.decode_known_head(
        kernel, emitter, *_state_columns(condition), np.ascontiguousarray(head, dtype=np.float32)
    )


def _state_columns(condition: Condition) -> tuple[Float, Float, Float]:
    """Of n states: tokens (n, TOKEN_DIM), and the columns MOTION and TOUCH."""
    touch, resonance = compute_contact_columns(condition)
    motion = np.empty((len(resonance), len(compiled.MOTION_COLUMNS)))
    motion[:, :2] = condition.direction
    np.maximum(condition.speed, SPEED_FLOOR_M_S, out=motion[:, 2])
    np.maximum(condition.force, FORCE_FLOOR_N, out=motion[:, 3])
    motion[:, 4], motion[:, 5], motion[:, 6] = touch["mass"], resonance, motion_gate(condition)
    columns = np.stack([touch[name] for name in CONTACT_COLUMNS], axis=1)
    return np.ascontiguousarray(condition.tokens, dtype=np.float64), motion, columns
