"""Mechanics of a material, and the linear contact model: a probe's mass on the spring and damper of the contact.

Stiffness, damping and friction go in; responses from surface profile or force to acceleration come out. Friction's own
force noise, and the resonances of the probe's body, are linear and have a closed form here. Heights and
accelerations are positive along the surface normal, away from the material; forces are positive if they press the probe
onto it.

Sources: H. Hertz (1882), Über die Berührung fester elastischer Körper: sphere on a half-space, F = (4/3) E* a³ / R,
dF/dδ = 2 E* a. K. L. Johnson (1985), Contact Mechanics, chs. 3–4 (contact in series, Hertzian pressure). Y. Tsuji, T.
Tanaka & T. Ishida (1992), Powder Technology 71 (damper that grows with the tangent stiffness, so that the damping ratio
is the same at every load). S. S. Rao, Mechanical Vibrations, ch. 3 (base excitation). How friction's force noise
depends on wavelength and load, and the body of the pen: recorded textures (docs/recordings.md).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .probe import Probe, get_probe


@dataclass(frozen=True)
class Mechanics:
    """Contact properties of a material; None = unknown (the field was trained with unknowns dropped at random).

    Attributes
    ----------
    stiffness_n_m : float or None
        Contact stiffness at 1 N under the pen, the stiff tip in `probe.py` [N/m].
    damping_ratio : float or None
        Damping ratio of the oscillator of probe mass and contact.
    friction : float or None
        Coulomb μ.
    friction_noise_n : float or None
        RMS fluctuation of the friction force in the octave of wavelengths about 1 mm, under the pen at 1 N [N].
    friction_noise_slope : float or None
        Exponent β of that fluctuation's spectrum κ^−β along the path.
    pile_m : float or None
        Free depth of loose fibres, which bend under a finger before they slip [m]; 0 of a hard surface.
    thread_spacing_m : float or None
        Spacing of threads or ribs that a fingertip's ridges catch on [m]; 0 for none.
    pitch_scatter_m : float or None
        RMS distance of a lattice's threads, ribs or knurls from their even places, along each axis [m]; 0 for none.
    """

    stiffness_n_m: float | None = None
    damping_ratio: float | None = None
    friction: float | None = None
    friction_noise_n: float | None = None
    friction_noise_slope: float | None = None
    pile_m: float | None = None
    thread_spacing_m: float | None = None
    pitch_scatter_m: float | None = None


UNKNOWN_MECHANICS = Mechanics()
MECHANICS_NAMES = tuple(each.name for each in fields(Mechanics))
LEARNED_MECHANICS = MECHANICS_NAMES[:3]
"""Properties that F_Θ sees; the response to the others has a closed form."""
MECHANICS_LIMITS = {
    "stiffness [N/m]": (1e-6, 1e12),
    "damping ratio": (0.0, 1e3),
    "friction": (0.0, 1e3),
    "friction noise [N]": (0.0, 1e3),
    "friction noise slope": (-4.0, 8.0),
    "pile [m]": (0.0, 1.0),
    "thread spacing [m]": (0.0, 1.0),
    "pitch scatter [m]": (0.0, 1.0),
}
"""Accepted range of each property, in the order of `Mechanics`: beyond any material, but computable by the contact
model."""


def describe_limit_violation(mechanics: Mechanics) -> str:
    """Describe the first property that is outside MECHANICS_LIMITS, for an error message; "" if there is none."""
    for (name, (low, high)), value in zip(MECHANICS_LIMITS.items(), astuple(mechanics), strict=True):
        if value is not None and not low <= value <= high:
            return f"{name} must be a number from {low:g} to {high:g}, not {value:g}."
    return ""


Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

DEFAULT_STIFFNESS_N_M = 5.0e4
"""Assumed stiffness of a material that states none [N/m]: between soft plastic and wood under the pen at 1 N."""
DEFAULT_DAMPING_RATIO = 0.2
"""Assumed damping ratio of a material that states none."""
DEFAULT_FRICTION = 0.3
"""Assumed friction of a material that states none: median kinetic μ of the ten HaTT categories."""
DEFAULT_FRICTION_NOISE_N = 9.5e-3
"""Assumed friction noise of a material that states none [N]: median of 50 recorded textures."""
DEFAULT_FRICTION_NOISE_SLOPE = 1.9
"""Assumed slope of the friction noise of a material that states none: median of 50 recorded textures."""
STATIC_OVER_KINETIC = 1.5
"""Static over kinetic friction F_S / F_C of the LuGre model, C. Canudas de Wit et al. 1995 (IEEE Trans. Autom. Control
40), table I (1.5 N over 1 N)."""
STRIBECK_SPEED_M_S = 1e-3
"""Stribeck speed v_s, ibid. [m/s]. A stroke at 100 mm/s is a hundred times faster, so the kinetic μ of the material
table applies."""
TANGENTIAL_OVER_NORMAL = 2.0 * (1.0 - 0.3) / (2.0 - 0.3)
"""Tangential over normal stiffness of a Hertzian contact at ν = 0.3 (R. D. Mindlin 1949, J. Appl. Mech. 16)."""
FRICTION_NOISE_FORCE_EXPONENT = 0.38
"""Exponent of the load in the friction force's fluctuation, fitted to 50 recorded textures (95 % interval over
textures 0.33 to 0.43). Independent junctions whose number grows as the load would give 0.5, as the area
of a Hertzian contact 0.33 (J. F. Archard 1957)."""
FRICTION_NOISE_WAVENUMBER = 1e3
"""Wavenumber about which `Mechanics.friction_noise_n` is stated [cycles/m]."""


@dataclass(frozen=True)
class KnownMechanics:
    """Properties as in `Mechanics`, without unknown values."""

    stiffness_n_m: float = DEFAULT_STIFFNESS_N_M
    damping_ratio: float = DEFAULT_DAMPING_RATIO
    friction: float = DEFAULT_FRICTION
    friction_noise_n: float = DEFAULT_FRICTION_NOISE_N
    friction_noise_slope: float = DEFAULT_FRICTION_NOISE_SLOPE
    pile_m: float = 0.0
    thread_spacing_m: float = 0.0
    pitch_scatter_m: float = 0.0


def with_defaults(mechanics: Mechanics) -> KnownMechanics:
    """Replace unknown values (None) of the mechanics by DEFAULT_STIFFNESS_N_M and the other defaults above."""
    return KnownMechanics(**{name: value for name, value in vars(mechanics).items() if value is not None})


def surface_stiffness_at_1n(mechanics: Mechanics, probe: Probe) -> float:
    """Return the surface's Hertzian stiffness dF/dδ at 1 N under a probe's tip [N/m].

    Parameters
    ----------
    mechanics : Mechanics
        Mechanics, whose stiffness is that under the pen.
    probe : Probe
        The probe.

    Returns
    -------
    float
        Stiffness [N/m].

    Notes
    -----
    k = (6 F R E*²)^(1/3) (Johnson 1985, eq. 4.23) scales it to another tip radius R.
    """
    ratio = probe.tip_radius_m / get_probe("pen").tip_radius_m
    return float(with_defaults(mechanics).stiffness_n_m * ratio ** (1.0 / 3.0))


def contact_stiffness(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Return the tangent stiffness of the contact [N/m] at normal forces.

    Parameters
    ----------
    mechanics : Mechanics
        Mechanics of the material.
    probe : Probe
        The probe.
    force_n : array_like
        Normal force [N].

    Returns
    -------
    ndarray, shape of `force_n`
        Stiffness [N/m]; 0 where F ≤ 0 (no contact).

    Notes
    -----
    Hertzian growth k ∝ F^(1/3) of the surface, in series with the probe's own stiffness.
    """
    force = np.maximum(np.asarray(force_n, dtype=np.float64), 0.0)
    surface = surface_stiffness_at_1n(mechanics, probe) * np.cbrt(force)
    return np.asarray(surface * probe.stiffness_n_m / (surface + probe.stiffness_n_m))


