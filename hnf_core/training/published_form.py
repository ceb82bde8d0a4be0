"""The published form of HNF: its loss L_mag through temporal rendering, and the strokes that HNF+ adds.

Haptic Neural Fields (CVPR 2026): N heads of one state, one constant carrier, the magnitudes of C windows of 1000
samples. â is a pointwise function of u(t), so it has nothing above 20 Hz if the action has not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..action.action import Action
from ..action.primitive_path import make_primitive_action
from ..action.primitives import PRIMITIVE_NAMES
from ..datasets.recording import Recording, TextureProcess
from ..errors import UsageError
from ..field.carriers import MODEL_RATE_HZ
from ..field.field import FieldConfig
from ..field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S
from ..field.resampling import resample
from ..field.stroke import SAMPLES_PER_STATE
from ..material.contact_model import Mechanics
from ..metrics.spectra import BIN_COUNT, WINDOW_SAMPLES, hann_window
from .model import FieldNetwork, render_weights
from .windows import (
    STATES_PER_WINDOW,
    TRAIN,
    States,
    Windows,
    build_state_inputs,
    find_role_runs,
    pool_bins,
    read_action,
)

Float = NDArray[np.float64]

MAX_EVALUATIONS = 20_000
"""Evaluations of F_Θ stored for the gradient at once; limits memory only."""
DFT_POWER = 0.5 * MODEL_RATE_HZ * float(np.sum(np.square(hann_window(WINDOW_SAMPLES))))
"""|X_k|² of an unscaled DFT of a window, over its one-sided density [Hz]."""


def compute_magnitudes(segments: Tensor, bins: int = BIN_COUNT) -> Tensor:
    """Return |DFT| (C, bins) of Hann-windowed segments (C, W), from bin 1. The gradient at a silent bin is 0."""
    shape = torch.from_numpy(hann_window(segments.shape[-1])).to(segments.dtype)
    spectrum: Tensor = torch.fft.rfft(segments * shape)[..., 1 : bins + 1]
    return spectrum.abs()


def compute_l_mag(predicted: Tensor, recorded: Tensor) -> Tensor:
    """Return the published loss L_mag, a scalar in (m/s²)², of segments (C, 1000) and recorded magnitudes (C, K).

    Mean over C segments and K bins of (|DFT(â_c)|_k − |DFT(a_c)|_k)² with a Hann window and an unscaled DFT (HNF, CVPR
    2026, eq. 4). Between two random draws its minimum is too quiet (docs/rivals.md).
    """
    return (compute_magnitudes(predicted, recorded.shape[-1]) - recorded).square().mean()


class MagnitudeTask:
    """Data of a training run of the published form, and its loss L_mag over a subset of the windows.

    Parameters
    ----------
    config
        Architecture: N heads, one constant carrier.
    batch
        C, windows in a step.
    states, windows
        From cut_windows, with windows side by side.
    token, mechanics
        Of the material; zeros and unknown if they are not known.
    raw
        True if there is a state at every sample; else F_Θ is interpolated between the states.
    """

    magnitude_power = 1.0

    def __init__(
        self, config: FieldConfig, batch: int, states: States, windows: Windows, token: NDArray[np.float32],
        mechanics: Mechanics, *, raw: bool,
    ) -> None:  # fmt: skip
        x, _, gate = build_state_inputs(config, states, np.arange(len(states.speed)), token, mechanics)
        self.config, self.role, self.batch = config, windows.role, batch
        self.x, self.gate = torch.tensor(x), torch.tensor(gate)
        points = np.arange(WINDOW_SAMPLES if raw else STATES_PER_WINDOW + 1)
        self.rows = torch.tensor(windows.start[:, None] + points)
        self.magnitude = torch.tensor(np.sqrt(DFT_POWER * windows.power[:, :BIN_COUNT]), dtype=torch.float32)
        between = np.abs(np.arange(WINDOW_SAMPLES)[:, None] / SAMPLES_PER_STATE - points)
        self.interpolation = None if raw else torch.tensor(np.maximum(1.0 - between, 0.0).T, dtype=torch.float32)

    def get_data(self) -> tuple[Tensor, ...]:
        """Return everything that the loss depends on besides the network."""
        return self.magnitude, self.x, self.rows

    def predict(self, network: FieldNetwork, rows: Tensor) -> Tensor:
        """Return (C, 1000) â(t_i) = Σ_n w_{i,n} α_{i,n} of some windows."""
        states = self.rows[rows]
        gate = self.gate[states].flatten(0, 1)
        alpha, sigma_dt = network(self.x[states].flatten(0, 1), torch.zeros_like(gate), gate)
        rendered: Tensor = (render_weights(sigma_dt) * alpha[:, :, 0]).sum(dim=1).reshape(states.shape)
        return rendered if self.interpolation is None else rendered @ self.interpolation

    def _split(self, rows: Tensor) -> Sequence[Tensor]:
        chunks: Sequence[Tensor] = rows.split(max(MAX_EVALUATIONS // self.rows.shape[1], 1))  # type: ignore[no-untyped-call]
        return chunks

    def accumulate_gradient(self, network: FieldNetwork, rows: Tensor) -> float:
        """Add the gradient of the windows `rows` to the network's parameters, and return their loss."""
        total = 0.0
        for chunk in self._split(rows):
            loss = compute_l_mag(self.predict(network, chunk), self.magnitude[chunk]) * (len(chunk) / len(rows))
            loss.backward()  # type: ignore[no-untyped-call]
            total += float(loss.detach())
        return total

    def evaluate_loss(self, network: FieldNetwork, rows: Tensor) -> float:
        """Return the mean loss of the windows `rows`, computed without gradients."""
        with torch.no_grad():
            losses = [
                float(compute_l_mag(self.predict(network, chunk), self.magnitude[chunk])) * len(chunk)
                for chunk in self._split(rows)
            ]
        return sum(losses) / len(rows)

    def predict_power(self, network: FieldNetwork, rows: Tensor) -> Tensor:
        """Return the densities (rows, 107) of the signals predicted for some windows."""
        magnitude = torch.cat(
            [compute_magnitudes(self.predict(network, chunk), WINDOW_SAMPLES // 2) for chunk in self._split(rows)]
        )
        density = np.pad(np.square(magnitude.numpy().astype(np.float64)) / DFT_POWER, ((0, 0), (1, 0)))
        return torch.tensor(pool_bins(density))


def make_added_strokes(process: TextureProcess | None, recordings: Sequence[Recording], seed: int) -> list[Recording]:
    """Make the strokes that HNF+ adds: the eight primitives, over and over for half as long as the recordings.

    A process is stroked. Where there are only recordings, every 0.1 s of a primitive gets the samples of the recorded
    training window of nearest direction, speed and force: L_mag compares single windows, and so does not hear the seams
    between them.
    """
    one_round = sum(make_primitive_action(name, seed=seed).duration_s for name in PRIMITIVE_NAMES)
    rounds = max(1, round(0.5 * sum(recording.duration_s for recording in recordings) / one_round))
    makers = [
        partial(make_primitive_action, name, seed=seed + index) for index in range(rounds) for name in PRIMITIVE_NAMES
    ]
    actions = [make() for make in makers]
    if process is None:
        strokes = _borrow_windows(recordings, actions)
    else:
        strokes = [process.record([action], seed + 7919 + index)[0] for index, action in enumerate(actions)]
    known = frozenset().union(*(recording.known for recording in recordings))
    return [
        replace(stroke, known=known, measure_raw_action=partial(make, rate=MODEL_RATE_HZ))
        for stroke, make in zip(strokes, makers, strict=True)
    ]


def _borrow_windows(recordings: Sequence[Recording], actions: Sequence[Action]) -> list[Recording]:
    pieces, features, slot = [], [], 0
    for recording in recordings:
        action = read_action(recording)
        samples = resample(recording.samples, recording.sample_rate, MODEL_RATE_HZ)[0]
        count = min(len(samples) // WINDOW_SAMPLES, (len(action.speed) - 1) // STATES_PER_WINDOW)
        described = _describe_windows(action)
        for role, low, high in find_role_runs(slot, count):
            if role == TRAIN:
                pieces += list(samples[low * WINDOW_SAMPLES : high * WINDOW_SAMPLES].reshape(-1, WINDOW_SAMPLES))
                features.append(described[low:high])
        slot += count
    if not pieces:
        raise UsageError("the recordings are too short to borrow from.", remedy="Give at least 1 s.")
    recorded = np.concatenate(features)
    strokes = []
    for action in actions:
        distance = np.square(_describe_windows(action)[:, None] - recorded).sum(axis=-1)
        samples = np.concatenate([pieces[index] for index in distance.argmin(axis=1)])
        count = round(action.duration_s * MODEL_RATE_HZ)
        material, source = recordings[0].material, recordings[0].source
        strokes.append(Recording(action, samples[:count], MODEL_RATE_HZ, material, source))
    return strokes


def _describe_windows(action: Action) -> Float:
    """Return mean direction, log speed and log force (windows, 4) of every 0.1 s of an action at 200 Hz."""
    columns = [
        action.direction,
        np.log(np.maximum(action.speed, SPEED_FLOOR_M_S))[:, None],
        np.log(np.maximum(action.force, FORCE_FLOOR_N))[:, None],
    ]
    starts = np.arange(0, len(action.speed) - 1, STATES_PER_WINDOW)
    sums = np.add.reduceat(np.concatenate(columns, axis=1), starts, axis=0)
    return np.asarray(sums / np.diff(np.append(starts, len(action.speed)))[:, None])
