"""Recordings → windows: observed powers, the states that made them, and an 8/1/1 split that no window crosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..datasets.recording import Recording
from ..errors import UsageError
from ..field.carriers import MODEL_RATE_HZ
from ..field.resampling import resample
from ..field.stroke import SAMPLES_PER_STATE, resample_action, sample_count, uniform_stroke
from ..material.contact_model import UNKNOWN_MECHANICS
from ..material.token import TOKEN_DIM
from ..metrics.spectra import WINDOW_SAMPLES, hann_window, window_power
from .simulated_strokes import compute_bin_widths, pool_bins

Float = NDArray[np.float64]

TRAIN, VALIDATION, TEST = 0, 1, 2
ROLES = (TRAIN,) * 8 + (VALIDATION, TEST)
"""Of every 10 consecutive windows (HNF, "Training")."""
HOP = WINDOW_SAMPLES // 2
"""Inside a run of one role windows overlap by half: a Hann window alone leaves half of the data unheard."""
STATES_PER_WINDOW = WINDOW_SAMPLES // SAMPLES_PER_STATE
NODES_PER_WINDOW = 5
"""States at which the field is evaluated for one window, where the action changes within it."""
STEADY_CHANGE = 0.35
"""Mean change within a window, in e-folds of speed or force or in radians, up to which its middle stands for it."""


@dataclass(frozen=True)
class Windows:
    """n windows over the states of all recordings, one after the other.

    power: (n, 107) observed density [(m/s²)²/Hz]. heard: (107,) bool, False above what the recordings' rate holds.
    node: (n, Q) state index. share: (Q,) of the squared Hann window at each node, sums to 1. role: (n,) TRAIN,
    VALIDATION or TEST. first: (states,) index of the first state of the same recording: memory reaches no further.
    """

    power: Float
    counted_bins: NDArray[np.bool_]
    node: NDArray[np.int64]
    node_weight: Float
    role: NDArray[np.int64]
    first: NDArray[np.int64]


@dataclass(frozen=True)
class States:
    """Every state of every recording, end to end: what the field is conditioned on. All arrays have one row a state."""

    direction: Float
    speed: Float
    force: Float
    contact: NDArray[np.bool_]
    probe: str


def cut_windows(recordings: Sequence[Recording]) -> tuple[States, Windows]:
    """States and windows of recordings of one material, all with one probe and at any rates.

    Tenths of a second are counted on through all recordings, so that short ones are split too. Raises UsageError where
    probes differ or no window is left to train or to validate on.
    """
    probes = {recording.action.probe for recording in recordings}
    if len(probes) != 1:
        raise UsageError(f"recordings of {len(probes)} probes.", remedy="Train one field for each probe.")
    directions, speeds, forces, contacts, firsts = [], [], [], [], []
    powers, starts, roles = [], [], []
    states, slots = 0, 0
    for recording in recordings:
        action, _ = resample_action(
            uniform_stroke(recording.action, np.zeros(TOKEN_DIM, dtype=np.float32), UNKNOWN_MECHANICS)
        )
        samples = resample(recording.samples, recording.sample_rate, MODEL_RATE_HZ)[0]
        count = min(len(samples), sample_count(action)) // WINDOW_SAMPLES
        for role, low, high in find_role_runs(slots, count):
            begin = np.arange(low * WINDOW_SAMPLES, high * WINDOW_SAMPLES - WINDOW_SAMPLES + 1, HOP)
            pieces = np.lib.stride_tricks.sliding_window_view(samples, WINDOW_SAMPLES)[begin]
            powers.append(pool_bins(window_power(pieces.reshape(-1), MODEL_RATE_HZ, hop=WINDOW_SAMPLES)))
            starts.append(states + begin // SAMPLES_PER_STATE)
            roles.append(np.full(len(begin), role))
        directions.append(action.direction)
        speeds.append(action.speed)
        forces.append(action.force)
        contacts.append(action.contact)
        firsts.append(np.full(len(action.speed), states))
        states += len(action.speed)
        slots += count
    assigned = np.concatenate(roles) if roles else np.zeros(0, dtype=np.int64)
    for needed, name in ((TRAIN, "train"), (VALIDATION, "validate")):
        if not np.any(assigned == needed):
            raise UsageError(
                f"{slots * WINDOW_SAMPLES / MODEL_RATE_HZ:.1f} s of recordings leave nothing to {name} on.",
                remedy="Give at least 1 s; a good field takes minutes.",
            )
    table = States(
        np.concatenate(directions), np.concatenate(speeds), np.concatenate(forces), np.concatenate(contacts),
        probes.pop(),
    )  # fmt: skip
    told = frozenset().union(*(recording.known for recording in recordings))
    node, share = _choose_nodes(table, np.concatenate(starts), told)
    return table, Windows(
        np.concatenate(powers), _find_counted_bins(recordings), node, share, assigned.astype(np.int64),
        np.concatenate(firsts).astype(np.int64),
    )  # fmt: skip


def find_role_runs(first_slot: int, count: int) -> list[tuple[int, int, int]]:
    """(role, low, high) of the longest stretches of slots low … high − 1 of a recording that share one role."""
    out: list[tuple[int, int, int]] = []
    for slot in range(count):
        role = ROLES[(first_slot + slot) % len(ROLES)]
        if out and out[-1][0] == role:
            out[-1] = (role, out[-1][1], slot + 1)
        else:
            out.append((role, slot, slot + 1))
    return out


def _choose_nodes(states: States, start: NDArray[np.int64], known: frozenset[str]) -> tuple[NDArray[np.int64], Float]:
    """Middle state alone where the hand is slow, else NODES states weighted by the squared window."""
    inside = start[:, None] + np.arange(STATES_PER_WINDOW + 1)
    moving = states.contact[inside].all(axis=1) & (states.speed[inside].min(axis=1) > 0.0)
    changes = {
        "speed": np.ptp(np.log(np.maximum(states.speed, 1e-6))[inside], axis=1),
        "force": np.ptp(np.log(np.maximum(states.force, 1e-6))[inside], axis=1),
        "direction": np.abs(_compute_direction_changes(states.direction))[inside[:, :-1]].sum(axis=1),
    }
    most = max((float(np.mean(change)) for name, change in changes.items() if name in known), default=0.0)
    if np.all(moving) and most <= STEADY_CHANGE:
        return start[:, None] + STATES_PER_WINDOW // 2, np.ones(1)
    place = ((np.arange(NODES_PER_WINDOW) + 0.5) * STATES_PER_WINDOW / NODES_PER_WINDOW).astype(np.int64)
    share = np.square(hann_window(WINDOW_SAMPLES))[place * SAMPLES_PER_STATE]
    return start[:, None] + place, share / share.sum()


def _compute_direction_changes(direction: Float) -> Float:
    """(n − 1,) angle from each state's direction to the next, rad."""
    here, there = direction[:-1], direction[1:]
    return np.arctan2(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0], (here * there).sum(axis=1))


def _find_counted_bins(recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Observations below 0.9 of the lowest Nyquist frequency."""
    upper_edge = np.cumsum(compute_bin_widths())
    rate = min(recording.sample_rate for recording in recordings)
    return np.asarray(upper_edge <= 0.45 * rate) if rate < MODEL_RATE_HZ else np.ones(len(upper_edge), dtype=bool)