def compute_bristles(mechanics: Mechanics, probe: Probe) -> tuple[float, float]:
    """Return the stiffness σ0 [1/m] and damping σ1 [s/m] per load of LuGre's bristles at 1 N.

    σ0 by Mindlin from the normal stiffness at 1 N, σ1 from the normal damping ratio.
    """
    normal = surface_stiffness_at_1n(mechanics, probe)
    if probe.soft_tip:
        normal = float(contact_stiffness(mechanics, probe, 1.0))
    stiffness = TANGENTIAL_OVER_NORMAL * normal
    return stiffness, 2.0 * with_defaults(mechanics).damping_ratio * float(np.sqrt(stiffness * probe.mass_kg))


def contact_radius(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Return the radius of the contact disc [m] at normal forces.

    Parameters
    ----------
    mechanics : Mechanics
        Mechanics of the material.
    probe : Probe
        The probe.
    force_n : array_like
        Normal force [N].

    Returns
    -------
    ndarray, shape of `force_n`
        Radius [m]; 0 where F ≤ 0 (no contact).

    Notes
    -----
    Hertz with E* eliminated, F = (2/3) k a² / R, gives a = sqrt(3 F R / 2k). It is capped at the tip radius R, beyond
    which Hertz's parabola no longer resembles the sphere (soft foam). k is the surface's stiffness, in series with the
    pad of a soft tip; a stiff tip's shaft does not widen the contact.
    """
    force = np.maximum(np.asarray(force_n, dtype=np.float64), 0.0)
    stiffness = surface_stiffness_at_1n(mechanics, probe) * np.cbrt(force)
    if probe.soft_tip:
        stiffness = contact_stiffness(mechanics, probe, force)
    area = np.divide(1.5 * force * probe.tip_radius_m, stiffness, out=np.zeros_like(stiffness), where=stiffness > 0.0)
    return np.asarray(np.minimum(np.sqrt(area), probe.tip_radius_m))


def tip_gain(wavenumber_cycles_m: Float, radius_m: Float) -> Float:
    """Return the gain, 0 to 1, of a ripple of wavenumber κ under a contact of a finite radius; both broadcast.

    Parameters
    ----------
    wavenumber_cycles_m : ndarray
        Wavenumber κ [cycles/m].
    radius_m : ndarray
        Radius of the contact, from `contact_radius` [m].

    Notes
    -----
    The Hertzian pressure sqrt(1 − r²/a²) averages the profile. Its transform 3 (sin q − q cos q) / q³, q = 2πκa, is
    replaced by the Gaussian of equal curvature, exp(−q²/10), which has no negative lobes.
    """
    return np.asarray(np.exp(-np.square(2.0 * np.pi * wavenumber_cycles_m * radius_m) / 10.0))


def height_response(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Complex:
    """Return the response from profile height [m] to probe acceleration along the normal [m/s²]; arguments broadcast.

    Parameters
    ----------
    frequency_hz : array_like
        Frequency [Hz].
    mechanics : Mechanics
        Mechanics of the material.
    probe : Probe
        The probe.
    force_n : array_like
        Normal force [N].

    Returns
    -------
    ndarray of complex128
        Acceleration per height [(m/s²)/m]; 0 without contact.

    Notes
    -----
    Base excitation (Rao, ch. 3): m ẍ = k (h − x) + c (ḣ − ẋ), so H = −ω² (k + iωc) / (k − mω² + iωc) with c = 2ζ sqrt(k
    m). Far below the resonance the probe follows the profile (−ω²). The profile height is that already averaged by the
    tip (`tip_gain`); a linear model cannot represent loss of contact. The response of the probe's body is included.
    """
    omega, stiffness, damper, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    spring_and_damper: Complex = np.asarray(stiffness + 1j * omega * damper, dtype=np.complex128)
    body = body_response(frequency_hz, probe)
    return _divide_or_zero(np.asarray(-np.square(omega) * spring_and_damper * body), denominator)


def power_gain(omega_squared: Float, stiffness: ArrayLike, damping: ArrayLike, mass_kg: ArrayLike) -> Float:
    """Return |acceleration / height|² at ω² for stiffness k, squared damping 4ζ²km and mass m; arguments broadcast."""
    spring, damping_term = (
        np.asarray(stiffness, dtype=np.float64),
        np.asarray(damping, dtype=np.float64) * omega_squared,
    )
    numerator = np.square(omega_squared) * (np.square(spring) + damping_term)
    denominator = np.square(spring - np.asarray(mass_kg, dtype=np.float64) * omega_squared) + damping_term
    return np.divide(
        numerator,
        denominator,
        out=np.zeros(np.broadcast_shapes(numerator.shape, denominator.shape)),
        where=denominator != 0.0,
    )


def force_response(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Complex:
    """Return the response from pressing force [N] to probe acceleration along the normal [m/s²]; arguments broadcast.

    Parameters
    ----------
    frequency_hz : array_like
        Frequency [Hz].
    mechanics : Mechanics
        Mechanics of the material.
    probe : Probe
        The probe.
    force_n : array_like
        Normal force at which the contact is linearised [N]; for an onset, the force that is reached.

    Returns
    -------
    ndarray of complex128
        Acceleration per force [1/kg].

    Notes
    -----
    m ẍ + c ẋ + k x = −F, so H = ω² / (k − mω² + iωc): 0 for slow pressing, −1/m for a blow. The response of the probe's
    body is included.
    """
    omega, _, _, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    return _divide_or_zero(np.asarray(np.square(omega) * body_response(frequency_hz, probe)), denominator)


def body_response(frequency_hz: ArrayLike, probe: Probe) -> Complex:
    """Return the response from acceleration of the tip to that felt at the probe's body, 1 for a rigid one.

    Parameters
    ----------
    frequency_hz : array_like
        Frequency [Hz].
    probe : Probe
        The probe.

    Returns
    -------
    ndarray of complex128, shape of `frequency_hz`
        Acceleration per acceleration.

    Notes
    -----
    1 + Σ g r² / (1 − r² + 2iζr) over the body's modes, r = f / f_mode: base excitation of a small oscillator (Rao, ch.
    3).
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    response = np.ones(frequency.shape, dtype=np.complex128)
    for mode in probe.body_modes:
        ratio = frequency / mode.frequency_hz
        response += mode.gain * np.square(ratio) / (1.0 - np.square(ratio) + 2j * mode.damping_ratio * ratio)
    return response


