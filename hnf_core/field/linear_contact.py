"""Linear contact: the vibration of a steady stroke to first order, from the material token. Physical prior of F_Θ.

The token holds the surface's height spectrum. Three axes add in power, as DFT321 combines them: the normal acceleration
through contact_model.height_response; friction, which carries μ times the same force fluctuation sideways; and the load
leaning on the slopes, F ∇h / m, more so against the motion, on a mass that the hand holds. With this input the network
has only hopping, creep and saturation left to learn; from the bare token it would have to learn a shift of 200 bands
with speed and direction, which a small ReLU net does badly.

The tones of a lattice are separated from the noise around them. A weave, knurl or grating sounds at κ |cos δ| v. One
smooth correction over log κ, which suits noise, cannot silence one tone and preserve its neighbour; a free value per
arc carrier is learned from the few strokes whose tone falls on it. So each tone (two per token band, see
surface_spectrum) and its second and third harmonic, which hopping and friction add to a pure wave, have an output of
their own that moves with the tone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
"""Initial level of each harmonic relative to the tone [dB]."""
HARMONIC_SHIFTS = tuple(round(ARC_PER_OCTAVE * float(np.log2(harmonic))) for harmonic in HARMONICS)
HARMONIC_START_LOG = tuple(level * np.log(10.0) / 20.0 for level in HARMONIC_START_DB)
LINE_GAIN_COUNT = LINE_COUNT * len(HARMONICS)
"""Outputs of the α head for tones: by harmonic, then by line."""
LINE_FLOOR_M_S2 = 1e-5


@dataclass(frozen=True)
class SpectralLines:
    """Tones of a regular surface (weave, knurl, grating) under n states of the hand.

    power: (2, n, LINE_COUNT) acceleration power [(m/s²)²] in the two arc carriers (bands along the path) on either side
    of each tone. low: (n, LINE_COUNT) index of the lower one, which may lie outside the carriers.
    """

    power: Float
    low: NDArray[np.intp]


def encode_line_prior(lines: SpectralLines) -> Float:
    """Return the tones as columns (n, 3 LINE_COUNT), which are appended to the prior of the network.

    Log amplitude in the lower and in the upper of the two carriers about each tone, then the index of the lower one.
    """
    level = 0.5 * np.log(lines.power + LINE_FLOOR_M_S2**2)
    return np.concatenate([level[0], level[1], lines.low.astype(np.float64)], axis=1)


def compute_line_power(gains: Float, columns: Float, count: int, ceiling: float) -> Float:
    """Compute the power of the tones per arc carrier, (n, count).

    gains: (n, LINE_GAIN_COUNT) learned log gains of the tones and their harmonics. columns: (n, 3 LINE_COUNT) of
    encode_line_prior. count: number of arc carriers. ceiling: largest log amplitude.
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
"""Lowest speed of the inputs [m/s]; below it the emission falls linearly, so that v → 0 is defined and silent."""
FORCE_FLOOR_N = 0.02
BAND_END_HZ = 4800.0
"""Highest frequency of everything that follows the hand's speed [Hz]; the model rate holds 5 kHz."""
HAND_STIFFNESS_N_M = 500.0
HAND_DAMPING_RATIO = 0.4
"""Lateral impedance of a hand that holds a tool (A. Z. Hajian & R. D. Howe 1997, J. Biomech. Eng. 119)."""
ASPERITY_SHARE = 0.5
"""Radius of the spots that carry the load, relative to the Hertz radius (J. F. Archard 1957); the slopes act on
them."""
FLANK_FRICTION = 3.0
"""Rise of friction per unit of slope against the motion under a sharp tip, times (1 − a/R)² for a contact of radius a.

This and the three constants above are equal to the simulator's (checked by a test).
"""


@dataclass(frozen=True)
class Condition:
    """Inputs of the field at n states: motion and force of the hand, and the materials touched.

    Attributes
    ----------
    tokens
        (n, TOKEN_DIM) material token at each state.
    mechanics
        Stiffness, damping and friction, one per material.
    material
        (n,) index of each state's material.
    direction
        (n, 2) unit vectors.
    speed, force
        (n,) [m/s] and pressing force [N].
    contact
        (n,) bool.
    probe
        Name of the probe.
    """

    tokens: Float
    mechanics: tuple[Mechanics, ...]
    material: NDArray[np.int32]
    direction: Float
    speed: Float
    force: Float
    contact: NDArray[np.bool_]
    probe: str

    def rows(self, rows: slice | NDArray[np.bool_]) -> Condition:
        """Return the condition of some of the states, with the mechanics of all materials."""
        names = ("tokens", "material", "direction", "speed", "force", "contact")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True)
