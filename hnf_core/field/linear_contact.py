"""Linear contact: the vibration of a steady stroke to first order, from the material token. Physical prior of F_Θ.

The token holds the surface's height spectrum P(κ, θ). A stroke is a line through it: a wave at angle δ to the stroke
has the wavenumber κ |cos δ| along it, so the spectrum under the stroke is the sum over δ of radial spectra shifted
along the log-κ axis. The tip filters the wave itself, at κ; hence that projection takes a weight per κ. Three axes add
in power, as DFT321 combines them: the normal acceleration through contact_model.height_response; friction, which
carries μ times the same force fluctuation sideways; and the load leaning on the slopes, F ∇h / m, more so against the
motion, on a mass that the hand holds. With this input the network has only hopping, creep and saturation left to learn;
from the bare token it would have to learn a shift of 200 bands with speed and direction, which a small ReLU net does
badly.

The tones of a lattice are separated from the noise around them. A weave, knurl or grating sounds at κ |cos δ| v. One
smooth correction over log κ, which suits noise, cannot silence one tone and preserve its neighbour; a free value per
arc carrier is learned from the few strokes whose tone falls on it. So each tone (two per token band) and its second and
third harmonic, which hopping and friction add to a pure wave, have an output of their own that moves with the tone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..kernel import compiled_field
from ..kernel.compiled_field import CONTACT_COLUMNS, ContactTables
from ..kernel.loader import load_kernel
from ..material.contact_model import (
    Mechanics,
    contact_radius,
    contact_stiffness,
    power_gain,
    resonance_hz,
    tip_gain,
    with_defaults,
)
from ..material.probe import Probe, get_probe
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, CLEAR_PEAK_SHARE
from .carriers import ARC_PER_OCTAVE, Carriers
from .contact.lattice_lines import (
    LEAST_ACROSS,
    LEAST_OFFSET_SCALE,
    LINE_SHARES,
    PathLines,
    SpectralLines,
    compute_line_shares,
    compute_line_wavenumbers,
    find_nearest_carriers,
    split_bands,
)

Float = NDArray[np.float64]

ANGLES = 24
"""Wave-vector angles over 180° at which the angular density is sampled."""
GRID_ANGLES = (np.arange(ANGLES) + 0.5) * np.pi / ANGLES
MIN_NOISE_SHARE = 1e-9
"""Smallest fraction of a band's power that counts as noise beside its tones.

