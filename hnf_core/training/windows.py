"""Cut recordings into windows of 1000 samples: their spectra, the hand's states in them, and an 8/1/1 split.

No window crosses the border between training, validation and test data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import Recording
from ..errors import UsageError
from ..field.carriers import MODEL_RATE_HZ
from ..field.features import build_inputs
from ..field.field import FieldConfig
from ..field.linear_contact import Condition
from ..field.resampling import resample
from ..field.stroke import SAMPLES_PER_STATE, resample_action, uniform_stroke
from ..material.contact_model import UNKNOWN_MECHANICS, Mechanics
from ..material.token import TOKEN_DIM
from ..metrics.spectra import WINDOW_SAMPLES, hann_window, window_power
from ..simulation.simulate import SAMPLE_RATE_HZ

Float = NDArray[np.float64]

FINE_BINS = 100
"""Bins 1–100 of a 1000-sample window: 10–1000 Hz, without DC."""
COARSE_EDGES_HZ = 1000.0 * 5.0 ** (np.arange(8) / 7.0)
"""Edges of seven bands above, to 5 kHz, so that the total power is right too."""
TRAIN, VALIDATION, TEST = 0, 1, 2
ROLES = (TRAIN,) * 8 + (VALIDATION, TEST)
"""Roles of every 10 consecutive windows (Haptic Neural Fields, "Training")."""
HOP = WINDOW_SAMPLES // 2
"""Samples between windows of one role: half a window, since a Hann window alone leaves half of the data unused."""
STATES_PER_WINDOW = WINDOW_SAMPLES // SAMPLES_PER_STATE
NODES_PER_WINDOW = 5
"""States at which the field is evaluated for a window in which the action changes."""
STATES_PER_CHUNK = 4096
STEADY_CHANGE = 0.35
"""Mean change within a window (e-folds of speed or force, or radians) up to which its middle state represents it."""


@dataclass(frozen=True)
class Windows:
    """The n windows of all recordings: spectra, and the states of the hand (rows of `States`) that belong to each.

    Attributes
    ----------
    power
        (n, 107) observed spectral density [(m/s²)²/Hz].
    start
        (n,) index of each window's first state.
    counted_bins
        (107,) bool, False for bins and bands above the bandwidth of the recordings.
    node
        (n, Q) indices of the Q states in each window at which the field is evaluated.
    node_weight
        (Q,) weight of each of the Q states, that of the squared Hann window there; the sum is 1.
    role
        (n,) TRAIN, VALIDATION or TEST.
    first
        (states,) index of the first state of the same recording, before which there are no past states.
    """

    power: Float
    start: NDArray[np.int64]
    counted_bins: NDArray[np.bool_]
    node: NDArray[np.int64]
    node_weight: Float
    role: NDArray[np.int64]
    first: NDArray[np.int64]


@dataclass(frozen=True)
class States:
    """States of the hand (200 Hz, or every sample) in all recordings, end to end; arrays have a row per state."""

    direction: Float
    speed: Float
    force: Float
    contact: NDArray[np.bool_]
    probe: str


def cut_windows(
    recordings: Sequence[Recording],
    added: Sequence[Recording] = (),
    *,
    hop: int = HOP,
    raw: bool = False,
    add_reversed: bool = False,
) -> tuple[States, Windows]:
    """Cut recordings, of one material and one probe and at any sample rates, into windows of 1000 samples at 10 kHz.

    Of ten successive windows eight are for training, one for validation, one for testing; counting continues from one
    recording to the next, so that short recordings are split too.

    Parameters
    ----------
    recordings
        The recordings.
    added
        Further ones, all for training.
    hop
        Samples between windows of one role.
    raw
        True for the action as its sensors recorded it, with a state at every sample.
    add_reversed
        Train on each training window played backward too, as if the hand had moved the other way. Its power stays, and
        nothing of it is validated or tested on.

    Raises
    ------
    UsageError
        If probes differ, no window is left to train or to validate on, or a raw action was not recorded.
    """
    probes = {recording.action.probe for recording in recordings}
    if len(probes) != 1:
        raise UsageError(f"recordings of {len(probes)} probes.", remedy="Train one field for each probe.")
    directions, speeds, forces, contacts, firsts = [], [], [], [], []
    powers, starts, roles = [], [], []
    state_count, slot_count, samples_per_state = 0, 0, 1 if raw else SAMPLES_PER_STATE
    for index, recording in enumerate((*recordings, *added)):
        action = _read_raw_action(recording) if raw else read_action(recording)
        samples = resample(recording.samples, recording.sample_rate, MODEL_RATE_HZ)[0]
        count = min(len(samples), (len(action.speed) - 1) * samples_per_state) // WINDOW_SAMPLES
        runs = find_role_runs(slot_count, count) if index < len(recordings) else [(TRAIN, 0, count)]
        for role, low, high in runs if count else ():
            begin = np.arange(low * WINDOW_SAMPLES, high * WINDOW_SAMPLES - WINDOW_SAMPLES + 1, hop)
            segments = np.lib.stride_tricks.sliding_window_view(samples, WINDOW_SAMPLES)[begin]
            powers.append(pool_bins(window_power(segments.reshape(-1), MODEL_RATE_HZ, hop=WINDOW_SAMPLES)))
            starts.append(state_count + begin // samples_per_state)
            roles.append(np.full(len(begin), role))
        directions.append(action.direction)
        speeds.append(action.speed)
        forces.append(action.force)
        contacts.append(action.contact)
        firsts.append(np.full(len(action.speed), state_count))
        state_count += len(action.speed)
        slot_count += count if index < len(recordings) else 0
    assigned = np.concatenate(roles) if roles else np.zeros(0, dtype=np.int64)
    for needed, name in ((TRAIN, "train"), (VALIDATION, "validate")):
        if not np.any(assigned == needed):
            raise UsageError(
                f"{slot_count * WINDOW_SAMPLES / MODEL_RATE_HZ:.1f} s of recordings leave nothing to {name} on.",
                remedy="Give at least 1 s; a good field takes minutes.",
            )
    states = States(
        np.concatenate(directions), np.concatenate(speeds), np.concatenate(forces), np.concatenate(contacts),
        probes.pop(),
    )  # fmt: skip
    if not any(chunk.any() for chunk in powers):
        raise UsageError(
            "the acceleration of the recordings is constant throughout.", remedy="Check the sensor's column and cable."
        )
    known = frozenset().union(*(recording.known for recording in recordings))
    power, start, first = np.concatenate(powers), np.concatenate(starts), np.concatenate(firsts)
    if add_reversed:
        last = state_count + np.searchsorted(first, first, side="right") - 1
        trained = np.flatnonzero(assigned == TRAIN)
        backward = 2 * state_count - 1 - (start[trained] + STATES_PER_WINDOW)
        first = np.concatenate([first, (3 * state_count - 1 - last)[::-1]])
        power, assigned = np.concatenate([power, power[trained]]), np.concatenate([assigned, assigned[trained]])
        start, states = np.concatenate([start, backward]), _append_reversed(states)
    node, weight = (start[:, None], np.ones(1)) if raw else _choose_nodes(states, start, known)
    return states, Windows(
        power, start, _find_counted_bins(recordings), node, weight, assigned.astype(np.int64), first.astype(np.int64)
    )


def _append_reversed(states: States) -> States:
    """Append the same states in reverse order, with the hand going the other way."""
    speed, force, contact = (
        np.concatenate([each, each[::-1]]) for each in (states.speed, states.force, states.contact)
    )
    return States(np.concatenate([states.direction, -states.direction[::-1]]), speed, force, contact, states.probe)


def read_action(recording: Recording) -> Action:
    """Return the action at 200 Hz."""
    stroke = uniform_stroke(recording.action, np.zeros(TOKEN_DIM, dtype=np.float32), UNKNOWN_MECHANICS)
    return resample_action(stroke)[0]


def _read_raw_action(recording: Recording) -> Action:
    if recording.measure_raw_action is None:
        raise UsageError(
            f"no sensor recorded the action of {recording.source}.",
            remedy="Give recordings of force or motion, or take --actions low-passed.",
        )
    action = recording.measure_raw_action()
    if action.rate != MODEL_RATE_HZ:
        raise UsageError(f"its raw action has {action.rate:g} Hz, not {MODEL_RATE_HZ:g}.", remedy="Resample it.")
    return action


def build_state_inputs(
    config: FieldConfig, states: States, rows: NDArray[np.int64], token: NDArray[np.float32], mechanics: Mechanics
) -> tuple[NDArray[np.float32], ...]:
    """Compute the network inputs x, prior and gate (see features.Inputs) of some of the states, by index."""
    chunks = []
    for low in range(0, len(rows), STATES_PER_CHUNK):
        part = rows[low : low + STATES_PER_CHUNK]
        condition = Condition(
            tokens=np.tile(token.astype(np.float64), (len(part), 1)),
            mechanics=(mechanics,),
            material=np.zeros(len(part), dtype=np.int32),
            direction=states.direction[part],
            speed=states.speed[part],
            force=states.force[part],
            contact=states.contact[part],
            probe=states.probe,
        )
        inputs = build_inputs(condition, config.carriers, config.physics, config.action_octaves, config.directed)
        chunks.append([values.astype(np.float32) for values in (inputs.x, inputs.prior, inputs.gate)])
    return tuple(np.concatenate(column) for column in zip(*chunks, strict=True))


def find_role_runs(first_slot: int, count: int) -> list[tuple[int, int, int]]:
    """Return runs of successive windows with the same role (training, validation, test), as (role, low, high).

    A run holds windows low … high − 1 of a recording; first_slot: number of windows in the recordings before.
    """
    runs: list[tuple[int, int, int]] = []
    for slot in range(count):
        role = ROLES[(first_slot + slot) % len(ROLES)]
        if runs and runs[-1][0] == role:
            runs[-1] = (role, runs[-1][1], slot + 1)
        else:
            runs.append((role, slot, slot + 1))
    return runs


def _choose_nodes(states: States, start: NDArray[np.int64], known: frozenset[str]) -> tuple[NDArray[np.int64], Float]:
    """Return the indices (n, Q) of the states at which each window is evaluated, and their weights (Q,).

    The middle state alone if the action changes slowly, else NODES_PER_WINDOW states.
    """
    inside = start[:, None] + np.arange(STATES_PER_WINDOW + 1)
    moving = states.contact[inside].all(axis=1) & (states.speed[inside].min(axis=1) > 0.0)
    changes = {
        "speed": np.ptp(np.log(np.maximum(states.speed, 1e-6))[inside], axis=1),
        "force": np.ptp(np.log(np.maximum(states.force, 1e-6))[inside], axis=1),
        "direction": np.abs(_compute_direction_changes(states.direction))[inside[:, :-1]].sum(axis=1),
    }
    largest_change = max((float(np.mean(change)) for name, change in changes.items() if name in known), default=0.0)
    if np.all(moving) and largest_change <= STEADY_CHANGE:
        return start[:, None] + STATES_PER_WINDOW // 2, np.ones(1)
    offset = ((np.arange(NODES_PER_WINDOW) + 0.5) * STATES_PER_WINDOW / NODES_PER_WINDOW).astype(np.int64)
    weight = np.square(hann_window(WINDOW_SAMPLES))[offset * SAMPLES_PER_STATE]
    return start[:, None] + offset, weight / weight.sum()


def _compute_direction_changes(direction: Float) -> Float:
    """Return the angle (n − 1,) [rad] from each state's direction to the next."""
    current, following = direction[:-1], direction[1:]
    return np.arctan2(
        current[:, 0] * following[:, 1] - current[:, 1] * following[:, 0], (current * following).sum(axis=1)
    )


