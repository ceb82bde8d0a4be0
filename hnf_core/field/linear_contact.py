"""The steady stroke to first order: what linear contact makes of a texture. Physics-shaped input of the field.

Three axes add in power, as DFT321 fuses them: the normal acceleration through contact.height_response; friction, which
carries μ times the same force fluctuation sideways; and the load leaning on the slopes, F ∇h / m, more so against the
motion, on a mass that the hand holds. A network fed with this has only hopping, creep and saturation left to learn; the
bare token made it learn a shift of 200 bands with speed and direction, which a small ReLU net does badly.

The tones of a lattice, apart from the noise around them: what the linear contact expects, and a gain for each.

A weave, knurl or grating rings at κ |cos δ| v. One smooth correction over log κ, which suits noise, cannot silence one
such tone and keep its neighbour; a free value per arc carrier is learnt from the few strokes whose tone falls on it. So
each tone (two per token band, see linear_texture) has an output of its own that moves with it, and so have its second
and third harmonic, which hopping and friction make of a pure wave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..kernel import compiled_field as kernel_contact
from ..kernel.compiled_field import CONTACT_COLUMNS
from ..kernel.loader import load_kernel
from ..material.contact_model import (
    Mechanics,
    contact_radius,
    contact_stiffness,
    height_power,
    power_gain,
    resonance_hz,
    tip_gain,
    tip_response,
    with_defaults,
)
from ..material.probe import PROBES
from ..material.token import BAND_WAVELENGTHS_M
from .carriers import ARC_PER_OCTAVE, Carriers
from .surface_spectrum import add_at, build_kernel_tables, compute_surface_spectrum, project_lines, project_noise

Float = NDArray[np.float64]

LINE_COUNT = 2 * len(BAND_WAVELENGTHS_M)
HARMONICS = (1, 2, 3)
HARMONIC_START_DB = (0.0, -25.0, -30.0)
"""Level of a harmonic beside the tone, before training."""
HARMONIC_SHIFTS = tuple(round(ARC_PER_OCTAVE * float(np.log2(harmonic))) for harmonic in HARMONICS)
HARMONIC_START_LOG = tuple(level * np.log(10.0) / 20.0 for level in HARMONIC_START_DB)
LINE_GAIN_COUNT = LINE_COUNT * len(HARMONICS)
"""Outputs of the α head for tones: by harmonic, then by line."""
LINE_FLOOR_M_S2 = 1e-5


@dataclass(frozen=True)
class SpectralLines:
    """power: (2, n, LINES) acceleration power [(m/s²)²] in the two arc carriers about each tone. low: (n, LINES) index
    of the lower one; it may lie outside the carriers."""

    power: Float
    low: NDArray[np.intp]


def encode_line_prior(lines: SpectralLines) -> Float:
    """(n, 3 LINES) appended to the prior: log amplitude in the lower and in the upper of the two carriers about each
    tone, then the lower one's index."""
    level = 0.5 * np.log(lines.power + LINE_FLOOR_M_S2**2)
    return np.concatenate([level[0], level[1], lines.low.astype(np.float64)], axis=1)


def compute_line_power(gains: Float, columns: Float, count: int, ceiling: float) -> Float:
    """Power per arc carrier (n, count) of tones with log gains (n, GAINS) and prior_columns (n, 3 LINES).

    ceiling: of a log amplitude.
    """
    rows = np.broadcast_to(np.arange(len(gains))[:, None], (len(gains), LINE_COUNT))
    low = columns[:, 2 * LINE_COUNT :].astype(np.intp)
    out = np.zeros((len(gains), count))
    for order, (shift, start) in enumerate(zip(HARMONIC_SHIFTS, HARMONIC_START_LOG, strict=True)):
        gain = gains[:, order * LINE_COUNT : (order + 1) * LINE_COUNT] + start
        for tap in range(2):
            power = np.exp(2.0 * np.minimum(gain + columns[:, tap * LINE_COUNT : (tap + 1) * LINE_COUNT], ceiling))
            index = low + (shift + tap)
            inside = (index >= 0) & (index < count)
            np.add.at(out, (rows[inside], index[inside]), power[inside])
    return out


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
    lines: SpectralLines


def arc_gain(wavenumber: Float, speed: Float) -> Float:
    """Fade of an arc carrier at f = κ v: out below 8 → 4 Hz (no drift) and above 4 → 4.8 kHz (no aliasing).

    wavenumber: (K,) cycles/m; speed: (n,) m/s. Returns (n, K).
    """
    frequency = speed[:, None] * wavenumber[None, :]
    return np.asarray(_smoothstep((frequency - 4.0) / 4.0) * upper_fade(frequency))


def upper_fade(frequency: Float) -> Float:
    """1 below 4 kHz, 0 from BAND_END_HZ on: no aliasing at the model rate."""
    return np.asarray(1.0 - _smoothstep((frequency - 4000.0) / (BAND_END_HZ - 4000.0)))


