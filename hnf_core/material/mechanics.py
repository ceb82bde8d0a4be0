"""What a picture does not show: stiffness, damping and friction of a material, and the probe that touches it."""

from __future__ import annotations

from dataclasses import astuple, dataclass


@dataclass(frozen=True)
class Mechanics:
    """Contact properties; None = unknown (the field was trained with unknowns dropped at random).

    stiffness_n_m: contact stiffness at 1 N under the pen probe. damping_ratio: of the contact oscillator.
    friction: Coulomb μ.
    """

    stiffness_n_m: float | None = None
    damping_ratio: float | None = None
    friction: float | None = None


UNKNOWN = Mechanics()
MECHANICS_LIMITS = {"stiffness [N/m]": (1e-6, 1e12), "damping ratio": (0.0, 1e3), "friction": (0.0, 1e3)}
"""Of Mechanics, in its order: far outside any material, and well inside what the contact model can compute."""


def beyond_limits(mechanics: Mechanics) -> str:
    """The property that is no number within MECHANICS_LIMITS, in words; "" where there is none."""
    for (name, (low, high)), value in zip(MECHANICS_LIMITS.items(), astuple(mechanics), strict=True):
        if value is not None and not low <= value <= high:
            return f"{name} must be a number from {low:g} to {high:g}, not {value:g}."
    return ""


@dataclass(frozen=True)
class Probe:
    """What touches the surface. mass_kg: moving mass at the tip. tip_radius_m: radius of curvature.
    stiffness_n_m: the probe's own compliance, in series with the surface's. soft_tip: that compliance sits at the
    contact and widens it (a fingertip's pad); otherwise in the shaft, and only the surface gives way."""

    name: str
    mass_kg: float
    tip_radius_m: float
    stiffness_n_m: float
    soft_tip: bool = False


PROBES = {
    "pen": Probe("pen", mass_kg=0.035, tip_radius_m=0.5e-3, stiffness_n_m=4.0e5),
    "finger": Probe("finger", mass_kg=0.006, tip_radius_m=8.0e-3, stiffness_n_m=1.2e3, soft_tip=True),
}
