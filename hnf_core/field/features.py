"""F_Θ's input: token, mechanics with known flags, probe, direction, log speed, log force, and the linear contact.

Mechanics do not show in a picture (foam and stone give the same map), so they are inputs of their own, each with a
flag that says whether it is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact import height_response, tip_response, with_defaults
from ..material.mechanics import PROBES, Mechanics
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, TOKEN_DIM
from .carriers import ARC_PER_OCTAVE, Carriers
from .linear_texture import cut_band_power

Float = NDArray[np.float64]

SPEED_FLOOR_M_S = 1e-3
"""Below it the input stops at the floor and the emission falls linearly, so that v → 0 is defined and silent."""
FORCE_FLOOR_N = 0.02
QUIET_M_S2 = 2e-4
"""Amplitude per band below which the linear prediction is not told from silence."""
TIME_SHARE_DB = -20.0
"""Where the time carriers start beside the arc carriers: geometry belongs to arc length until data say otherwise."""
PROBE_NAMES = tuple(PROBES)


@dataclass(frozen=True)
class Condition:
    """States at which the field is evaluated, n of them.

    tokens: (n, TOKEN_DIM). mechanics: one per material; material: (n,) its index at each state. direction: (n, 2).
    speed, force: (n,). contact: (n,) bool. probe: name.
    """

    tokens: Float
    mechanics: tuple[Mechanics, ...]
    material: NDArray[np.int32]
    direction: Float
    speed: Float
    force: Float
    contact: NDArray[np.bool_]
    probe: str


@dataclass(frozen=True)
class Inputs:
    """x: (n, D) network input. prior: (n, K) log amplitude per carrier of the linear contact. gate: (n, K) factor
    0 … 1 on the emission: 0 at rest, out of contact, and where an arc carrier leaves the band."""

    x: Float
    prior: Float
    gate: Float


def input_size(carriers: Carriers, physics: bool) -> int:
    return TOKEN_DIM + 6 + len(PROBE_NAMES) + 4 + (carriers.time_count if physics else 0)


def arc_gain(wavenumber: Float, speed: Float) -> Float:
    """Fade of an arc carrier at f = κ v: out below 8 → 4 Hz (no drift) and above 4 → 4.8 kHz (no aliasing).

    wavenumber: (K,) cycles/m; speed: (n,) m/s. Returns (n, K).
    """
    frequency = speed[:, None] * wavenumber[None, :]
    return np.asarray(_smoothstep((frequency - 4.0) / 4.0) * (1.0 - _smoothstep((frequency - 4000.0) / 800.0)))


def contact_band_power(height_power: Float, condition: Condition, carriers: Carriers) -> Float:
    """Height power per arc band [m²] → acceleration power per arc band [(m/s²)²] through tip and contact; (n, Ka)."""
    kappa = carriers.arc_centres()
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    out = np.zeros((len(speed), len(kappa)))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        probe, force = PROBES[condition.probe], np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        tip = tip_response(kappa, mechanics, probe, force)
        gain = np.abs(height_response(kappa * speed[rows, None], mechanics, probe, force))
        out[rows] = height_power[rows] * np.square(tip * gain * arc_gain(kappa, speed[rows]))
    return out


def time_band_power(arc_power: Float, speed: Float, carriers: Carriers) -> Float:
    """Power that falls into each time band when arc band k moves at speed v. (n, Ka), (n,) → (n, Kt)."""
    cumulative = np.concatenate([np.zeros((len(arc_power), 1)), np.cumsum(arc_power, axis=1)], axis=1)
    edges = carriers.time_edges()[None, :] / (np.maximum(speed, SPEED_FLOOR_M_S)[:, None] * carriers.arc_start_per_m)
    place = np.clip(ARC_PER_OCTAVE * np.log2(edges), 0.0, arc_power.shape[1])
    low = np.minimum(place.astype(int), arc_power.shape[1] - 1)
    rows = np.arange(len(arc_power))[:, None]
    at_edge = cumulative[rows, low] + (place - low) * (cumulative[rows, low + 1] - cumulative[rows, low])
    return np.asarray(np.diff(at_edge, axis=1))


def build_inputs(condition: Condition, carriers: Carriers, physics: bool) -> Inputs:
    """Evaluate inputs at every state; without physics, x ends at log force and prior is 0."""
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    force = np.maximum(condition.force, FORCE_FLOOR_N)
    moving = np.clip(condition.speed / SPEED_FLOOR_M_S, 0.0, 1.0) * np.clip(condition.force / FORCE_FLOOR_N, 0.0, 1.0)
    gate = np.where(condition.contact, moving, 0.0)
    columns = [
        normalised_tokens(condition.tokens),
        np.array([mechanics_columns(m) for m in condition.mechanics])[condition.material],
        np.tile([float(name == condition.probe) for name in PROBE_NAMES], (len(speed), 1)),
        condition.direction,
        np.log(speed / 0.1)[:, None],
        np.log(force)[:, None],
    ]
    prior = np.zeros((len(speed), carriers.count))
    gates = np.repeat(gate[:, None], carriers.count, axis=1)
    gates[:, carriers.arc_slice] *= arc_gain(carriers.arc_centres(), speed)
    if physics:
        arc_power = contact_band_power(
            cut_band_power(condition.tokens, condition.direction, carriers), condition, carriers
        )
        time_power = time_band_power(arc_power, speed, carriers)
        time_prior = log_amplitude(time_power)
        columns.append((time_prior + 5.0) / 3.0)
        prior[:, carriers.time_slice] = log_amplitude(time_power * 10.0 ** (TIME_SHARE_DB / 10.0))
        prior[:, carriers.arc_slice] = log_amplitude(arc_power)
    return Inputs(np.concatenate(columns, axis=1), prior, gates)


def log_amplitude(power: Float) -> Float:
    return np.asarray(0.5 * np.log(power + QUIET_M_S2**2))


def normalised_tokens(tokens: Float) -> Float:
    """(n, TOKEN_DIM) with every component of order 1."""
    bands, width = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
    scale, shift = np.ones(TOKEN_DIM), np.zeros(TOKEN_DIM)
    levels = np.arange(bands) * width
    shift[levels], scale[levels] = -6.0, 1.0 / 1.5
    scale[levels + BAND_FEATURES.index("offset")] = 2.0
    scale[bands * width :] = 0.5
    return np.asarray((np.asarray(tokens, dtype=np.float64) - shift) * scale)


def mechanics_columns(mechanics: Mechanics) -> tuple[float, ...]:
    """Normalised value and known flag of stiffness, damping and friction; the defaults stand for unknowns."""
    full = with_defaults(mechanics)
    known = [value is not None for value in (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)]
    values = (np.log(full.stiffness_n_m / 5e4) / 2.0, (full.damping_ratio - 0.2) / 0.2, (full.friction - 0.3) / 0.3)
    return tuple(float(item) for pair in zip(values, known, strict=True) for item in pair)


def _smoothstep(x: Float) -> Float:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