def compute_linear_contact(condition: Condition, carriers: Carriers) -> LinearContact:
    """Expected power of each state, as if it lasted; out of contact as at the force floor."""
    touch, resonance = compute_contact_columns(condition)
    compiled = load_kernel()
    if compiled is None:
        return _linear_contact_numpy(condition, carriers, touch, resonance)
    tokens = np.ascontiguousarray(condition.tokens, dtype=np.float64)
    columns = np.stack([touch[name] for name in CONTACT_COLUMNS], axis=1)
    tables = build_kernel_tables(carriers, *lateral_hand_impedance(condition.probe))
    found = kernel_contact.compute_linear_contact(compiled, tables, tokens, columns)
    return LinearContact(found.power, found.normal, resonance, found.noise, SpectralLines(found.lines, found.low))


def compute_contact_columns(condition: Condition) -> tuple[dict[str, Float], Float]:
    """Contact parameters (n,) of each state in SI units, by the names in TOUCH, and its resonance [Hz]."""
    probe, force = PROBES[condition.probe], np.maximum(condition.force, FORCE_FLOOR_N)
    radius, stiffness, damping, friction, resonance = np.zeros((5, len(force)))
    for index, mechanics in enumerate(condition.mechanics):
        # One row per distinct load of a material would do; rows are few, so each is computed.
        rows, known = np.flatnonzero(condition.material == index), with_defaults(mechanics)
        radius[rows] = contact_radius(mechanics, probe, force[rows])
        stiffness[rows] = contact_stiffness(mechanics, probe, force[rows])
        damping[rows] = 4.0 * known.damping_ratio**2 * stiffness[rows] * probe.mass_kg
        friction[rows] = known.friction
        resonance[rows] = resonance_hz(mechanics, probe, force[rows])
    sharp = np.square(1.0 - radius / probe.tip_radius_m)
    return {
        "angle": np.arctan2(condition.direction[:, 1], condition.direction[:, 0]),
        "speed": np.maximum(condition.speed, SPEED_FLOOR_M_S),
        "radius": radius,
        "stiffness": stiffness,
        "damping": damping,
        "mass": np.full(len(force), probe.mass_kg),
        "load_square": np.square(force / probe.mass_kg),
        "rubbed": 1.0 + np.square(friction),
        "flank": np.square(1.0 + FLANK_FRICTION * sharp) - 1.0,
    }, resonance


def lateral_hand_impedance(probe: str) -> tuple[float, float]:
    """(k / m, 4 ζ² k / m) of the hand that holds the probe sideways, rad²/s²."""
    hand = HAND_STIFFNESS_N_M / PROBES[probe].mass_kg
    return hand, 4.0 * HAND_DAMPING_RATIO**2 * hand


def _linear_contact_numpy(
    condition: Condition, carriers: Carriers, touch: dict[str, Float], resonance: Float
) -> LinearContact:
    """In numpy: what the kernel is tested against."""
    kappa, wave = carriers.arc_centres(), np.square(2.0 * np.pi * carriers.arc_centres())
    texture = compute_surface_spectrum(condition.tokens, condition.direction, carriers)
    speed, radius, stiffness, damping, mass, load_square, rubbed, flank = (
        touch[name][:, None] for name in CONTACT_COLUMNS[1:]
    )
    square = np.square(2.0 * np.pi * kappa * speed)
    hand, hand_damping = lateral_hand_impedance(condition.probe)
    lateral = np.square(square) / (np.square(hand - square) + hand_damping * square)
    fade = np.square(arc_gain(kappa, touch["speed"]))
    up, aside = power_gain(square, stiffness, damping, mass) * fade, lateral * load_square * fade
    passed, leaned = np.square(tip_gain(kappa, radius)), np.square(tip_gain(ASPERITY_SHARE * kappa, radius))
    weights = np.stack([passed, leaned * wave, leaned])
    height, slope, leaning = project_noise(texture, weights, carriers)
    normal = height * up
    noise = normal * rubbed + (slope + flank * wave * leaning) * aside
    # The same for the tones, each where it sounds.
    cut, low = project_lines(texture, weights, carriers)
    met, leant, climbed = np.moveaxis(cut, 1, 0)
    at = np.clip(low + np.arange(2)[:, None, None], 0, len(kappa) - 1)
    rows = np.arange(len(speed))[:, None]
    tone = met * up[rows, at]
    lines = SpectralLines(tone * rubbed + (leant + flank * climbed * wave[at]) * aside[rows, at], low)
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
    octaves = np.log2(np.maximum(speed, SPEED_FLOOR_M_S))[:, None]
    place = np.clip(time_edges_in_arc_bands(carriers) - ARC_PER_OCTAVE * octaves, 0.0, arc_power.shape[1])
    low = np.minimum(place.astype(int), arc_power.shape[1] - 1)
    rows = np.arange(len(arc_power))[:, None]
    at_edge = cumulative[rows, low] + (place - low) * (cumulative[rows, low + 1] - cumulative[rows, low])
    return np.asarray(np.diff(at_edge, axis=1))


def time_edges_in_arc_bands(carriers: Carriers) -> Float:
    """(Kt + 1,) arc bands from the first to the one that each edge in time meets at 1 m/s."""
    return np.asarray(ARC_PER_OCTAVE * np.log2(carriers.time_edges() / carriers.arc_start_per_m))


def _smoothstep(x: Float) -> Float:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
