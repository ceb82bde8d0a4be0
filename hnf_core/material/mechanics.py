"""What a picture does not show: stiffness, damping and friction of a material."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields


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
