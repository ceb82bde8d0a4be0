"""What synthesis is given and what it gives back.

The action on the field's own clocks: states at 200 Hz, and what is read between them at 10 kHz.

Where the hand is between the states of the action.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import StrokeError
from ..kernel import compiled_carriers as kernel_hop
from ..kernel.loader import load_kernel
from ..material.contact_model import MECHANICS_LIMITS, Mechanics
from ..material.probe import PROBES
from ..material.token import LARGEST_VALUE, TOKEN_DIM
from ..signal import Signal
from .carriers import MODEL_RATE_HZ
from .field import Field
from .linear_contact import Condition

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


Float = NDArray[np.float64]

SAMPLES_PER_STATE = round(MODEL_RATE_HZ / ACTION_RATE_HZ)
STATE_FRACTIONS = np.arange(SAMPLES_PER_STATE) / SAMPLES_PER_STATE
"""Of the way from a state to the next, at the samples between them."""


def resample_action(stroke: StrokeInput) -> tuple[Action, NDArray[np.int32]]:
    """The action and token index at ACTION_RATE_HZ.

    Another rate is interpolated: direction as a vector (an angle would turn the long way round at ±180°), contact and
    material by the nearest sample. Raises StrokeError for an action without duration.
    """
    action = stroke.action
    if len(action.speed) < 2:
        raise StrokeError("the action has no duration.", where="stroke input", remedy="Give at least two samples.")
    if action.rate == ACTION_RATE_HZ:
        return action, stroke.token_index
    count = int(np.floor(action.duration_s * ACTION_RATE_HZ + 1e-6)) + 1
    if count < 2:
        raise StrokeError("the action is shorter than 5 ms.", where="stroke input", remedy="Make it longer.")
    time, source = np.arange(count) / ACTION_RATE_HZ, action.time
    direction = np.stack([np.interp(time, source, action.direction[:, axis]) for axis in range(2)], axis=1)
    nearest = np.minimum(np.rint(time * action.rate).astype(int), len(source) - 1)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    resampled = Action(
        rate=ACTION_RATE_HZ,
        direction=np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest]),
        speed=np.interp(time, source, action.speed),
        force=np.interp(time, source, action.force),
        position=interpolate_cubic(action.position, time * action.rate),
        contact=action.contact[nearest],
        probe=action.probe,
    )
    return resampled, stroke.token_index[nearest]


def build_condition(stroke: StrokeInput, action: Action, token_index: NDArray[np.int32]) -> Condition:
    """F_Θ's condition at every state."""
    tokens, (mechanics, of_row) = (
        stroke.tokens.astype(np.float64)[token_index],
        find_distinct_mechanics(stroke.mechanics),
    )
    return Condition(
        tokens,
        mechanics,
        of_row[token_index],
        action.direction,
        action.speed,
        action.force,
        action.contact,
        action.probe,
    )


def find_distinct_mechanics(mechanics: Sequence[Mechanics]) -> tuple[tuple[Mechanics, ...], NDArray[np.int32]]:
    """Each once, in the order in which they are met, and (M,) which of them each is: the patches of a surface have a
    token each and mostly one mechanics."""
    index: dict[Mechanics, int] = {}
    of_row = [index.setdefault(each, len(index)) for each in mechanics]
    return tuple(index), np.array(of_row, dtype=np.int32)


def interpolate_condition(
    stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], sample: NDArray[np.int64]
) -> Condition:
    """The same at samples of the model rate, clamped to the stroke: linear between states, direction as a vector,
    contact and material those of the nearest. action: at ACTION_RATE_HZ."""
    place = np.clip(sample / SAMPLES_PER_STATE, 0, len(action.speed) - 1)
    states, nearest = np.arange(len(action.speed)), np.rint(place).astype(np.int64)
    direction = np.empty((len(place), 2))
    for axis in range(2):
        direction[:, axis] = np.interp(place, states, action.direction[:, axis])
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest])
    material = token_index[nearest]
    speed, force = (np.interp(place, states, values) for values in (action.speed, action.force))
    tokens, contact = stroke.tokens.astype(np.float64)[material], action.contact[nearest]
    mechanics, of_row = find_distinct_mechanics(stroke.mechanics)
    return Condition(tokens, mechanics, of_row[material], direction, speed, force, contact, action.probe)


def select_states(condition: Condition, rows: slice | NDArray[np.bool_]) -> Condition:
    """The states in rows alone."""
    names = ("tokens", "material", "direction", "speed", "force", "contact")
    return replace(condition, **{name: getattr(condition, name)[rows] for name in names})


def sample_count(action: Action) -> int:
    """Samples at the model rate."""
    return (len(action.speed) - 1) * SAMPLES_PER_STATE