class LinearContact:
    """Vibration that the linear contact predicts at n states of the hand.

    Attributes
    ----------
    power
        (n, Ka) acceleration power per arc band, of all axes [(m/s²)²].
    normal
        (n,) power of the normal axis alone [(m/s²)²].
    resonance
        (n,) resonance of the probe's mass on the contact's stiffness [Hz].
    noise
        (n, Ka) power per arc band without the tones [(m/s²)²].
    lines
        The tones of a regular surface.
    """

    power: Float
    normal: Float
    resonance: Float
    noise: Float
    lines: SpectralLines


def arc_gain(wavenumber: Float, speed: Float) -> Float:
    """Compute the fade (n, K) of arc carriers at f = κ v: 0 below 4 Hz (no drift) and above 4.8 kHz (no aliasing).

    wavenumber: (K,) [cycles/m]. speed: (n,) [m/s]. The gain is 1 between 8 Hz and 4 kHz.
    """
    frequency = speed[:, None] * wavenumber[None, :]
    return np.asarray(_smoothstep((frequency - 4.0) / 4.0) * upper_fade(frequency))


def upper_fade(frequency: Float) -> Float:
    """Compute the fade that is 1 below 4 kHz and 0 from BAND_END_HZ on, which prevents aliasing at the model rate."""
    return np.asarray(1.0 - _smoothstep((frequency - 4000.0) / (BAND_END_HZ - 4000.0)))


def compute_linear_contact(condition: Condition, carriers: Carriers) -> LinearContact:
    """Compute the power that the linear contact predicts at each of n states, as if the hand stayed in that state.

    Parameters
    ----------
    condition
        The n states; states out of contact are computed at the force floor.
    carriers
        Carriers, whose arc bands are used.

    Returns
    -------
    LinearContact
        Powers per arc band; of noise alone; and of tones.
    """
    touch, resonance = compute_contact_columns(condition)
    kernel = load_kernel()
    if kernel is None:
        return _linear_contact_numpy(condition, carriers, touch, resonance)
    tokens = np.ascontiguousarray(condition.tokens, dtype=np.float64)
    columns = np.stack([touch[name] for name in CONTACT_COLUMNS], axis=1)
    tables = build_kernel_tables(carriers, *lateral_hand_impedance(condition.probe))
    result = kernel_contact.compute_linear_contact(kernel, tables, tokens, columns)
    return LinearContact(result.power, result.normal, resonance, result.noise, SpectralLines(result.lines, result.low))


def compute_contact_columns(condition: Condition) -> tuple[dict[str, Float], Float]:
    """Compute the contact parameters (n,) of each state, by the names in CONTACT_COLUMNS, and its resonance [Hz].

    Parameters are contact radius, stiffness, damping, friction and others, all in SI units.
    """
    probe, force = PROBES[condition.probe], np.maximum(condition.force, FORCE_FLOOR_N)
    radius, stiffness, damping, friction, resonance = np.zeros((5, len(force)))
    for index, mechanics in enumerate(condition.mechanics):
        # One row per distinct load of a material would suffice, but rows are few.
        rows, properties = np.flatnonzero(condition.material == index), with_defaults(mechanics)
        radius[rows] = contact_radius(mechanics, probe, force[rows])
        stiffness[rows] = contact_stiffness(mechanics, probe, force[rows])
        damping[rows] = 4.0 * properties.damping_ratio**2 * stiffness[rows] * probe.mass_kg
        friction[rows] = properties.friction
        resonance[rows] = resonance_hz(mechanics, probe, force[rows])
    sharpness = np.square(1.0 - radius / probe.tip_radius_m)
    return {
        "angle": np.arctan2(condition.direction[:, 1], condition.direction[:, 0]),
        "speed": np.maximum(condition.speed, SPEED_FLOOR_M_S),
        "radius": radius,
        "stiffness": stiffness,
        "damping": damping,
        "mass": np.full(len(force), probe.mass_kg),
        "load_square": np.square(force / probe.mass_kg),
        "rubbed": 1.0 + np.square(friction),
        "flank": np.square(1.0 + FLANK_FRICTION * sharpness) - 1.0,
    }, resonance


