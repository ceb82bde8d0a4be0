"""Breakpoints of the action: samples that adaptive evaluation of F_Θ must not skip, since the hand bends there.

An action is known at every state and costs nothing to read. A tap, a stop or a push shorter than the distance between
two evaluations would otherwise never be asked for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel.library import load_kernel
from ..kernel.turns import find_bends
from .linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S
from .timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]
Samples = NDArray[np.int64]

MAX_DEVIATION = 0.25
"""Largest deviation of log speed, log force and direction (radians) from the straight line between two breakpoints.
F_Θ answers to them about one to one, and what it makes of such a bend is seen in the middle between two of them."""


def find_breakpoints(action: Action, token_index: NDArray[np.int32]) -> Samples:
    """Samples of the model rate, ascending, between which an action at ACTION_RATE_HZ is straight within BENT, on one
    material, and in contact or in the air throughout: states, and places between two of them."""
    force = np.where(action.contact, np.maximum(action.force, FORCE_FLOOR_N), FORCE_FLOOR_N)
    speed = np.maximum(action.speed, SPEED_FLOOR_M_S)
    course = np.column_stack([np.log(speed), np.log(force), action.direction])
    changes = np.flatnonzero((np.diff(token_index) != 0) | (np.diff(action.contact.astype(np.int8)) != 0))
    kept = np.unique(np.concatenate([[0, len(speed) - 1], changes, changes + 1]))
    compiled = load_kernel()
    found = _find_bends_numpy(course, kept) if compiled is None else find_bends(compiled, course, kept, MAX_DEVIATION)
    states: Samples = SAMPLES_PER_STATE * found.astype(np.int64)
    all_: Samples = np.unique(
        np.concatenate([states, _find_bends_between_states(speed), _find_bends_between_states(force)])
    )
    return all_


def _find_bends_numpy(course: Float, fixed: Samples) -> Samples:
    """In numpy: what the kernel is tested against."""
    pending = list(zip(fixed[:-1].tolist(), fixed[1:].tolist(), strict=True))
    found = set(fixed.tolist())
    while pending:
        low, high = pending.pop()
        if high - low < 2:
            continue
        share = np.arange(1, high - low)[:, None] / (high - low)
        off = np.abs(course[low + 1 : high] - (course[low] + share * (course[high] - course[low]))).max(axis=1)
        worst = int(np.argmax(off))
        if off[worst] > MAX_DEVIATION:
            found.add(low + 1 + worst)
            pending += [(low, low + 1 + worst), (low + 1 + worst, high)]
    return np.array(sorted(found), dtype=np.int64)


def _find_bends_between_states(value: Float) -> Samples:
    """Samples where a value > 0 that goes straight from state to state bends in its logarithm by more than BENT: a stop
    or a start within one state. It bends most where it is the logarithmic mean of its ends."""
    rise, growth = np.diff(value), np.diff(np.log(value))
    row = np.flatnonzero(np.abs(growth) > 1.0)
    mean = rise[row] / growth[row]
    share = (mean - value[row]) / rise[row]
    bent = np.log(mean / value[row]) - share * growth[row] > MAX_DEVIATION
    at: Samples = SAMPLES_PER_STATE * row[bent] + np.rint(SAMPLES_PER_STATE * share[bent]).astype(np.int64)
    return at
