"""What a picture does not show: stiffness, damping and friction of a material.

The linear contact model that simulator and synthesis share: a mass (the probe) on a spring and damper (the contact)
that rides over the surface's profile.

Signs: heights and accelerations are positive along the surface normal, away from the material; forces are positive
where they press the probe onto it.

Sources: H. Hertz (1882), "Über die Berührung fester elastischer Körper", sphere on a half-space: F = (4/3) E* a³ / R,
dF/dδ = 2 E* a. K. L. Johnson (1985), Contact Mechanics, chs. 3–4 (contact in series, the Hertzian pressure).
Y. Tsuji, T. Tanaka & T. Ishida (1992), Powder Technology 71 (a damper that grows with the tangent stiffness, so that
the damping ratio is one number at every load). S. S. Rao, Mechanical Vibrations, ch. 3 (base excitation).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .probe import PROBES, Probe


@dataclass(frozen=True)
class Mechanics:
    """Contact properties; None = unknown (the field was trained with unknowns dropped at random).

    stiffness_n_m: contact stiffness at 1 N under the pen probe. damping_ratio: of the contact oscillator.
    friction: Coulomb μ.
    """

    stiffness_n_m: float | None = None
    damping_ratio: float | None = None
    friction: float | None = None


UNKNOWN_MECHANICS = Mechanics()
MECHANICS_NAMES = tuple(each.name for each in fields(Mechanics))
MECHANICS_LIMITS = {"stiffness [N/m]": (1e-6, 1e12), "damping ratio": (0.0, 1e3), "friction": (0.0, 1e3)}
"""Of Mechanics, in its order: far outside any material, and well inside what the contact model can compute."""


def describe_limit_violation(mechanics: Mechanics) -> str:
    """The property that is no number within MECHANICS_LIMITS, in words; "" where there is none."""
    for (name, (low, high)), value in zip(MECHANICS_LIMITS.items(), astuple(mechanics), strict=True):
        if value is not None and not low <= value <= high:
            return f"{name} must be a number from {low:g} to {high:g}, not {value:g}."
    return ""


Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

DEFAULT_STIFFNESS_N_M = 5.0e4
"""Contact stiffness assumed where it is unknown: between soft plastic and wood under the pen's tip at 1 N."""
DEFAULT_DAMPING_RATIO = 0.2
DEFAULT_FRICTION = 0.3
"""Median kinetic μ of the ten HaTT categories."""


@dataclass(frozen=True)
class KnownMechanics:
    """Mechanics with nothing left open; fields as in Mechanics."""

    stiffness_n_m: float
    damping_ratio: float
    friction: float


def with_defaults(mechanics: Mechanics) -> KnownMechanics:
    """Fill what is unknown (None) with the medium defaults above."""
    return KnownMechanics(
        DEFAULT_STIFFNESS_N_M if mechanics.stiffness_n_m is None else mechanics.stiffness_n_m,
        DEFAULT_DAMPING_RATIO if mechanics.damping_ratio is None else mechanics.damping_ratio,
        DEFAULT_FRICTION if mechanics.friction is None else mechanics.friction,
    )


def surface_stiffness_at_1n(mechanics: Mechanics, probe: Probe) -> float:
    """The surface's own Hertzian stiffness dF/dδ [N/m] at 1 N under this probe's tip.

    Mechanics gives it for the pen; k = (6 F R E*²)^(1/3) (Johnson 1985, eq. 4.23) carries it over to another radius.
    """
    ratio = probe.tip_radius_m / PROBES["pen"].tip_radius_m
    return float(with_defaults(mechanics).stiffness_n_m * ratio ** (1.0 / 3.0))


