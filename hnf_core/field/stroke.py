"""Input and output of synthesis, and a stroke's action resampled to the field's states (200 Hz) and samples (10 kHz).

`StrokeInput` holds the action and the materials, and is checked against LIMITS; `Synthesis` is the result. The other
functions resample the action to the states, build F_Θ's conditions, and interpolate position and force between states.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action, ForceCurve
from ..errors import StrokeError
from ..kernel import compiled_carriers
from ..kernel.loader import load_kernel
from ..material.contact_model import MECHANICS_LIMITS, Mechanics
from ..material.probe import PROBE_NAMES, is_probe
from ..material.token import LARGEST_VALUE, TOKEN_DIM
from ..signal import Signal
from .carriers import MODEL_RATE_HZ
from .contact.lattice_lines import Lines
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
    "profile seam [m]": (-1e6, 1e6),
    "profile origin [m]": (-1e7, 1e7),
    "profile step [m]": (1e-9, 1e6),
    "resolved wavelength [m]": (0.0, 1e6),
}
"""Accepted range of every quantity: far beyond any touch, and well within what float64 carries through the field. A
test checks that nothing within them gives NaN or infinity."""

_REMEDY = (
    "Check the scene's unit scale and the stroke's length, duration and force; from a program: give arrays of matching "
    "length without NaN."
)


@dataclass(frozen=True)
class HeightProfile:
    """Measured surface height under the path of a stroke, on an even grid of Action.position.

    Attributes
    ----------
    step_m
        Sample spacing.
    origin_m
        Position of the first sample.
    height
        (k,) float64 [m].
    resolved_wavelength_m
        Two texels of the source: shorter waves in it are an artefact, and are synthesised by the noise carriers
        instead.
    seam
        (k,) float64 part of the height that is steps between objects, and no texture [m]; None without any.
    """

    step_m: float
    origin_m: float
    height: NDArray[np.float64]
    resolved_wavelength_m: float
    seam: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class StrokeInput:
    """One stroke, as the field needs it.

    Attributes
    ----------
    action
        Motion and force of the hand u(t), n samples at any rate.
    tokens
        (M, TOKEN_DIM) descriptors of the M materials touched.
    mechanics
        (M,) stiffness, damping and friction of the same materials.
    token_index
        (n,) int32, material at each action sample.
    profile
        Height of the surface under the path, or None if none is resolved.
    fields
        (M,) field trained on that material alone, None for the shared field; () if no material has its own. Only
        synthesis.split_by_field reads it.

    Raises
    ------
    StrokeError
        If these do not fit together or leave LIMITS.
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
    """Result of synthesis.

    signal: the vibration. confidence: 0 … 1, lowered by every extrapolation. warnings: in words.
    """

    signal: Signal
    confidence: float
    warnings: tuple[str, ...] = ()


def uniform_stroke(action: Action, token: NDArray[np.float32], mechanics: Mechanics) -> StrokeInput:
    """Build a stroke on one material.

    Parameters
    ----------
    action
        Motion and force of the hand u(t), n samples.
    token
        (TOKEN_DIM,) descriptor of the material.
    mechanics
        Its stiffness, damping and friction.

    Returns
    -------
    StrokeInput
        Without height profile.
    """
    return StrokeInput(action, token[None, :], (mechanics,), np.zeros(len(action.speed), dtype=np.int32))


