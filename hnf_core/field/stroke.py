"""What synthesis is given and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import StrokeError
from ..material.mechanics import Mechanics
from ..material.token import TOKEN_DIM
from ..signal import Signal


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
    Raises StrokeError where these do not fit together.
    """

    action: Action
    tokens: NDArray[np.float32]
    mechanics: tuple[Mechanics, ...]
    token_index: NDArray[np.int32]
    profile: HeightProfile | None = None

    def __post_init__(self) -> None:
        problem = _problem(self)
        if problem:
            raise StrokeError(problem, where="stroke input", remedy="Give arrays of matching length without NaN.")


@dataclass(frozen=True)
class Synthesis:
    """signal: the vibration. confidence: 0 … 1, lowered by every extrapolation. warnings: each in words."""

    signal: Signal
    confidence: float
    warnings: tuple[str, ...] = ()


def uniform_stroke(action: Action, token: NDArray[np.float32], mechanics: Mechanics) -> StrokeInput:
    """A stroke on one material."""
    return StrokeInput(action, token[None, :], (mechanics,), np.zeros(len(action.speed), dtype=np.int32))


def _problem(stroke: StrokeInput) -> str:
    action, samples = stroke.action, len(stroke.action.speed)
    columns = (action.speed, action.force, action.position, action.direction)
    if stroke.tokens.ndim != 2 or stroke.tokens.shape[1] != TOKEN_DIM:
        return f"tokens have shape {stroke.tokens.shape}, not (M, {TOKEN_DIM})."
    if len(stroke.mechanics) != len(stroke.tokens):
        return f"{len(stroke.tokens)} tokens but {len(stroke.mechanics)} mechanics."
    if stroke.token_index.shape != (samples,):
        return f"token_index has shape {stroke.token_index.shape}, not ({samples},)."
    if samples and not 0 <= int(stroke.token_index.min()) <= int(stroke.token_index.max()) < len(stroke.tokens):
        return f"token_index points outside the {len(stroke.tokens)} tokens."
    if not all(np.isfinite(column).all() for column in (*columns, stroke.tokens)):
        return "the action or a token holds NaN or infinity."
    if samples and (action.speed.min() < 0.0 or action.force.min() < 0.0):
        return "speed and force must not be negative."
    profile = stroke.profile
    if profile is not None and not (profile.step_m > 0.0 and np.isfinite(profile.height).all()):
        return "the height profile holds NaN or has no positive step."
    return ""