def contact_stiffness(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Tangent stiffness [N/m] of the contact at a normal force [N], the shape of force_n.

    Hertz growth k ∝ F^(1/3) of the surface, in series with the probe's own stiffness; 0 where F ≤ 0 (no contact).
    """
    force = np.maximum(np.asarray(force_n, dtype=np.float64), 0.0)
    surface = surface_stiffness_at_1n(mechanics, probe) * np.cbrt(force)
    return np.asarray(surface * probe.stiffness_n_m / (surface + probe.stiffness_n_m))


def contact_radius(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Radius [m] of the contact disc at a normal force [N], the shape of force_n.

    Hertz, with E* eliminated: F = (2/3) k a² / R, so a = sqrt(3 F R / 2k). Capped at the tip radius R, beyond which
    the parabola of Hertz no longer is the sphere (soft foam). k is the surface's own, in series with the pad of a soft
    tip; a shaft's spring widens nothing. 0 where F ≤ 0.
    """
    force = np.maximum(np.asarray(force_n, dtype=np.float64), 0.0)
    stiffness = surface_stiffness_at_1n(mechanics, probe) * np.cbrt(force)
    if probe.soft_tip:
        stiffness = contact_stiffness(mechanics, probe, force)
    area = np.divide(1.5 * force * probe.tip_radius_m, stiffness, out=np.zeros_like(stiffness), where=stiffness > 0.0)
    return np.asarray(np.minimum(np.sqrt(area), probe.tip_radius_m))


def tip_response(wavenumber_cycles_m: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """How much of a ripple of this wavenumber [cycles/m] the finite contact passes on, 0 … 1.

    The Hertzian pressure sqrt(1 − r²/a²) averages the profile; its transform 3 (sin q − q cos q) / q³, q = 2πκa, is
    replaced by the Gaussian of the same curvature exp(−q²/10), which has no negative lobes. Arguments broadcast.
    """
    return tip_gain(np.asarray(wavenumber_cycles_m, dtype=np.float64), contact_radius(mechanics, probe, force_n))


def tip_gain(wavenumber_cycles_m: Float, radius_m: Float) -> Float:
    """tip_response() of a contact of radius a [m]; arguments broadcast."""
    return np.asarray(np.exp(-np.square(2.0 * np.pi * wavenumber_cycles_m * radius_m) / 10.0))


def height_response(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Complex:
    """Profile height [m] → probe acceleration [m/s²] along the normal; complex, arguments broadcast.

    Base excitation: m ẍ = k (h − x) + c (ḣ − ẋ), so H = −ω² (k + iωc) / (k − mω² + iωc) with c = 2ζ sqrt(k m). Far
    below the resonance the probe follows the profile (−ω²); without contact (F = 0) nothing comes through. The height
    is what tip_response leaves of it; loss of contact is not in a linear model.
    """
    omega, stiffness, damper, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    spring_and_damper: Complex = np.asarray(stiffness + 1j * omega * damper, dtype=np.complex128)
    return _divide_or_zero(-np.square(omega) * spring_and_damper, denominator)


def height_power(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """|height_response|² [(m/s² per m)²], at a fifth of its cost; arguments broadcast."""
    square = np.square(2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64))
    stiffness = contact_stiffness(mechanics, probe, force_n)
    damping = 4.0 * with_defaults(mechanics).damping_ratio ** 2 * stiffness * probe.mass_kg
    return power_gain(square, stiffness, damping, np.asarray(probe.mass_kg))


def power_gain(omega_squared: Float, stiffness: ArrayLike, damping: ArrayLike, mass_kg: ArrayLike) -> Float:
    """height_power() at ω² of a contact of stiffness k and damping c² = 4 ζ² k m; arguments broadcast."""
    spring, damped = np.asarray(stiffness, dtype=np.float64), np.asarray(damping, dtype=np.float64) * omega_squared
    above = np.square(omega_squared) * (np.square(spring) + damped)
    below = np.square(spring - np.asarray(mass_kg, dtype=np.float64) * omega_squared) + damped
    return np.divide(above, below, out=np.zeros(np.broadcast_shapes(above.shape, below.shape)), where=below != 0.0)


def force_response(frequency_hz: ArrayLike, mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Complex:
    """Change of pressing force [N] → probe acceleration [m/s²] along the normal; complex, arguments broadcast.

    m ẍ + c ẋ + k x = −F, so H = ω² / (k − mω² + iωc): 0 for slow pressing, −1/m for a blow. force_n is the load at
    which the contact is linearised (for an onset: the load that is reached).
    """
    omega, _, _, denominator = _oscillator_terms(frequency_hz, mechanics, probe, force_n)
    return _divide_or_zero(np.asarray(np.square(omega), dtype=np.complex128), denominator)


def resonance_hz(mechanics: Mechanics, probe: Probe, force_n: ArrayLike) -> Float:
    """Undamped resonance sqrt(k/m) / 2π of probe on contact."""
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
    """numerator / denominator, and 0 where both vanish (no contact at zero frequency)."""
    numerator, denominator = np.broadcast_arrays(numerator, denominator)
    out = np.zeros(numerator.shape, dtype=np.complex128)
    return np.divide(numerator, denominator, out=out, where=denominator != 0.0)
