"""The steady stroke to first order: what linear contact makes of a texture. Physics-shaped input of the field.

Three axes add in power, as DFT321 fuses them: the normal acceleration through contact.height_response; friction, which
carries μ times the same force fluctuation sideways; and the load leaning on the slopes, F ∇h / m, more so against the
motion, on a mass that the hand holds. A network fed with this has only hopping, creep and saturation left to learn; the
bare token made it learn a shift of 200 bands with speed and direction, which a small ReLU net does badly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact import contact_radius, height_power, resonance_hz, tip_response, with_defaults
from ..material.mechanics import Mechanics
from ..material.probe import PROBES
from .carriers import ARC_PER_OCTAVE, Carriers
from .linear_texture import add_at, cut_lines, cut_noise, texture_of
from .lines import Lines

Float = NDArray[np.float64]

SPEED_FLOOR_M_S = 1e-3
"""Below it the input stops at the floor and the emission falls linearly, so that v → 0 is defined and silent."""
FORCE_FLOOR_N = 0.02
BAND_END_HZ = 4800.0
"""Nothing that moves with the hand sounds above it; the model rate holds 5 kHz."""
HAND_STIFFNESS_N_M = 500.0
HAND_DAMPING_RATIO = 0.4
"""Lateral impedance of a hand that holds a tool (A. Z. Hajian & R. D. Howe 1997, J. Biomech. Eng. 119)."""
ASPERITY_SHARE = 0.5
"""Radius of the spots that carry the load, over the Hertz radius (J. F. Archard 1957): they meet the slopes."""
FLANK_FRICTION = 3.0
"""Rise of friction per unit of slope against the motion under a sharp tip, times (1 − a/R)² for a contact of radius a.
These four are the simulator's own constants (a test holds them equal)."""


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
class LinearContact:
    """power: (n, Ka) acceleration power [(m/s²)²] per arc band, all axes; normal: (n,) of the normal axis alone.
    resonance: (n,) Hz of probe on contact. noise: (n, Ka) power without the lattice's tones, which are lines."""

    power: Float
    normal: Float
    resonance: Float
    noise: Float
    lines: Lines


def arc_gain(wavenumber: Float, speed: Float) -> Float:
    """Fade of an arc carrier at f = κ v: out below 8 → 4 Hz (no drift) and above 4 → 4.8 kHz (no aliasing).

    wavenumber: (K,) cycles/m; speed: (n,) m/s. Returns (n, K).
    """
    frequency = speed[:, None] * wavenumber[None, :]
    return np.asarray(_smoothstep((frequency - 4.0) / 4.0) * upper_fade(frequency))


def upper_fade(frequency: Float) -> Float:
    """1 below 4 kHz, 0 from BAND_END_HZ on: no aliasing at the model rate."""
    return np.asarray(1.0 - _smoothstep((frequency - 4000.0) / (BAND_END_HZ - 4000.0)))


def linear_contact(condition: Condition, carriers: Carriers) -> LinearContact:
    """Expected power of each state, as if it lasted; out of contact as at the force floor."""
    kappa, probe = carriers.arc_centres(), PROBES[condition.probe]
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    force = np.maximum(condition.force, FORCE_FLOOR_N)
    texture = texture_of(condition.tokens, condition.direction, carriers)
    # One row per distinct load of a material would do; rows are few, so each is computed.
    passed, leaned, response = (np.zeros((len(speed), len(kappa))) for _ in range(3))
    friction, resonance, flank = (np.zeros(len(speed)) for _ in range(3))
    omega = 2.0 * np.pi * kappa * speed[:, None]
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero(condition.material == index)
        load = force[rows, None]
        passed[rows] = np.square(tip_response(kappa, mechanics, probe, load))
        leaned[rows] = np.square(tip_response(ASPERITY_SHARE * kappa, mechanics, probe, load))
        response[rows] = height_power(kappa * speed[rows, None], mechanics, probe, load)
        friction[rows] = with_defaults(mechanics).friction
        resonance[rows] = resonance_hz(mechanics, probe, force[rows])
        share = contact_radius(mechanics, probe, force[rows]) / probe.tip_radius_m
        flank[rows] = np.square(1.0 + FLANK_FRICTION * np.square(1.0 - share)) - 1.0
    hand = HAND_STIFFNESS_N_M / probe.mass_kg
    square = np.square(omega)
    lateral = np.square(square) / (np.square(hand - square) + 4.0 * HAND_DAMPING_RATIO**2 * hand * square)
    fade = np.square(arc_gain(kappa, speed))
    wave = np.square(2.0 * np.pi * kappa)
    up, aside = response * fade, lateral * np.square(force / probe.mass_kg)[:, None] * fade
    rubbed = 1.0 + np.square(friction)[:, None]
    height, slope, leaning = cut_noise(texture, np.stack([passed, leaned * wave, leaned]), carriers)
    normal = height * up
    noise = normal * rubbed + (slope + flank[:, None] * wave * leaning) * aside
    # The same for the tones, each where it sounds.
    met, low = cut_lines(texture, passed, carriers)
    leant = cut_lines(texture, leaned * wave, carriers)[0]
    climbed = flank[:, None] * cut_lines(texture, leaned, carriers)[0]
    at = np.clip(low + np.arange(2)[:, None, None], 0, len(kappa) - 1)
    rows = np.arange(len(speed))[:, None]
    tone = met * up[rows, at]
    lines = Lines(tone * rubbed + (leant + climbed * wave[at]) * aside[rows, at], low)
    power = noise.copy()
    for tap in range(2):
        add_at(power, low + tap, lines.power[tap])
        add_at(normal, low + tap, tone[tap])
    return LinearContact(power, normal.sum(axis=1), resonance, noise, lines)


def profile_band_power(height_spectrum: Float, condition: Condition, carriers: Carriers) -> Float:
    """Height power per arc band (Ka,) of a profile → acceleration power (n, Ka) along the normal; 0 out of contact."""
    kappa, probe = carriers.arc_centres(), PROBES[condition.probe]
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    out = np.zeros((len(speed), len(kappa)))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        load = np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        tip = tip_response(kappa, mechanics, probe, load)
        response = height_power(kappa * speed[rows, None], mechanics, probe, load)
        out[rows] = height_spectrum * response * np.square(tip * arc_gain(kappa, speed[rows]))
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


def _smoothstep(x: Float) -> Float:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