def _find_counted_bins(recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Return a mask (107,) of the spectrum's bins below 0.9 of the recordings' lowest Nyquist frequency."""
    upper_edge = np.cumsum(compute_bin_widths())
    rate = min(recording.measured_rate or recording.sample_rate for recording in recordings)
    return np.asarray(upper_edge <= 0.45 * rate) if rate < MODEL_RATE_HZ else np.ones(len(upper_edge), dtype=bool)


def pool_bins(power: Float) -> Float:
    """Pool a window's spectrum (…, 501) into (…, 107): 100 bins of 10 Hz, then the mean densities of seven bands."""
    frequency = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / SAMPLE_RATE_HZ)
    fine = power[..., 1 : FINE_BINS + 1]
    coarse = [
        power[..., (frequency > low) & (frequency <= high)].mean(axis=-1) for low, high in pairwise(COARSE_EDGES_HZ)
    ]
    return np.concatenate([fine, np.stack(coarse, axis=-1)], axis=-1)


def compute_bin_widths() -> Float:
    """Return the width (107,) [Hz] of the pooled bins and bands; density times width sums to power."""
    return np.concatenate([np.full(FINE_BINS, SAMPLE_RATE_HZ / WINDOW_SAMPLES), np.diff(COARSE_EDGES_HZ)])