def _find_problem(stroke: StrokeInput) -> str:
    """Return the first problem of a stroke in words, "" if there is none."""
    action, samples = stroke.action, len(stroke.action.speed)
    if action.speed.ndim != 1:
        return f"speed has shape {action.speed.shape}, not (n,)."
    shapes = {"direction": (samples, 2), "force": (samples,), "position": (samples,), "contact": (samples,)}
    for name, shape in shapes.items():
        if getattr(action, name).shape != shape:
            return f"{name} has shape {getattr(action, name).shape}, not {shape}."
    if not is_probe(action.probe):
        return f"there is no probe {action.probe!r}, only {', '.join(PROBE_NAMES)} and files."
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
    """Yield (name, values) of every quantity that LIMITS bounds, without unknown mechanics."""
    action, profile = stroke.action, stroke.profile
    yield "action rate [Hz]", np.array([action.rate])
    yield "speed [m/s]", action.speed
    yield "force [N]", action.force
    if action.force_curve is not None:
        yield "force [N]", action.force_curve.force_n
    yield "position [m]", action.position
    yield "direction", action.direction
    yield "token", stroke.tokens.astype(np.float64)
    mechanics = stroke.mechanics
    yield "stiffness [N/m]", _known_values(properties.stiffness_n_m for properties in mechanics)
    yield "damping ratio", _known_values(properties.damping_ratio for properties in mechanics)
    yield "friction", _known_values(properties.friction for properties in mechanics)
    yield "friction noise [N]", _known_values(properties.friction_noise_n for properties in mechanics)
    yield "friction noise slope", _known_values(properties.friction_noise_slope for properties in mechanics)
    yield "pile [m]", _known_values(properties.pile_m for properties in mechanics)
    yield "thread spacing [m]", _known_values(properties.thread_spacing_m for properties in mechanics)
    yield "pitch scatter [m]", _known_values(properties.pitch_scatter_m for properties in mechanics)
    if profile is not None:
        yield "profile step [m]", np.array([profile.step_m])
        yield "profile height [m]", profile.height
        yield "profile seam [m]", np.zeros(0) if profile.seam is None else profile.seam
        yield "profile origin [m]", np.array([profile.origin_m])
        yield "resolved wavelength [m]", np.array([profile.resolved_wavelength_m])


def _known_values(values: Iterable[float | None]) -> NDArray[np.float64]:
    return np.array([value for value in values if value is not None], dtype=np.float64)


Float = NDArray[np.float64]

_LEAST_TOUCH_N = 1e-3
"""Force at a state that is touched only between it and the next [N]: far below what F_Θ gives anything for."""
SAMPLES_PER_STATE = round(MODEL_RATE_HZ / ACTION_RATE_HZ)
STATE_FRACTIONS = np.arange(SAMPLES_PER_STATE) / SAMPLES_PER_STATE
"""Fractions of the way from a state to the next, at the samples between them."""