def lateral_hand_impedance(probe: str) -> tuple[float, float]:
    """Return the sideways stiffness and damping of the hand on the probe's mass, (k / m, 4 ζ² k / m) [rad²/s²]."""
    stiffness = HAND_STIFFNESS_N_M / PROBES[probe].mass_kg
    return stiffness, 4.0 * HAND_DAMPING_RATIO**2 * stiffness


def _linear_contact_numpy(
    condition: Condition, carriers: Carriers, touch: dict[str, Float], resonance: Float
) -> LinearContact:
    """Compute the linear contact in numpy, as the compiled kernel does."""
    kappa, wave_square = carriers.arc_centres(), np.square(2.0 * np.pi * carriers.arc_centres())
    spectrum = compute_surface_spectrum(condition.tokens, condition.direction, carriers)
    speed, radius, stiffness, damping, mass, load_square, rubbed, flank = (
        touch[name][:, None] for name in CONTACT_COLUMNS[1:]
    )
    angular_square = np.square(2.0 * np.pi * kappa * speed)
    hand_stiffness, hand_damping = lateral_hand_impedance(condition.probe)
    lateral = np.square(angular_square) / (np.square(hand_stiffness - angular_square) + hand_damping * angular_square)
    fade = np.square(arc_gain(kappa, touch["speed"]))
    normal_gain, lateral_gain = (
        power_gain(angular_square, stiffness, damping, mass) * fade,
        lateral * load_square * fade,
    )
    tip_power, spot_power = np.square(tip_gain(kappa, radius)), np.square(tip_gain(ASPERITY_SHARE * kappa, radius))
    weights = np.stack([tip_power, spot_power * wave_square, spot_power])
    height, slope, leaning = project_noise(spectrum, weights, carriers)
    normal = height * normal_gain
    noise = normal * rubbed + (slope + flank * wave_square * leaning) * lateral_gain
    # The same sum for each tone, at its two carriers.
    line_power, low = project_lines(spectrum, weights, carriers)
    line_height, line_slope, line_leaning = np.moveaxis(line_power, 1, 0)
    carrier = np.clip(low + np.arange(2)[:, None, None], 0, len(kappa) - 1)
    rows = np.arange(len(speed))[:, None]
    tone = line_height * normal_gain[rows, carrier]
    lines = SpectralLines(
        tone * rubbed + (line_slope + flank * line_leaning * wave_square[carrier]) * lateral_gain[rows, carrier], low
    )
    power = noise.copy()
    for tap in range(2):
        add_at(power, low + tap, lines.power[tap])
        add_at(normal, low + tap, tone[tap])
    return LinearContact(power, normal.sum(axis=1), resonance, noise, lines)


def profile_band_power(height_spectrum: Float, condition: Condition, carriers: Carriers) -> Float:
    """Compute the normal acceleration power (n, Ka) that a relief with a height power per arc band (Ka,) causes.

    height_spectrum: (Ka,) [m²]. The result is in (m/s²)², 0 out of contact.
    """
    kappa, probe = carriers.arc_centres(), PROBES[condition.probe]
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    power = np.zeros((len(speed), len(kappa)))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        load = np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        tip = tip_response(kappa, mechanics, probe, load)
        response = height_power(kappa * speed[rows, None], mechanics, probe, load)
        power[rows] = height_spectrum * response * np.square(tip * arc_gain(kappa, speed[rows]))
    return power


def time_band_power(arc_power: Float, speed: Float, carriers: Carriers) -> Float:
    """Sort power per arc band (n, Ka) into time bands (n, Kt), at the frequencies f = κ v that speeds v (n,) give."""
    cumulative = np.concatenate([np.zeros((len(arc_power), 1)), np.cumsum(arc_power, axis=1)], axis=1)
    log_speed = np.log2(np.maximum(speed, SPEED_FLOOR_M_S))[:, None]
    position = np.clip(time_edges_in_arc_bands(carriers) - ARC_PER_OCTAVE * log_speed, 0.0, arc_power.shape[1])
    low = np.minimum(position.astype(int), arc_power.shape[1] - 1)
    rows = np.arange(len(arc_power))[:, None]
    edge_power = cumulative[rows, low] + (position - low) * (cumulative[rows, low + 1] - cumulative[rows, low])
    return np.asarray(np.diff(edge_power, axis=1))


def time_edges_in_arc_bands(carriers: Carriers) -> Float:
    """Return the time bands' edges (Kt + 1,) as fractional arc-band indices, at a speed of 1 m/s."""
    return np.asarray(ARC_PER_OCTAVE * np.log2(carriers.time_edges() / carriers.arc_start_per_m))


def _smoothstep(x: Float) -> Float:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
