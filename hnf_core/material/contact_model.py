"""Mechanics of a material, and the linear contact model: a probe's mass on the spring and damper of the contact.

Stiffness, damping and friction go in; responses from surface profile or force to acceleration come out. Heights and
accelerations are positive along the surface normal, away from the material; forces are positive if they press the probe
onto it.

Sources: H. Hertz (1882), Über die Berührung fester elastischer Körper: sphere on a half-space, F = (4/3) E* a³ / R,
dF/dδ = 2 E* a. K. L. Johnson (1985), Contact Mechanics, chs. 3–4 (contact in series, Hertzian pressure). Y. Tsuji, T.
Tanaka & T. Ishida (1992), Powder Technology 71 (damper that grows with the tangent stiffness, so that the damping ratio
is the same at every load). S. S. Rao, Mechanical Vibrations, ch. 3 (base excitation).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .probe import PROBES, Probe


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
    """

    stiffness_n_m: float | None = None
    damping_ratio: float | None = None
    friction: float | None = None


UNKNOWN_MECHANICS = Mechanics()
MECHANICS_NAMES = tuple(each.name for each in fields(Mechanics))
MECHANICS_LIMITS = {"stiffness [N/m]": (1e-6, 1e12), "damping ratio": (0.0, 1e3), "friction": (0.0, 1e3)}
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


@dataclass(frozen=True)
class KnownMechanics:
    """Stiffness [N/m], damping ratio and friction as in `Mechanics`, without unknown values."""

    stiffness_n_m: float
    damping_ratio: float
    friction: float


def with_defaults(mechanics: Mechanics) -> KnownMechanics:
    """Replace unknown values (None) of the mechanics by DEFAULT_STIFFNESS_N_M and the other defaults above."""
    return KnownMechanics(
        DEFAULT_STIFFNESS_N_M if mechanics.stiffness_n_m is None else mechanics.stiffness_n_m,
        DEFAULT_DAMPING_RATIO if mechanics.damping_ratio is None else mechanics.damping_ratio,
        DEFAULT_FRICTION if mechanics.friction is None else mechanics.friction,
    )


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
    ratio = probe.tip_radius_m / PROBES["pen"].tip_radius_m
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


def tip_response(wavenumber_cycles_m: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Return the gain, 0 to 1, of a ripple of a wavenumber under a contact of finite radius; arguments broadcast.

    Parameters
    ----------
    wavenumber_cycles_m : array_like
        Wavenumber κ [cycles/m].
    mechanics : Mechanics
        Mechanics of the material.
    probe : Probe
        The probe.
    force_n : array_like
        Normal force [N].

    Returns
    -------
    ndarray
        The gain.

    Notes
    -----
    The Hertzian pressure sqrt(1 − r²/a²) averages the profile. Its transform 3 (sin q − q cos q) / q³, q = 2πκa, is
    replaced by the Gaussian of equal curvature, exp(−q²/10), which has no negative lobes.
    """
    return tip_gain(np.asarray(wavenumber_cycles_m, dtype=np.float64), contact_radius(mechanics, probe, force_n))


def tip_gain(wavenumber_cycles_m: Float, radius_m: Float) -> Float:
    """Return the gain of `tip_response` for a contact radius [m] in place of mechanics and force; both broadcast."""
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
    tip (`tip_response`); a linear model cannot represent loss of contact.
    """
    omega, stiffness, damper, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    spring_and_damper: Complex = np.asarray(stiffness + 1j * omega * damper, dtype=np.complex128)
    return _divide_or_zero(-np.square(omega) * spring_and_damper, denominator)


def height_power(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Return |height_response|² [((m/s²)/m)²], at a fifth of its cost; same arguments, which broadcast."""
    square = np.square(2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64))
    stiffness = contact_stiffness(mechanics, probe, force_n)
    damping = 4.0 * with_defaults(mechanics).damping_ratio ** 2 * stiffness * probe.mass_kg
    return power_gain(square, stiffness, damping, np.asarray(probe.mass_kg))


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
    m ẍ + c ẋ + k x = −F, so H = ω² / (k − mω² + iωc): 0 for slow pressing, −1/m for a blow.
    """
    omega, _, _, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    return _divide_or_zero(np.asarray(np.square(omega), dtype=np.complex128), denominator)


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