Below it is rounding, and spreading it over log κ would distinguish 1e-16 from 0 in the bands between.
"""
LINE_CONCENTRATION = 20.0
"""Concentration of the angular density of strictly oriented waves: about ±10°."""
ORIENTED_DENSITY_MEAN = np.mean(np.exp(LINE_CONCENTRATION * (np.cos(2.0 * GRID_ANGLES) - 1.0)))


@dataclass(frozen=True)
class SurfaceSpectrum:
    """Height spectra of n surfaces, at angles δ to the stroke over each; `bands` are the token's octave bands.

    Attributes
    ----------
    noise
        (n, Ka) height power of noise per arc band (a band of wavenumber |κ|) [m²].
    density
        (ANGLES, n, bands) angular density over δ, mean 1.
    band
        (Ka,) token band nearest to each κ.
    line_power
        (2, n, bands) power of the tones of a regular surface (weave, grating), along and across its axis [m²].
    line_wavenumber
        (n, bands) wavenumber of the tones [cycles/m].
    line_cosine
        (2, n, bands) |cos δ| of the angle δ between the tone's wave and the stroke.
    """

    noise: Float
    density: Float
    band: NDArray[np.intp]
    line_power: Float
    line_wavenumber: Float
    line_cosine: Float


def compute_surface_spectrum(
    tokens: NDArray[np.float32] | Float, direction: Float, carriers: Carriers
) -> SurfaceSpectrum:
    """Compute the height spectra of tokens (n, TOKEN_DIM) in the frame of stroke directions (n, 2), unit vectors."""
    feature = split_bands(tokens)
    power = 10.0 ** (2.0 * feature["level"])
    stroke_angle = np.arctan2(direction[:, 1], direction[:, 0])[:, None]
    # Moments of the angular density in the frame of the stroke.
    two = (feature["cos2"] + 1j * feature["sin2"]) * np.exp(-2j * stroke_angle)
    four = (feature["cos4"] + 1j * feature["sin4"]) * np.exp(-4j * stroke_angle)
    axis = 0.25 * np.angle(four)
    # Waves run along `axis` and across it (a grating has one of them, a plain weave both).
    along = np.clip(0.5 * (1.0 + np.real(two * np.exp(-2j * axis))), 0.0, 1.0)
    tones = compute_line_shares(feature["peak"], along, np.abs(four))
    position = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0])
    return SurfaceSpectrum(
        noise=_spread_over_wavenumbers(power * noise_remainder(tones), position),
        density=_angular_density(two, four, axis, along),
        band=_nearest_band(position),
        line_power=power * tones,
        line_wavenumber=compute_line_wavenumbers(feature),
        line_cosine=np.abs(np.stack([np.cos(axis), np.sin(axis)])),
    )


def noise_remainder(tones: Float) -> Float:
    """Return the fraction (n, bands) of a band's power left for noise by its two tones' fractions (2, n, bands).

    It is 0 below MIN_NOISE_SHARE, where only rounding is left.
    """
    rest = 1.0 - tones.sum(axis=0)
    return np.where(rest < MIN_NOISE_SHARE, 0.0, np.minimum(rest, 1.0))


def project_spectrum(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> Float:
    """Compute the power (n, Ka) per wavenumber along a straight cut through a surface, with waves weighted (n, Ka).

    weight: (n, Ka) factor on the power of waves of wavenumber |κ|, before the projection.
    """
    total = project_noise(spectrum, weight, carriers)
    power, low = project_lines(spectrum, weight, carriers)
    for tap in range(2):
        add_at(total, low + tap, power[tap])
    return total


def project_noise(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> Float:
    """Compute the noise power (..., n, Ka) per wavenumber along a straight cut through a surface, without its tones."""
    # Wavenumbers come first, so that those beyond a shift are contiguous.
    weighted = np.ascontiguousarray(np.moveaxis(spectrum.noise * weight, -1, -2))
    out, shifted, count = np.zeros_like(weighted), np.empty_like(weighted), weighted.shape[-2]
    # δ and 180° − δ shift a wave by the same amount, so their densities are added.
    density = (spectrum.density[: ANGLES // 2] + spectrum.density[: ANGLES // 2 - 1 : -1]) / ANGLES
    band_density = np.take(np.swapaxes(density, 1, 2), spectrum.band, axis=1)
    for shift, weight_at in zip(_projection_shifts().tolist(), band_density, strict=True):
        if shift < count:
            np.multiply(weighted[..., shift:, :], weight_at[shift:], out=shifted[..., shift:, :])
            out[..., : count - shift, :] += shifted[..., shift:, :]
    return np.moveaxis(out, -1, -2)


@lru_cache(maxsize=1)
def _projection_shifts() -> NDArray[np.intp]:
    """Return by how many arc bands (ANGLES / 2,) a wave at each angle to the stroke is lower along the stroke."""
    return np.asarray(np.rint(-ARC_PER_OCTAVE * np.log2(np.cos(GRID_ANGLES[: ANGLES // 2]))), dtype=np.intp)


@lru_cache(maxsize=8)
def build_kernel_tables(carriers: Carriers, hand: float, hand_damping: float) -> ContactTables:
    """Build the constants that compiled_field.compute_linear_contact needs.

    hand: sideways stiffness of the hand over the probe's mass [rad²/s²]. hand_damping: 4 ζ² times that.
    """
    position, bands = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0]), len(BAND_WAVELENGTHS_M)
    below, angle = np.clip(np.floor(position).astype(int), 0, bands - 2), GRID_ANGLES[: ANGLES // 2]
    return ContactTables(
        features=BAND_FEATURES, kappa=carriers.arc_centres(), below=below, share=np.clip(position - below, 0.0, 1.0),
        nearest_end=np.searchsorted(_nearest_band(position), np.arange(bands), side="right"),
        shift=_projection_shifts(), wavelength=np.asarray(BAND_WAVELENGTHS_M, dtype=np.float64),
        turn=np.stack([np.cos(2 * angle), np.sin(2 * angle), np.cos(4 * angle), np.sin(4 * angle)], axis=1),
        line_share=np.array(LINE_SHARES), least_across=LEAST_ACROSS, clear_peak=CLEAR_PEAK_SHARE,
        least_offset_scale=LEAST_OFFSET_SCALE,
        per_octave=ARC_PER_OCTAVE, concentration=LINE_CONCENTRATION, bump_mean=float(ORIENTED_DENSITY_MEAN),
        least_left=MIN_NOISE_SHARE, hand=hand, hand_damping=hand_damping,
    )  # fmt: skip


def _nearest_band(position: Float) -> NDArray[np.intp]:
    """Return the index of the token's octave band nearest to each position, a fractional band index."""
    return np.clip(np.rint(position).astype(np.intp), 0, len(BAND_WAVELENGTHS_M) - 1)


