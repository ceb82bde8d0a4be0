"""F_Θ's input: token, mechanics with known flags, probe, direction, log speed, log force, and the linear contact.

Mechanics do not show in a picture (foam and stone give the same map), so they are inputs of their own, each with a
flag that says whether it is known.

Rotation-invariant RMS distance between tokens, in the field's input normalisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..material.contact_model import Mechanics, with_defaults
from ..material.probe import PROBES
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, TOKEN_DIM
from .carriers import Carriers
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    arc_gain,
    compute_linear_contact,
    encode_line_prior,
    time_band_power,
)

Float = NDArray[np.float64]

AMPLITUDE_FLOOR_M_S2 = 2e-4
"""Amplitude floor per band, m/s²: added in power before the logarithm."""
TIME_SHARE_DB = -20.0
"""Where the time carriers start beside the arc carriers: geometry belongs to arc length until data say otherwise."""
REFERENCE_SPEED_M_S, REFERENCE_RESONANCE_HZ = 0.1, 150.0
"""Reference speed [m/s] and resonance [Hz]; inputs are log ratios to these."""
PROBE_NAMES = tuple(PROBES)
MECHANICS_COLUMN = TOKEN_DIM
PROBE_COLUMN = MECHANICS_COLUMN + 6
DIRECTION_COLUMN = PROBE_COLUMN + len(PROBE_NAMES)
_ACTION_END = DIRECTION_COLUMN + 4
_PHYSICS_SCALARS = 3


@dataclass(frozen=True)
class Inputs:
    """x: (n, D) network input. prior: (n, K) log amplitude per carrier of the linear contact; with line gains that of
    its noise alone, and lines.prior_columns more for the tones. gate: (n, K) factor 0 … 1 on the emission: 0 at
    rest, out of contact, and where an arc carrier leaves the band."""

    x: Float
    prior: Float
    gate: Float


def input_size(carriers: Carriers, physics: bool, action_octaves: int = 0) -> int:
    encoded = 6 * action_octaves
    return _ACTION_END + encoded + (carriers.time_count + _PHYSICS_SCALARS if physics else 0)


def build_inputs(
    condition: Condition,
    carriers: Carriers,
    physics: bool,
    action_octaves: int = 0,
    directed: bool = True,
    line_gains: bool = False,
    stroke_frame: bool = False,
) -> Inputs:
    """Evaluate inputs at every state; without physics, x ends with the action and prior is 0.

    action_octaves: see encode_action. directed: False leaves direction out (0), so that nothing depends on it.
    line_gains: keep the tones apart (see lines); needs physics and arc carriers. stroke_frame: the network sees the
    token as the stroke meets it, and d only in that.
    """
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    force = np.maximum(condition.force, FORCE_FLOOR_N)
    columns = [
        normalise_tokens(
            rotate_to_stroke_frame(condition.tokens, condition.direction) if stroke_frame else condition.tokens
        ),
        np.array([encode_mechanics(m) for m in condition.mechanics])[condition.material],
        np.tile([float(name == condition.probe) for name in PROBE_NAMES], (len(speed), 1)),
        condition.direction if directed and not stroke_frame else np.zeros_like(condition.direction),
        np.log(speed / REFERENCE_SPEED_M_S)[:, None],
        np.log(force)[:, None],
        encode_action(condition.direction, speed, force, action_octaves, directed),
    ]
    prior = np.zeros((len(speed), carriers.count))
    if physics:
        # Without arc carriers the default wavenumbers serve, and the time carriers start with all of the power.
        grid = carriers if carriers.arc_count else replace(carriers, arc_octaves=Carriers().arc_octaves)
        share = 10.0 ** (TIME_SHARE_DB / 10.0) if carriers.arc_count else 1.0
        linear = compute_linear_contact(condition, grid)
        time_power = time_band_power(linear.power, speed, grid)
        bounce = PROBES[condition.probe].mass_kg * np.sqrt(linear.normal) / force
        columns += [
            (log_amplitude(time_power) + 5.0) / 3.0,
            0.5 * log_amplitude(linear.power.sum(axis=1))[:, None],
            # Above 1 the inertia of the linear solution exceeds the load: the probe hops.
            0.5 * np.log(bounce + 1e-3)[:, None],
            np.log(linear.resonance / REFERENCE_RESONANCE_HZ)[:, None],
        ]
        prior[:, carriers.time_slice] = log_amplitude(time_power * share)
        if carriers.arc_count:
            prior[:, carriers.arc_slice] = log_amplitude(linear.noise if line_gains else linear.power)
        if line_gains:
            prior = np.concatenate([prior, encode_line_prior(linear.lines)], axis=1)
    return Inputs(np.concatenate(columns, axis=1), prior, compute_gate(condition, carriers))


def compute_gate(condition: Condition, carriers: Carriers) -> Float:
    """(n, K) factor 0 … 1 on what is emitted, as in Inputs."""
    gate = np.repeat(motion_gate(condition)[:, None], carriers.count, axis=1)
    gate[:, carriers.arc_slice] *= arc_gain(carriers.arc_centres(), np.maximum(condition.speed, SPEED_FLOOR_M_S))
    return gate


def motion_gate(condition: Condition) -> Float:
    """(n,) 0 … 1: 0 at rest and out of contact."""
    slides = np.clip(condition.speed / SPEED_FLOOR_M_S, 0.0, 1.0) * np.clip(condition.force / FORCE_FLOOR_N, 0.0, 1.0)
    return np.where(condition.contact, slides, 0.0)


def encode_action(direction: Float, speed: Float, force: Float, octaves: int, directed: bool) -> Float:
    """(n, 6 · octaves) positional encoding of u(t), as NeRF's of place (Mildenhall et al. 2020, eq. 4).

    Per octave k: sine and cosine of 2^k · π/2 · z for log speed and log force (z of order 1 over a hand's range), and
    of 2^(k+1) times the direction's angle, 0 where undirected. A network on bare logarithms smooths over what a
    material does within a factor of 1.5 of speed.
    """
    columns = []
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    pace, load = np.log(speed / 0.06) / 1.2, np.log(force) / 1.2
    for octave in range(octaves):
        turn = 2.0 ** (octave + 1) * angle
        for phase, told in ((2.0**octave * 0.5 * np.pi * pace, True), (2.0**octave * 0.5 * np.pi * load, True),
                            (turn, directed)):  # fmt: skip
            columns += [np.sin(phase) * told, np.cos(phase) * told]
    return np.stack(columns, axis=1) if columns else np.zeros((len(speed), 0))


def rotate_to_stroke_frame(tokens: Float, direction: Float) -> Float:
    """Tokens (n, TOKEN_DIM) with their moments of direction turned into the frame of unit vectors d (n, 2).

    What depends on them alone cannot tell a surface and a stroke both turned from the same two unturned, nor d from −d.
    """
    turned = np.array(tokens, dtype=np.float64)
    angle = np.arctan2(direction[:, 1], direction[:, 0])[:, None]
    first = np.arange(len(BAND_WAVELENGTHS_M)) * len(BAND_FEATURES)
    for fold, name in ((2.0, "cos2"), (4.0, "cos4")):
        at = first + BAND_FEATURES.index(name)
        moment = (turned[:, at] + 1j * turned[:, at + 1]) * np.exp(-1j * fold * angle)
        turned[:, at], turned[:, at + 1] = moment.real, moment.imag
    return turned


def log_amplitude(power: Float) -> Float:
    return np.asarray(0.5 * np.log(power + AMPLITUDE_FLOOR_M_S2**2))


def normalise_tokens(tokens: Float) -> Float:
    """(n, TOKEN_DIM) with every component of order 1."""
    shift, scale = token_normalisation()
    return np.asarray((np.asarray(tokens, dtype=np.float64) - shift) * scale)


def token_normalisation() -> tuple[Float, Float]:
    """(TOKEN_DIM,) what is taken from each component, and its factor after that; moments of direction stay."""
    bands, width = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
    scale, shift = np.ones(TOKEN_DIM), np.zeros(TOKEN_DIM)
    levels = np.arange(bands) * width
    shift[levels], scale[levels] = -6.0, 1.0 / 1.5
    scale[levels + BAND_FEATURES.index("offset")] = 2.0
    scale[bands * width :] = 0.5
    return shift, scale


def encode_mechanics(mechanics: Mechanics) -> tuple[float, ...]:
    """Normalised value and known flag of stiffness, damping and friction; the defaults stand for unknowns."""
    full = with_defaults(mechanics)
    known = [value is not None for value in (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)]
    values = (np.log(full.stiffness_n_m / 5e4) / 2.0, (full.damping_ratio - 0.2) / 0.2, (full.friction - 0.3) / 0.3)
    return tuple(float(item) for pair in zip(values, known, strict=True) for item in pair)


ROTATION_COUNT = 36
"""Directions tried over half a turn: every 5°. After half a turn every moment of a token is what it was."""


def token_distances(values: ArrayLike, known: NDArray[np.bool_], others: ArrayLike) -> Float:
    """(n,) root mean square difference of the known features, normalised as the field's input is (one unit: a factor of
    30 in height, or all of a band's anisotropy), least over the directions in which the others may lie.

    values: (TOKEN_DIM,). known: (TOKEN_DIM,). others: (n, TOKEN_DIM). Raises MaterialError where nothing is known or
    sizes are wrong.
    """
    own, rest = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if own.shape != (TOKEN_DIM,) or known.shape != (TOKEN_DIM,) or rest.ndim != 2 or rest.shape[1] != TOKEN_DIM:
        raise MaterialError(f"tokens hold {TOKEN_DIM} values, not {own.shape}, {known.shape} and {rest.shape}.")
    if not known.any():
        raise MaterialError("a token of which nothing is known is like no other.")
    normal = normalise_tokens(own[None])[0, known]
    least = np.full(len(rest), np.inf)
    for angle in np.pi * np.arange(ROTATION_COUNT) / ROTATION_COUNT:
        direction = np.tile([np.cos(angle), np.sin(angle)], (len(rest), 1))
        gap = normalise_tokens(rotate_to_stroke_frame(rest, direction))[:, known] - normal
        least = np.minimum(least, np.sqrt(np.mean(gap**2, axis=1)))
    return least
