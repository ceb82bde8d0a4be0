"""Network inputs of F_Θ: material token, mechanics, probe, direction, log speed, log force, linear contact.

The token describes the surface's relief and is derived from an image. Mechanics (stiffness, damping, friction) do not
show in an image (foam and stone give the same token), so they are inputs of their own, each with a flag for whether it
is known. `token_distances` compares tokens in the same normalisation, invariant to rotation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..material.contact_model import Mechanics, with_defaults
from ..material.probe import get_probe
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, TOKEN_DIM
from .carriers import Carriers
from .contact.lattice_lines import encode_line_prior
from .linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, arc_gain, compute_linear_contact, time_band_power

Float = NDArray[np.float64]

AMPLITUDE_FLOOR_M_S2 = 2e-4
"""Amplitude floor per band, added in power before the logarithm [m/s²]."""
TIME_SHARE_DB = -20.0
"""Initial level of the time carriers relative to the arc carriers [dB]: geometry belongs to arc length until data
differ."""
REFERENCE_SPEED_M_S, REFERENCE_RESONANCE_HZ = 0.1, 150.0
"""Reference speed [m/s] and resonance [Hz]; inputs are log ratios to these."""
PROBE_KINDS = ("pen", "finger")
"""Kinds of probe that F_Θ tells apart."""
MECHANICS_COLUMN = TOKEN_DIM
PROBE_COLUMN = MECHANICS_COLUMN + 6
DIRECTION_COLUMN = PROBE_COLUMN + len(PROBE_KINDS)
_ACTION_END = DIRECTION_COLUMN + 4
_PHYSICS_SCALARS = 3


@dataclass(frozen=True)
class Inputs:
    """Network inputs at n states of the hand, with the terms that modify the outputs.

    Attributes
    ----------
    x
        (n, D) network input.
    prior
        (n, K) log amplitude per carrier that the linear contact predicts; the network's output is a correction to it.
        With line gains (an output per tone of a regular surface) that of its noise alone, followed by the columns of
        linear_contact.encode_line_prior, which hold the tones.
    gate
        (n, K) factor 0 … 1 on the emission: 0 at rest, out of contact, and where an arc carrier leaves the band.
    """

    x: Float
    prior: Float
    gate: Float


def input_size(carriers: Carriers, physics: bool, action_octaves: int = 0) -> int:
    """Return the number of network inputs D for a field with these options, see build_inputs."""
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
    """Compute the network inputs at n states of the hand.

    Parameters
    ----------
    condition
        The n states.
    carriers
        Carriers of the field.
    physics
        Append the linear contact to x, and return its log amplitudes as prior; otherwise the prior is 0.
    action_octaves
        Octaves of the positional encoding, see encode_action.
    directed
        False replaces the direction by 0, so that no output depends on it.
    line_gains
        Separate the tones from the noise (see linear_contact.compute_line_power); needs physics and arc carriers.
    stroke_frame
        Rotate the token into the frame of the stroke, and omit the direction.

    Returns
    -------
    Inputs
        float64 arrays.
    """
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    force = np.maximum(condition.force, FORCE_FLOOR_N)
    probe = get_probe(condition.probe)
    columns = [
        normalise_tokens(
            rotate_to_stroke_frame(condition.tokens, condition.direction) if stroke_frame else condition.tokens
        ),
        np.array([encode_mechanics(m) for m in condition.mechanics])[condition.material],
        np.tile([float(name == probe.kind) for name in PROBE_KINDS], (len(speed), 1)),
        condition.direction if directed and not stroke_frame else np.zeros_like(condition.direction),
        np.log(speed / REFERENCE_SPEED_M_S)[:, None],
        np.log(force)[:, None],
        encode_action(condition.direction, speed, force, action_octaves, directed),
    ]
    prior = np.zeros((len(speed), carriers.count))
    if physics:
        # Without arc carriers the default wavenumbers are used, and the time carriers start with all of the power.
        grid = carriers if carriers.arc_count else replace(carriers, arc_octaves=Carriers().arc_octaves)
        time_share = 10.0 ** (TIME_SHARE_DB / 10.0) if carriers.arc_count else 1.0
        linear = compute_linear_contact(condition, grid)
        time_power = time_band_power(linear.power, speed, grid)
        bounce = probe.mass_kg * np.sqrt(linear.normal) / force
        columns += [
            (log_amplitude(time_power) + 5.0) / 3.0,
            0.5 * log_amplitude(linear.power.sum(axis=1))[:, None],
            # Above 1 the inertia of the linear solution exceeds the load, and the probe hops.
            0.5 * np.log(bounce + 1e-3)[:, None],
            np.log(linear.resonance / REFERENCE_RESONANCE_HZ)[:, None],
        ]
        prior[:, carriers.time_slice] = log_amplitude(time_power * time_share)
        if carriers.arc_count:
            prior[:, carriers.arc_slice] = log_amplitude(linear.noise if line_gains else linear.power)
        if line_gains:
            prior = np.concatenate([prior, encode_line_prior(linear.lines)], axis=1)
    return Inputs(np.concatenate(columns, axis=1), prior, compute_gate(condition, carriers))


def compute_gate(condition: Condition, carriers: Carriers) -> Float:
    """Compute the factor (n, K), 0 … 1, on each carrier: 0 at rest and in the air; arc carriers as in arc_gain."""
    gate = np.repeat(motion_gate(condition)[:, None], carriers.count, axis=1)
    gate[:, carriers.arc_slice] *= arc_gain(carriers.arc_centres(), np.maximum(condition.speed, SPEED_FLOOR_M_S))
    return gate


def motion_gate(condition: Condition) -> Float:
    """Compute the factor (n,), 0 … 1, that is 0 at rest and out of contact."""
    sliding = np.clip(condition.speed / SPEED_FLOOR_M_S, 0.0, 1.0) * np.clip(condition.force / FORCE_FLOOR_N, 0.0, 1.0)
    return np.where(condition.contact, sliding, 0.0)


def encode_action(direction: Float, speed: Float, force: Float, octaves: int, directed: bool) -> Float:
    """Compute the positional encoding (n, 6 · octaves) of u(t), as NeRF's of position (Mildenhall et al. 2020, eq. 4).

    Per octave k: sine and cosine of 2^k · π/2 · z for log speed and log force (z of order 1 over a hand's range), and
    of 2^(k+1) times the direction's angle, 0 if undirected. A network on bare logarithms smooths over material
    behaviour within a factor of 1.5 of speed.
    """
    columns = []
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    log_speed, log_force = np.log(speed / 0.06) / 1.2, np.log(force) / 1.2
    for octave in range(octaves):
        turn = 2.0 ** (octave + 1) * angle
        for phase, is_used in (
            (2.0**octave * 0.5 * np.pi * log_speed, True),
            (2.0**octave * 0.5 * np.pi * log_force, True),
            (turn, directed),
        ):
            columns += [np.sin(phase) * is_used, np.cos(phase) * is_used]
    return np.stack(columns, axis=1) if columns else np.zeros((len(speed), 0))


def rotate_to_stroke_frame(tokens: Float, direction: Float) -> Float:
    """Rotate the direction moments of tokens (n, TOKEN_DIM) into the frame of stroke directions d (n, 2), unit vectors.

    A network that sees only the result gives the same output when surface and stroke are turned together, and for d and
    −d.
    """
    turned = np.array(tokens, dtype=np.float64)
    angle = np.arctan2(direction[:, 1], direction[:, 0])[:, None]
    first = np.arange(len(BAND_WAVELENGTHS_M)) * len(BAND_FEATURES)
    for fold, name in ((2.0, "cos2"), (4.0, "cos4")):
        column = first + BAND_FEATURES.index(name)
        moment = (turned[:, column] + 1j * turned[:, column + 1]) * np.exp(-1j * fold * angle)
        turned[:, column], turned[:, column + 1] = moment.real, moment.imag
    return turned


def log_amplitude(power: Float) -> Float:
    """Return log √(power + AMPLITUDE_FLOOR_M_S2²) of a power [(m/s²)²]."""
    return np.asarray(0.5 * np.log(power + AMPLITUDE_FLOOR_M_S2**2))


def normalise_tokens(tokens: Float) -> Float:
    """Return tokens (n, TOKEN_DIM) with every component of order 1."""
    shift, scale = token_normalisation()
    return np.asarray((np.asarray(tokens, dtype=np.float64) - shift) * scale)


def token_normalisation() -> tuple[Float, Float]:
    """Return the shift and scale (TOKEN_DIM,) of the token's normalisation, (token − shift) · scale.

    Direction moments stay unchanged.
    """
    bands, width = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
    scale, shift = np.ones(TOKEN_DIM), np.zeros(TOKEN_DIM)
    levels = np.arange(bands) * width
    shift[levels], scale[levels] = -6.0, 1.0 / 1.5
    scale[levels + BAND_FEATURES.index("offset")] = 2.0
    scale[bands * width :] = 0.5
    return shift, scale


def encode_mechanics(mechanics: Mechanics) -> tuple[float, ...]:
    """Return normalised value and known flag of stiffness, damping and friction; defaults replace unknown values."""
    filled = with_defaults(mechanics)
    known = [value is not None for value in (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)]
    values = (
        np.log(filled.stiffness_n_m / 5e4) / 2.0,
        (filled.damping_ratio - 0.2) / 0.2,
        (filled.friction - 0.3) / 0.3,
    )
    return tuple(float(item) for pair in zip(values, known, strict=True) for item in pair)


ROTATION_COUNT = 36
"""Directions tried over half a turn, one every 5°; after half a turn every moment of a token repeats."""


def token_distances(values: ArrayLike, known: NDArray[np.bool_], others: ArrayLike) -> Float:
    """Compute the RMS distance (n,) of a material's token to n others, over its known features.

    Parameters
    ----------
    values
        (TOKEN_DIM,) token.
    known
        (TOKEN_DIM,) bool, features to compare.
    others
        (n, TOKEN_DIM) tokens, each rotated to the direction of least distance.

    Returns
    -------
    ndarray
        (n,) in the field's input normalisation: one unit is a factor of 30 in height, or all of a band's anisotropy.

    Raises
    ------
    MaterialError
        If no feature is known, or sizes are wrong.
    """
    token, candidates = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if (
        token.shape != (TOKEN_DIM,)
        or known.shape != (TOKEN_DIM,)
        or candidates.ndim != 2
        or candidates.shape[1] != TOKEN_DIM
    ):
        raise MaterialError(f"tokens hold {TOKEN_DIM} values, not {token.shape}, {known.shape} and {candidates.shape}.")
    if not known.any():
        raise MaterialError("a token of which nothing is known is like no other.")
    normalised = normalise_tokens(token[None])[0, known]
    smallest = np.full(len(candidates), np.inf)
    for angle in np.pi * np.arange(ROTATION_COUNT) / ROTATION_COUNT:
        direction = np.tile([np.cos(angle), np.sin(angle)], (len(candidates), 1))
        difference = normalise_tokens(rotate_to_stroke_frame(candidates, direction))[:, known] - normalised
        smallest = np.minimum(smallest, np.sqrt(np.mean(difference**2, axis=1)))
    return smallest
