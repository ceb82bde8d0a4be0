"""F_Θ at many states by the compiled kernel, for fields of the shipped form: the twin in C of what field.py does."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CDLL
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..kernel import emission as compiled
from ..kernel.contact import TOUCH
from ..kernel.emission import Emitter
from ..material.mechanics import Mechanics
from .config import FieldConfig
from .features import (
    DIRECTION_AT,
    MECHANICS_AT,
    PACE_M_S,
    PITCH_HZ,
    PROBE_NAMES,
    QUIET_M_S2,
    TIME_SHARE_DB,
    input_size,
    mechanics_columns,
    moving,
    token_scale,
)
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    contact_columns,
    lateral_hand_impedance,
    time_edges,
)
from .linear_texture import kernel_tables
from .lines import QUIET_LINE_M_S2, SHIFTS, START_LOG

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


def fits(config: FieldConfig) -> bool:
    """Whether the kernel knows a field of this form."""
    carriers = config.carriers
    shipped = config.physics and config.emission == "log" and config.alpha_heads == 1 and not config.action_octaves
    return shipped and not carriers.constant and carriers.time_count > 0 and carriers.arc_count > 0


@lru_cache(maxsize=16)
def emitter_of(config: FieldConfig, skip: bytes, probe: str, ceiling: float) -> Emitter:
    """skip: the parameter's float32 numbers. ceiling: of a log amplitude."""
    carriers = config.carriers
    shift, scale = token_scale()
    knots = config.arc_knots or carriers.arc_count
    place = np.linspace(0.0, knots - 1.0, carriers.arc_count)
    knot = np.minimum(place.astype(np.int64), max(knots - 2, 0))
    return Emitter(
        kernel_tables(carriers, *lateral_hand_impedance(probe)), token_shift=shift, token_scale=scale,
        time_edge=time_edges(carriers),
        skip=np.frombuffer(skip, dtype=np.float32).astype(np.float64), knot=knot, knot_share=place - knot,
        harmonic_shift=np.array(SHIFTS), harmonic_start=np.array(START_LOG),
        inputs=input_size(carriers, config.physics), fixed_at=MECHANICS_AT, fixed=DIRECTION_AT - MECHANICS_AT,
        direction_at=DIRECTION_AT, outputs=config.alpha_outputs, stroke_frame=config.stroke_frame,
        directed=config.directed, line_gains=config.line_gains, quiet_power=QUIET_M_S2**2,
        quiet_line_power=QUIET_LINE_M_S2**2, time_share=10.0 ** (TIME_SHARE_DB / 10.0), ceiling=ceiling, pace=PACE_M_S,
        pitch=PITCH_HZ,
    )  # fmt: skip


def fixed_inputs(mechanics: Mechanics, probe: str) -> tuple[float, ...]:
    """Of a material under a probe, what no state changes: inputs from MECHANICS_AT on."""
    return (*mechanics_columns(mechanics), *(float(name == probe) for name in PROBE_NAMES))


def emission(
    kernel: CDLL, emitter: Emitter, condition: Condition, answer: Callable[[Float32], tuple[Float32, Float32]]
) -> tuple[Float, Float32]:
    """alpha (n, K), and what the σ head answers. answer: inputs (n, D) → both heads' (n, …)."""
    tokens, motion, touch = _states(condition)
    known = np.array([fixed_inputs(each, condition.probe) for each in condition.mechanics])
    x, expected = compiled.inputs(kernel, emitter, tokens, known[condition.material], motion, touch)
    head, sigma = answer(x)
    return compiled.emitted(kernel, emitter, np.ascontiguousarray(head, dtype=np.float32), motion, expected), sigma


def answered(kernel: CDLL, emitter: Emitter, condition: Condition, head: Float32) -> Float:
    """alpha (n, K) of what the α head has answered (n, outputs)."""
    return compiled.answered(kernel, emitter, *_states(condition), np.ascontiguousarray(head, dtype=np.float32))


def _states(condition: Condition) -> tuple[Float, Float, Float]:
    """Of n states: tokens (n, TOKEN_DIM), and the columns MOTION and TOUCH."""
    touch, resonance = contact_columns(condition)
    motion = np.empty((len(resonance), len(compiled.MOTION)))
    motion[:, :2] = condition.direction
    np.maximum(condition.speed, SPEED_FLOOR_M_S, out=motion[:, 2])
    np.maximum(condition.force, FORCE_FLOOR_N, out=motion[:, 3])
    motion[:, 4], motion[:, 5], motion[:, 6] = touch["mass"], resonance, moving(condition)
    columns = np.stack([touch[name] for name in TOUCH], axis=1)
    return np.ascontiguousarray(condition.tokens, dtype=np.float64), motion, columns