def find_peak_speed(action: Action) -> Float:
    """(n,) m/s |ds/dt| within two states of each."""
    around = np.pad(np.abs(np.diff(action.position)) * ACTION_RATE_HZ, 2)
    return np.asarray(np.max([around[k : k + len(action.position)] for k in range(4)], axis=0))


def interpolate_cubic(values: Float, index: Float) -> Float:
    """Catmull–Rom interpolation of values (n,) at fractional indices, held beyond the ends; C1."""
    last = len(values) - 1
    index = np.clip(index, 0.0, last)
    low = np.minimum(np.floor(index).astype(int), max(last - 1, 0))
    t = index - low
    padded = np.concatenate(
        [[2 * values[0] - values[min(1, last)]], values, [2 * values[-1] - values[max(last - 1, 0)]]]
    )
    weights = _catmull_rom_weights(t)
    return np.asarray(sum(w * padded[np.minimum(low + k, last + 2)] for k, w in enumerate(weights)))


def evaluate_bspline(values: Float, index: Float) -> Float:
    """Cubic B-spline with values (n,) as control points, read at fractional indices, held beyond the ends; C2.

    It smooths (−3 dB at about 60 Hz of 200 Hz samples) instead of interpolating: its images of a slow ramp lie 80 dB
    down, so that action-rate steps do not hum through a contact that answers to F″.
    """
    last = len(values) - 1
    low = np.floor(index).astype(int)
    weights = _bspline_weights(index - low)
    return np.asarray(sum(w * values[np.clip(low + k - 1, 0, last)] for k, w in enumerate(weights)))


def interpolate_cubic_samples(values: Float, start: int, count: int) -> Float:
    """cubic() of states (n,) at samples start … start + count − 1 of the model rate, (count,).

    A state's samples lie at the same shares of the way to the next: their weights are the same for every state.
    """
    last = len(values) - 1
    ends = 2 * values[0] - values[min(1, last)], 2 * values[-1] - values[max(last - 1, 0)]
    padded = np.concatenate([ends[:1], values, ends[1:]])
    first = start // SAMPLES_PER_STATE
    state = np.arange(first, (start + max(count, 1) - 1) // SAMPLES_PER_STATE + 1)[:, None]
    four = padded[np.clip(state + np.arange(4), 0, last + 2)]
    four = np.where(state < 0, values[0], np.where(state >= last, values[-1], four))
    out = four[:, :1] * _CATMULL_ROM_TABLE[0]
    for tap in range(1, 4):
        out += four[:, tap : tap + 1] * _CATMULL_ROM_TABLE[tap]
    return np.asarray(out.reshape(-1)[start - first * SAMPLES_PER_STATE :][:count])


def _catmull_rom_weights(t: Float) -> tuple[Float, ...]:
    """Catmull–Rom weights of the four values about a place, t on the way from the second to the third."""
    return (
        0.5 * t * (2.0 * t - 1.0 - t**2),
        1.0 + t**2 * (1.5 * t - 2.5),
        0.5 * t * (1.0 + 4.0 * t - 3.0 * t**2),
        0.5 * t**2 * (t - 1.0),
    )


def _bspline_weights(t: Float) -> tuple[Float, ...]:
    """The same of the cubic B-spline."""
    return (
        (1.0 - t) ** 3 / 6.0,
        (3.0 * t**3 - 6.0 * t**2 + 4.0) / 6.0,
        (-3.0 * t**3 + 3.0 * t**2 + 3.0 * t + 1.0) / 6.0,
        t**3 / 6.0,
    )


_CATMULL_ROM_TABLE = _catmull_rom_weights(STATE_FRACTIONS)


def interpolate_position(action: Action, start: int, count: int) -> Float:
    """s(t) [m] at samples start … of the model rate, held beyond the stroke."""
    return interpolate_cubic_samples(action.position, start, count)


def extrapolate_position(action: Action, start: int, count: int) -> Float:
    """position() that goes on as fast as it began and ended, for filters that look beyond the stroke."""
    compiled = load_kernel()
    if compiled is not None:
        path = np.ascontiguousarray(action.position, dtype=np.float64)
        return kernel_hop.interpolate_position(compiled, path, SAMPLES_PER_STATE, start, count)
    sample = start + np.arange(count)
    last = (len(action.position) - 1) * SAMPLES_PER_STATE
    ends = interpolate_cubic(action.position, np.array([0.0, 1.0, last - 1.0, last]) / SAMPLES_PER_STATE)
    speed = np.where(sample < 0, ends[1] - ends[0], ends[3] - ends[2])
    beyond = sample - np.clip(sample, 0, last)
    return np.asarray(interpolate_position(action, start, count) + beyond * speed)