def friction_noise_power(
    low_cycles_m: ArrayLike, high_cycles_m: ArrayLike, mechanics: Mechanics, force_n: ArrayLike
) -> Float:
    """Return the power [N²] of the friction force's fluctuation between two wavenumbers; arguments broadcast.

    Parameters
    ----------
    low_cycles_m, high_cycles_m : array_like
        Wavenumbers along the path, above 0 [cycles/m].
    mechanics : Mechanics
        Mechanics of the material.
    force_n : array_like
        Normal force on a stiff tip [N].

    Returns
    -------
    ndarray
        Power of the force along the path.

    Notes
    -----
    ∫ B κ^−β dκ, with B from `Mechanics.friction_noise_n`, times F^2q, q = FRICTION_NOISE_FORCE_EXPONENT.
    """
    known, half = with_defaults(mechanics), np.sqrt(2.0)
    centre, slope = FRICTION_NOISE_WAVENUMBER, known.friction_noise_slope
    level = np.square(known.friction_noise_n) / integrate_power_law(centre / half, centre * half, slope)
    load = np.maximum(np.asarray(force_n, dtype=np.float64), 0.0) ** (2.0 * FRICTION_NOISE_FORCE_EXPONENT)
    return np.asarray(level * integrate_power_law(low_cycles_m, high_cycles_m, slope) * load)


