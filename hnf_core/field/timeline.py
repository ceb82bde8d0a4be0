"""The action on the field's own clocks: states at 200 Hz, and what is read between them at 10 kHz."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import StrokeError
from .carriers import MODEL_RATE_HZ
from .linear_contact import Condition
from .stroke import StrokeInput

Float = NDArray[np.float64]

SAMPLES_PER_STATE = round(MODEL_RATE_HZ / ACTION_RATE_HZ)


def states_of(stroke: StrokeInput) -> tuple[Action, NDArray[np.int32]]:
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
        position=cubic(action.position, time * action.rate),
        contact=action.contact[nearest],
        probe=action.probe,
    )
    return resampled, stroke.token_index[nearest]


def action_at(
    action: Action, token_index: NDArray[np.int32], sample: NDArray[np.int64]
) -> tuple[Action, NDArray[np.int32]]:
    """u and the material at samples of the model rate, clamped to the stroke, of an action at ACTION_RATE_HZ."""
    place = np.clip(sample / SAMPLES_PER_STATE, 0, len(action.speed) - 1)
    states = np.arange(len(action.speed))
    nearest = np.rint(place).astype(int)
    direction = np.stack([np.interp(place, states, action.direction[:, axis]) for axis in range(2)], axis=1)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    local = replace(
        action,
        rate=ACTION_RATE_HZ,
        direction=np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest]),
        speed=np.interp(place, states, action.speed),
        force=np.interp(place, states, action.force),
        position=cubic(action.position, place),
        contact=action.contact[nearest],
    )
    return local, token_index[nearest]


def condition_of(stroke: StrokeInput, action: Action, token_index: NDArray[np.int32]) -> Condition:
    """F_Θ's condition at every state."""
    tokens = stroke.tokens.astype(np.float64)[token_index]
    return Condition(
        tokens,
        stroke.mechanics,
        token_index,
        action.direction,
        action.speed,
        action.force,
        action.contact,
        action.probe,
    )


def states_in(condition: Condition, rows: slice) -> Condition:
    """The states in rows alone."""
    names = ("tokens", "material", "direction", "speed", "force", "contact")
    return replace(condition, **{name: getattr(condition, name)[rows] for name in names})


def sample_count(action: Action) -> int:
    """Samples at the model rate."""
    return (len(action.speed) - 1) * SAMPLES_PER_STATE


def states_about(states: int, start: int, count: int) -> slice:
    """All the states that smooth() reads at samples start … start + count − 1 of the model rate."""
    last = states - 1
    low, high = start // SAMPLES_PER_STATE - 1, (start + count - 1) // SAMPLES_PER_STATE + 2
    return slice(min(max(low, 0), last), min(max(high, 0), last) + 1)


def cubic(values: Float, place: Float) -> Float:
    """Catmull–Rom interpolation of values (n,) at fractional indices, held beyond the ends; C1."""
    last = len(values) - 1
    place = np.clip(place, 0.0, last)
    low = np.minimum(np.floor(place).astype(int), max(last - 1, 0))
    t = place - low
    padded = np.concatenate(
        [[2 * values[0] - values[min(1, last)]], values, [2 * values[-1] - values[max(last - 1, 0)]]]
    )
    before, here, after, beyond = (padded[np.minimum(low + k, last + 2)] for k in range(4))
    return np.asarray(
        here
        + 0.5 * t * (after - before)
        + t**2 * (before - 2.5 * here + 2.0 * after - 0.5 * beyond)
        + 0.5 * t**3 * (beyond - before + 3.0 * (here - after))
    )


def smooth(values: Float, place: Float) -> Float:
    """Cubic B-spline with values (n,) as control points, read at fractional indices, held beyond the ends; C2.

    It smooths (−3 dB at about 60 Hz of 200 Hz samples) instead of interpolating: its images of a slow ramp lie 80 dB
    down, so that action-rate steps do not hum through a contact that answers to F″.
    """
    last = len(values) - 1
    low = np.floor(place).astype(int)
    t = place - low
    weights = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
    return np.asarray(sum(w * values[np.clip(low + k - 1, 0, last)] for k, w in enumerate(weights)) / 6.0)