def project_lines(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> tuple[Float, NDArray[np.intp]]:
    """Compute the power and place of the tones along a straight cut through a surface, without its noise.

    Parameters
    ----------
    spectrum
        Spectra of n rows.
    weight
        (..., n, Ka) factor on the power of waves of wavenumber |κ|.
    carriers
        Carriers, whose arc bands are used.

    Returns
    -------
    power : ndarray
        (2, ..., n, 2 · bands) power in the two arc bands about each tone, split so that their centroid is the tone;
        first the tones along the surface's axis.
    low : ndarray
        (n, 2 · bands) index of the lower of the two bands, which may lie outside 0 … Ka − 1.
    """
    start, count = carriers.arc_centres()[0], carriers.arc_count
    band = np.clip(np.rint(ARC_PER_OCTAVE * np.log2(spectrum.line_wavenumber / start)).astype(int), 0, count - 1)
    line_weight = weight[..., np.arange(len(band))[:, None], band]
    power = np.concatenate([tone_power * line_weight for tone_power in spectrum.line_power], axis=-1)
    wavenumber = np.concatenate(list(spectrum.line_wavenumber * spectrum.line_cosine), axis=1)
    position = ARC_PER_OCTAVE * np.log2(np.maximum(wavenumber, 1e-9) / start)
    low = np.floor(position).astype(np.intp)
    fraction = position - low
    return np.stack([power * (1.0 - fraction), power * fraction]), low


def add_at(out: Float, index: NDArray[np.intp], power: Float) -> None:
    """Add power (n, m) to out (n, Ka) in the columns index (n, m), in place; columns outside are ignored."""
    rows = np.broadcast_to(np.arange(len(out))[:, None], index.shape)
    inside = (index >= 0) & (index < out.shape[1])
    np.add.at(out, (rows[inside], index[inside]), power[inside])


def _spread_over_wavenumbers(power: Float, position: Float) -> Float:
    """Spread octave-band powers (n, bands) over arc bands (n, Ka), linearly between band centres on log–log axes."""
    level = np.log(np.maximum(power, 1e-30) / ARC_PER_OCTAVE)
    below = np.clip(np.floor(position).astype(int), 0, len(BAND_WAVELENGTHS_M) - 2)
    fraction = np.clip(position - below, 0.0, 1.0)
    return np.asarray(np.exp(level[:, below] * (1.0 - fraction) + level[:, below + 1] * fraction))


def _angular_density(two: NDArray[np.complex128], four: NDArray[np.complex128], axis: Float, along: Float) -> Float:
    """Compute the distribution (ANGLES, n, bands) of a band's power over wave angles, positive, mean about 1.

    A truncated Fourier series of the two- and four-fold moments (n, bands), blended with narrow peaks along `axis`
    (n, bands) [rad] and across it where the four-fold moment is large; `along` is the share of the former, 0 to 1.
    """
    oriented = np.square(np.clip(np.abs(four), 0.0, 1.0))
    angle = GRID_ANGLES[:, None, None]
    # Fejér weights keep the truncated series positive.
    series = 1.0 + 4.0 / 3.0 * _rotate_moment(two, 2.0 * angle) + 2.0 / 3.0 * _rotate_moment(four, 4.0 * angle)
    facing = _rotate_moment(np.exp(2j * axis), 2.0 * angle)
    line = along * _oriented_density(facing) + (1.0 - along) * _oriented_density(-facing)
    return np.asarray(np.maximum((1.0 - oriented) * series + oriented * line, 0.0))


def _rotate_moment(moment: NDArray[np.complex128], angle: Float) -> Float:
    """Return Re(moment · e^{−i angle}) of complex direction moments."""
    return np.asarray(moment.real * np.cos(angle) + moment.imag * np.sin(angle))


def _oriented_density(facing: Float) -> Float:
    """Return a peaked angular density with mean 1, from facing = cos 2δ of the angle δ to the peak."""
    return np.asarray(np.exp(LINE_CONCENTRATION * (facing - 1.0)) / ORIENTED_DENSITY_MEAN)


LEAST_POWER = 1e-30
"""Power below which nothing vibrates [(m/s²)²]."""
SPEED_FLOOR_M_S = 1e-3
"""Lowest speed of the inputs [m/s]; below it the emission falls linearly, so that v → 0 is defined and silent."""
FORCE_FLOOR_N = 0.02
BAND_END_HZ = 4800.0
"""Highest frequency of everything that follows the hand's speed [Hz]; the model rate holds 5 kHz."""
ASPERITY_SHARE = 0.5
"""Radius of the spots that carry the load, relative to the Hertz radius (J. F. Archard 1957); the slopes act on
them."""
FLANK_FRICTION = 2.0
"""Rise of friction per unit of slope against the motion under a sharp tip, times (1 − a/R)² for a contact of radius a.

This and the constant above are equal to the simulator's (checked by a test).
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
    along_share
        (n,) share in power of the motion along the stroke that the amplitudes hold; None for all of it. The rest is
        integrated over time (`stick_slip`).
    lines
        Lines whose tones F_Θ gives apart from its noise carriers; None leaves them in the carriers.
    """

    tokens: Float
    mechanics: tuple[Mechanics, ...]
    material: NDArray[np.int32]
    direction: Float
    speed: Float
    force: Float
    contact: NDArray[np.bool_]
    probe: str
    along_share: Float | None = None
    lines: PathLines | None = None

    def rows(self, rows: slice | NDArray[np.bool_]) -> Condition:
        """Return the condition of some of the states, with the mechanics of all materials."""
        names = ("tokens", "material", "direction", "speed", "force", "contact", "along_share", "lines")
        given = {name: getattr(self, name) for name in names}
        return replace(self, **{name: values[rows] for name, values in given.items() if values is not None})


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
    return fade_frequency(speed[:, None] * wavenumber[None, :])


def fade_frequency(frequency: Float) -> Float:
    """Compute the gain of arc_gain at frequencies [Hz], of any shape."""
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
    tables = build_kernel_tables(carriers, *lateral_hand_impedance(get_probe(condition.probe)))
    result = compiled_field.compute_linear_contact(kernel, tables, tokens, columns)
    return LinearContact(result.power, result.normal, resonance, result.noise, SpectralLines(result.lines, result.low))


def compute_contact_columns(condition: Condition) -> tuple[dict[str, Float], Float]:
    """Compute the contact parameters (n,) of each state, by the names in CONTACT_COLUMNS, and its resonance [Hz].

    Parameters are contact radius, stiffness, damping, friction and others, all in SI units.
    """
    probe, force = get_probe(condition.probe), np.maximum(condition.force, FORCE_FLOOR_N)
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


def lateral_hand_impedance(probe: Probe) -> tuple[float, float]:
    """Return the sideways stiffness and damping of the hand on the probe's mass, (k / m, 4 ζ² k / m) [rad²/s²]."""
    stiffness = probe.hand_stiffness_n_m / probe.mass_kg
    return stiffness, 4.0 * probe.hand_damping_ratio**2 * stiffness


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
    hand_stiffness, hand_damping = lateral_hand_impedance(get_probe(condition.probe))
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


def compute_axis_power(condition: Condition, carriers: Carriers) -> Float:
    """Compute the power that the linear contact predicts along the stroke, across it and along the normal.

    Parameters
    ----------
    condition
        The n states; states out of contact are computed at the force floor.
    carriers
        Carriers, whose arc bands are used.

    Returns
    -------
    ndarray
        (3, n, Ka) acceleration power [(m/s²)²]; their sum is LinearContact.power.
    """
    touch, _ = compute_contact_columns(condition)
    kappa, wave_square = carriers.arc_centres(), np.square(2.0 * np.pi * carriers.arc_centres())
    speed, radius, stiffness, damping, mass, load_square, rubbed, flank = (
        touch[name][:, None] for name in CONTACT_COLUMNS[1:]
    )
    tip_power, spot_power = np.square(tip_gain(kappa, radius)), np.square(tip_gain(ASPERITY_SHARE * kappa, radius))
    weights = np.stack([tip_power, spot_power * wave_square, spot_power])
    spectrum = compute_surface_spectrum(condition.tokens, condition.direction, carriers)
    projected = np.array(project_noise(spectrum, weights, carriers))
    line_power, low = project_lines(spectrum, weights, carriers)
    for kind, power in enumerate(np.moveaxis(line_power, 1, 0)):
        for tap in range(2):
            add_at(projected[kind], low + tap, power[tap])
    height, slope, leaning = projected
    angular_square = np.square(2.0 * np.pi * kappa * speed)
    hand_stiffness, hand_damping = lateral_hand_impedance(get_probe(condition.probe))
    lateral = np.square(angular_square) / (np.square(hand_stiffness - angular_square) + hand_damping * angular_square)
    fade = np.square(arc_gain(kappa, touch["speed"]))
    normal = height * power_gain(angular_square, stiffness, damping, mass) * fade
    along = np.minimum(leaning * wave_square, slope)
    tilt = lateral * load_square * fade
    return np.stack(
        [normal * (rubbed - 1.0) + (along + flank * leaning * wave_square) * tilt, (slope - along) * tilt, normal]
    )


def compute_relief_power(height_spectrum: Float, condition: Condition, carriers: Carriers) -> Float:
    """Compute the power (n, Ka) that a relief under the path causes, of a height power per arc band (Ka,).

    height_spectrum: (Ka,) [m²]. As LinearContact.power of a grating across the path, in (m/s²)²; 0 out of contact.
    """
    touch, _ = compute_contact_columns(condition)
    kappa, wave_square = carriers.arc_centres(), np.square(2.0 * np.pi * carriers.arc_centres())
    speed, radius, stiffness, damping, mass, load_square, rubbed, flank = (
        touch[name][:, None] for name in CONTACT_COLUMNS[1:]
    )
    angular_square = np.square(2.0 * np.pi * kappa * speed)
    hand_stiffness, hand_damping = lateral_hand_impedance(get_probe(condition.probe))
    lateral = np.square(angular_square) / (np.square(hand_stiffness - angular_square) + hand_damping * angular_square)
    normal = np.square(tip_gain(kappa, radius)) * power_gain(angular_square, stiffness, damping, mass) * rubbed
    slope = np.square(tip_gain(ASPERITY_SHARE * kappa, radius)) * wave_square * (1.0 + flank) * lateral * load_square
    touching = condition.contact & (condition.force > 0.0)
    fade = np.square(arc_gain(kappa, touch["speed"])) * touching[:, None]
    return np.asarray(height_spectrum * (normal + slope) * fade)


def extend_to_tones(values: Float, condition: Condition, carriers: Carriers) -> Float:
    """Append to values per carrier (n, K) those of the tones, of the nearest arc carrier: (n, K + tones)."""
    if condition.lines is None:
        return values
    nearest = find_nearest_carriers(condition.lines.compute_tone_wavenumbers(), carriers)
    return np.concatenate([values, np.take_along_axis(values[:, carriers.arc_slice], nearest, axis=1)], axis=1)


def reduce_along(alpha: Float, condition: Condition, carriers: Carriers) -> Float:
    """Reduce amplitudes (n, heads, K + tones) to `Condition.along_share` of the contact's power along the stroke.

    The power is divided among the axes as the linear contact divides its own.
    """
    if condition.along_share is None:
        return alpha
    rows, out = condition.along_share < 1.0, alpha.copy()
    if rows.any():
        part = condition.rows(rows)
        speed, power = np.maximum(part.speed, SPEED_FLOOR_M_S), compute_axis_power(part, carriers)
        fraction = np.empty((len(speed), carriers.count))
        along, total = power[0], power.sum(axis=0)
        fraction[:, carriers.arc_slice] = along / np.maximum(total, LEAST_POWER)
        along, total = (time_band_power(each, speed, carriers) for each in (along, total))
        fraction[:, carriers.time_slice] = along / np.maximum(total, LEAST_POWER)
        fraction = extend_to_tones(fraction, part, carriers)
        out[rows] *= np.sqrt(1.0 - (1.0 - condition.along_share[rows, None]) * np.clip(fraction, 0.0, 1.0))[:, None, :]
    return out


SURFACE_PROBE_M_S = 0.16
"""Speed at which all arc carriers lie between the fades of arc_gain [m/s]."""


def compute_along_force(condition: Condition, carriers: Carriers) -> Float:
    """Compute the power (n, Ka) per arc band of the force along the stroke that the relief's slopes cause [N²].

    It is a function of place, not of speed: slopes under the load, and friction on flanks, without the inertia of the
    normal axis.
    """
    fast = replace(condition, speed=np.full(len(condition.speed), SURFACE_PROBE_M_S))
    along, _, normal = compute_axis_power(fast, carriers)
    touch, _ = compute_contact_columns(fast)
    angular_square = np.square(2.0 * np.pi * SURFACE_PROBE_M_S * carriers.arc_centres())
    probe = get_probe(condition.probe)
    stiffness, damping = lateral_hand_impedance(probe)
    mobility = np.square(angular_square) / (np.square(stiffness - angular_square) + damping * angular_square)
    along = along - (touch["rubbed"][:, None] - 1.0) * normal
    return np.asarray(np.maximum(along, 0.0) * (probe.mass_kg**2 / mobility))


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