def resample_action(stroke: StrokeInput) -> tuple[Action, NDArray[np.int32]]:
    """Resample a stroke's action, and the index of the material touched, to ACTION_RATE_HZ.

    Direction is interpolated as a vector, because an angle would turn the long way round at ±180°; contact and material
    are those of the nearest sample.

    Parameters
    ----------
    stroke
        The stroke.

    Returns
    -------
    action : Action
        At ACTION_RATE_HZ.
    token_index : ndarray
        (n,) int32 index of the material at each state.

    Raises
    ------
    StrokeError
        If the action has no duration.
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
    force, contact, curve = np.interp(time, source, action.force), action.contact[nearest], action.force_curve
    if action.rate > ACTION_RATE_HZ and curve is None:
        curve = ForceCurve(source, np.where(action.contact, action.force, 0.0))
        touched = curve.touches_near(time) & ~contact
        # A tap between two states must touch at one of them, where a state's own force may be 0.
        contact, force = contact | touched, np.where(touched, np.maximum(force, _LEAST_TOUCH_N), force)
    resampled = Action(
        rate=ACTION_RATE_HZ,
        direction=np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest]),
        speed=np.interp(time, source, action.speed),
        force=force,
        position=interpolate_cubic(action.position, time * action.rate),
        contact=contact,
        probe=action.probe,
        force_curve=curve,
    )
    return resampled, stroke.token_index[nearest]


def build_condition(
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    along_share: Float | None = None,
    lines: Lines | None = None,
) -> Condition:
    """Build the input of F_Θ at every state of a stroke.

    action, token_index: from resample_action. along_share: (n,) as in Condition. lines: of the stroke's materials, if
    their tones are to be apart from the carriers.
    """
    tokens, (mechanics, row_index) = (
        stroke.tokens.astype(np.float64)[token_index],
        find_distinct_mechanics(stroke.mechanics),
    )
    return Condition(
        tokens,
        mechanics,
        row_index[token_index],
        action.direction,
        action.speed,
        action.force,
        action.contact,
        action.probe,
        along_share,
        None if lines is None else lines.project(token_index, action.direction),
    )


def find_distinct_mechanics(mechanics: Sequence[Mechanics]) -> tuple[tuple[Mechanics, ...], NDArray[np.int32]]:
    """Return the distinct mechanics in order of first occurrence, and the index (M,) of each material's.

    The patches of a surface have a token each, but mostly the same mechanics.
    """
    index: dict[Mechanics, int] = {}
    row_index = [index.setdefault(item, len(index)) for item in mechanics]
    return tuple(index), np.array(row_index, dtype=np.int32)


def interpolate_condition(
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    sample: NDArray[np.int64],
    along_share: Float | None = None,
    lines: Lines | None = None,
) -> Condition:
    """Build the input of F_Θ at any 10 kHz samples of a stroke; samples beyond its ends are clamped to it.

    Linear between states, direction as a vector, contact and material of the nearest state. action, token_index: from
    resample_action, or of the stroke itself at its own rate. along_share: (n,) at the states, as in Condition. lines:
    as in build_condition.
    """
    position = np.clip(sample / (MODEL_RATE_HZ / action.rate), 0, len(action.speed) - 1)
    states, nearest = np.arange(len(action.speed)), np.rint(position).astype(np.int64)
    direction = np.empty((len(position), 2))
    for axis in range(2):
        direction[:, axis] = np.interp(position, states, action.direction[:, axis])
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest])
    material = token_index[nearest]
    speed, force = (np.interp(position, states, values) for values in (action.speed, action.force))
    tokens, contact = stroke.tokens.astype(np.float64)[material], action.contact[nearest]
    mechanics, row_index = find_distinct_mechanics(stroke.mechanics)
    share = None if along_share is None else np.interp(position, states, along_share)
    return Condition(
        tokens, mechanics, row_index[material], direction, speed, force, contact, action.probe, share,
        None if lines is None else lines.project(material, direction),
    )  # fmt: skip


def sample_count(action: Action) -> int:
    """Return the number of 10 kHz samples that an action at ACTION_RATE_HZ lasts."""
    return (len(action.speed) - 1) * SAMPLES_PER_STATE


def find_peak_speed(action: Action) -> Float:
    """Return the largest speed |ds/dt| (n,) [m/s] along the path within two states of each of n states."""
    padded = np.pad(np.abs(np.diff(action.position)) * ACTION_RATE_HZ, 2)
    return np.asarray(np.max([padded[shift : shift + len(action.position)] for shift in range(4)], axis=0))


def interpolate_cubic(values: Float, index: Float) -> Float:
    """Interpolate values (n,) at fractional indices by Catmull–Rom splines (C1), constant beyond the ends."""
    last = len(values) - 1
    index = np.clip(index, 0.0, last)
    low = np.minimum(np.floor(index).astype(int), max(last - 1, 0))
    t = index - low
    padded = np.concatenate(
        [[2 * values[0] - values[min(1, last)]], values, [2 * values[-1] - values[max(last - 1, 0)]]]
    )
    weights = catmull_rom_weights(t)
    return np.asarray(sum(weight * padded[np.minimum(low + tap, last + 2)] for tap, weight in enumerate(weights)))


def evaluate_bspline(values: Float, index: Float) -> Float:
    """Evaluate the cubic B-spline with control points values (n,) at fractional indices (C2), constant beyond the ends.

    It smooths 200 Hz samples (−3 dB at about 60 Hz) instead of interpolating: aliases of a slow force ramp at multiples
    of 200 Hz lie 80 dB down and do not hum in a contact that responds to F″.
    """
    last = len(values) - 1
    low = np.floor(index).astype(int)
    weights = _bspline_weights(index - low)
    return np.asarray(sum(weight * values[np.clip(low + tap - 1, 0, last)] for tap, weight in enumerate(weights)))


def interpolate_cubic_samples(values: Float, start: int, count: int) -> Float:
    """Interpolate values (n,) at 200 Hz states by Catmull–Rom splines at 10 kHz samples from `start` on, (count,).

    Samples lie at the same fractions between any two states, so one table of weights serves all.
    """
    last = len(values) - 1
    ends = 2 * values[0] - values[min(1, last)], 2 * values[-1] - values[max(last - 1, 0)]
    padded = np.concatenate([ends[:1], values, ends[1:]])
    first = start // SAMPLES_PER_STATE
    state = np.arange(first, (start + max(count, 1) - 1) // SAMPLES_PER_STATE + 1)[:, None]
    neighbours = padded[np.clip(state + np.arange(4), 0, last + 2)]
    neighbours = np.where(state < 0, values[0], np.where(state >= last, values[-1], neighbours))
    samples = neighbours[:, :1] * _CATMULL_ROM_TABLE[0]
    for tap in range(1, 4):
        samples += neighbours[:, tap : tap + 1] * _CATMULL_ROM_TABLE[tap]
    return np.asarray(samples.reshape(-1)[start - first * SAMPLES_PER_STATE :][:count])


def catmull_rom_weights(t: Float) -> tuple[Float, ...]:
    """Return the Catmull–Rom weights of four values, at t on the way from the second to the third."""
    return (
        0.5 * t * (2.0 * t - 1.0 - t**2),
        1.0 + t**2 * (1.5 * t - 2.5),
        0.5 * t * (1.0 + 4.0 * t - 3.0 * t**2),
        0.5 * t**2 * (t - 1.0),
    )


def _bspline_weights(t: Float) -> tuple[Float, ...]:
    """Return the cubic B-spline weights of four values, at t on the way from the second to the third."""
    return (
        (1.0 - t) ** 3 / 6.0,
        (3.0 * t**3 - 6.0 * t**2 + 4.0) / 6.0,
        (-3.0 * t**3 + 3.0 * t**2 + 3.0 * t + 1.0) / 6.0,
        t**3 / 6.0,
    )


_CATMULL_ROM_TABLE = catmull_rom_weights(STATE_FRACTIONS)


def interpolate_position(action: Action, start: int, count: int) -> Float:
    """Interpolate the path position s(t) [m] at `count` 10 kHz samples from `start` on, constant beyond the stroke."""
    return interpolate_cubic_samples(action.position, start, count)


def extrapolate_position(action: Action, start: int, count: int) -> Float:
    """Interpolate the path position s(t) [m] as interpolate_position, continued at its first and last speed.

    Filters read samples beyond the stroke's ends, where a sudden stop would be a blow that the stroke does not have.
    """
    kernel = load_kernel()
    if kernel is not None:
        path = np.ascontiguousarray(action.position, dtype=np.float64)
        return compiled_carriers.interpolate_position(kernel, path, SAMPLES_PER_STATE, start, count)
    sample = start + np.arange(count)
    last = (len(action.position) - 1) * SAMPLES_PER_STATE
    ends = interpolate_cubic(action.position, np.array([0.0, 1.0, last - 1.0, last]) / SAMPLES_PER_STATE)
    speed = np.where(sample < 0, ends[1] - ends[0], ends[3] - ends[2])
    beyond = sample - np.clip(sample, 0, last)
    return np.asarray(interpolate_position(action, start, count) + beyond * speed)