def integrate_power_law(low_cycles_m: ArrayLike, high_cycles_m: ArrayLike, slope: float) -> Float:
    """Integrate (κ/κ₀)^−slope d(κ/κ₀) between wavenumbers [cycles/m], which broadcast.

    κ₀ is FRICTION_NOISE_WAVENUMBER.
    """
    exponent = 1.0 - slope
    start, end = (
        np.log(np.asarray(limit, dtype=np.float64) / FRICTION_NOISE_WAVENUMBER)
        for limit in (low_cycles_m, high_cycles_m)
    )
    if abs(exponent) < 1e-6:
        return np.asarray(end - start)
    return np.asarray((np.exp(exponent * end) - np.exp(exponent * start)) / exponent)


def resonance_hz(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Return the undamped contact resonance sqrt(k/m) / 2π [Hz] at normal forces [N]."""
    return np.asarray(np.sqrt(contact_stiffness(mechanics, probe, force_n) / probe.mass_kg) / (2.0 * np.pi))


def _oscillator_terms(
    frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike
) -> tuple[Float, Float, Float, Complex]:
    omega = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    stiffness = contact_stiffness(mechanics, probe, force_n)
    damper = 2.0 * with_defaults(mechanics).damping_ratio * np.sqrt(stiffness * probe.mass_kg)
    denominator = stiffness - probe.mass_kg * np.square(omega) + 1j * omega * damper
    return omega, stiffness, damper, np.asarray(denominator)


def _divide_or_zero(numerator: Complex, denominator: Complex) -> Complex:
    """Return numerator / denominator, and 0 where both vanish (no contact at zero frequency)."""
    numerator, denominator = np.broadcast_arrays(numerator, denominator)
    out = np.zeros(numerator.shape, dtype=np.complex128)
    return np.divide(numerator, denominator, out=out, where=denominator != 0.0)
