"""What synthesis is given and what it gives back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import StrokeError
from ..material.mechanics import MECHANICS_LIMITS, Mechanics
from ..material.probe import PROBES
from ..material.token import LARGEST_VALUE, TOKEN_DIM
from ..signal import Signal
from .field import Field

LIMITS = {
    "action rate [Hz]": (1e-3, 1e6),
    "speed [m/s]": (0.0, 1e4),
    "force [N]": (0.0, 1e7),
    "position [m]": (-1e7, 1e7),
    "direction": (-1.001, 1.001),
    "token": (-LARGEST_VALUE, LARGEST_VALUE),
    **MECHANICS_LIMITS,
    "profile height [m]": (-1e6, 1e6),
    "profile origin [m]": (-1e7, 1e7),
    "profile step [m]": (1e-9, 1e6),
    "resolved wavelength [m]": (0.0, 1e6),
}
"""What is refused beyond: far outside any touch, and well inside what float64 carries through the field's powers.
A test holds that nothing within them gives NaN or infinity."""

_REMEDY = (
    "Check the scene's unit scale and the stroke's length, duration and force; from a program: give arrays of matching "
    "length without NaN."
)


@dataclass(frozen=True)
class HeightProfile:
    """Surface height under the path, along Action.position.

    step_m: sample spacing. origin_m: position of the first sample. height: (k,) float64 metres. resolved_wavelength_m:
    shorter waves than this are an artefact of the source (two texels) and are left to the carriers.
    """

    step_m: float
    origin_m: float
    height: NDArray[np.float64]
    resolved_wavelength_m: float


@dataclass(frozen=True)
class StrokeInput:
    """One stroke as the field needs it.

    action: u(t). tokens: (M, TOKEN_DIM) the materials it meets. mechanics: (M,) of the same materials. token_index:
    (n,) int32, which material at each action sample. profile: height under the path, or None where none is resolved.
    fields: (M,) what was trained for each material alone, None = nothing; () = for none of them. It is parts.py that
    asks for them.
    Raises StrokeError where these do not fit together or leave LIMITS.
    """

    action: Action
    tokens: NDArray[np.float32]
    mechanics: tuple[Mechanics, ...]
    token_index: NDArray[np.int32]
    profile: HeightProfile | None = None
    fields: tuple[Field | None, ...] = ()

    def __post_init__(self) -> None:
        problem = _find_problem(self)
        if problem:
            raise StrokeError(problem, where="stroke input", remedy=_REMEDY)


@dataclass(frozen=True)
class Synthesis:
    """signal: the vibration. confidence: 0 … 1, lowered by every extrapolation. warnings: each in words."""

    signal: Signal
    confidence: float
    warnings: tuple[str, ...] = ()


def uniform_stroke(action: Action, token: NDArray[np.float32], mechanics: Mechanics) -> StrokeInput:
    """A stroke on one material."""
    return StrokeInput(action, token[None, :], (mechanics,), np.zeros(len(action.speed), dtype=np.int32))


def _find_problem(stroke: StrokeInput) -> str:
    action, samples = stroke.action, len(stroke.action.speed)
    if action.speed.ndim != 1:
        return f"speed has shape {action.speed.shape}, not (n,)."
    wanted = {"direction": (samples, 2), "force": (samples,), "position": (samples,), "contact": (samples,)}
    for name, shape in wanted.items():
        if getattr(action, name).shape != shape:
            return f"{name} has shape {getattr(action, name).shape}, not {shape}."
    if action.probe not in PROBES:
        return f"there is no probe {action.probe!r}, only {' and '.join(PROBES)}."
    if stroke.tokens.ndim != 2 or stroke.tokens.shape[1] != TOKEN_DIM:
        return f"tokens have shape {stroke.tokens.shape}, not (M, {TOKEN_DIM})."
    if len(stroke.mechanics) != len(stroke.tokens):
        return f"{len(stroke.tokens)} tokens but {len(stroke.mechanics)} mechanics."
    if stroke.fields and len(stroke.fields) != len(stroke.tokens):
        return f"{len(stroke.tokens)} tokens but {len(stroke.fields)} fields."
    if stroke.token_index.shape != (samples,):
        return f"token_index has shape {stroke.token_index.shape}, not ({samples},)."
    if samples and not 0 <= int(stroke.token_index.min()) <= int(stroke.token_index.max()) < len(stroke.tokens):
        return f"token_index points outside the {len(stroke.tokens)} tokens."
    if samples and (action.speed.min() < 0.0 or action.force.min() < 0.0):
        return "speed and force must not be negative."
    for name, values in _bounded_values(stroke):
        low, high = LIMITS[name]
        if values.size and not (values.min() >= low and values.max() <= high):
            return f"{name} holds NaN or leaves {low:g} … {high:g}: {values.min():g} … {values.max():g}."
    return ""


def _bounded_values(stroke: StrokeInput) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Everything that LIMITS bound, by its name there; unknown mechanics left out."""
    action, profile = stroke.action, stroke.profile
    yield "action rate [Hz]", np.array([action.rate])
    yield "speed [m/s]", action.speed
    yield "force [N]", action.force
    yield "position [m]", action.position
    yield "direction", action.direction
    yield "token", stroke.tokens.astype(np.float64)
    mechanics = stroke.mechanics
    yield "stiffness [N/m]", _known_values(each.stiffness_n_m for each in mechanics)
    yield "damping ratio", _known_values(each.damping_ratio for each in mechanics)
    yield "friction", _known_values(each.friction for each in mechanics)
    if profile is not None:
        yield "profile step [m]", np.array([profile.step_m])
        yield "profile height [m]", profile.height
        yield "profile origin [m]", np.array([profile.origin_m])
        yield "resolved wavelength [m]", np.array([profile.resolved_wavelength_m])


def _known_values(values: Iterable[float | None]) -> NDArray[np.float64]:
    return np.array([value for value in values if value is not None], dtype=np.float64)
