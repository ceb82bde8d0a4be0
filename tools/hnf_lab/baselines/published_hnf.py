"""Baseline: HNF as published, F_Θ trained with L_mag through temporal rendering, window by window.

Haptic Neural Fields (CVPR 2026): L = 4, H = 1024, N = 5 heads of one state, one constant carrier, Adam at 1e-2 with a
cosine over 100 epochs, C = 200 windows of 1000 samples, split 8/1/1 over every 10 consecutive windows. â is a pointwise
function of u(t), so it has nothing above 20 Hz if the action has not.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import UsageError
from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.features import build_inputs
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_carriers
from hnf_core.field.stroke import SAMPLES_PER_STATE, build_condition, uniform_stroke
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import WINDOW_SAMPLES, hann_window
from hnf_core.training.model import FieldNetwork, render_weights

from .interface import FittedMaterial, Form, MaterialRecordings

MAGNITUDE_BINS = 100
"""Bins 1 … 100 of a 1000-sample window at 10 kHz: 10–1000 Hz, without DC."""


def compute_l_mag(predicted: Tensor, recorded: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """Return the published loss L_mag, a scalar in (m/s²)².

    Parameters
    ----------
    predicted, recorded
        (C, 1000) segments [m/s²].
    bins
        Number of bins K.

    Raises
    ------
    ValueError
        If the shapes differ or segments do not have 1000 samples.

    Notes
    -----
    Mean over C segments and K bins of (|DFT(â_c)|_k − |DFT(a_c)|_k)² with a Hann window and an unscaled DFT (HNF, CVPR
    2026). Between two random draws its minimum is too quiet (docs/rivals.md).
    """
    if predicted.shape != recorded.shape or predicted.ndim != 2 or predicted.shape[1] != WINDOW_SAMPLES:
        raise ValueError(
            f"l_mag takes two (C, {WINDOW_SAMPLES}), not {tuple(predicted.shape)}, {tuple(recorded.shape)}."
        )
    return (compute_magnitudes(predicted, bins) - compute_magnitudes(recorded, bins)).square().mean()


def compute_magnitudes(segments: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """Return |DFT| (C, bins) of Hann-windowed segments (C, W), from bin 1. The gradient at a silent bin is 0."""
    shape = torch.from_numpy(hann_window(segments.shape[-1])).to(segments.dtype)
    spectrum: Tensor = torch.fft.rfft(segments * shape)[..., 1 : bins + 1]
    return spectrum.abs()


Float = NDArray[np.float64]

WINDOWS_PER_BATCH = 200
LEARNING_RATE, EPOCHS = 1e-2, 100
SPLIT_LENGTH = 10
"""Number of consecutive windows that are split 8/1/1."""
MAX_EVALUATIONS = 20_000
"""Evaluations of F_Θ stored for the gradient at once; limits memory only."""


@dataclass(frozen=True)
class PublishedHnf:
    """The paper's model and loss.

    Attributes
    ----------
    every
        Samples between evaluations of F_Θ in training, with linear interpolation; 1 is literal, 50 the action rate,
        beyond
        which a smooth action has no content.
    seconds
        Duration of the recordings used [s].
    """

    config: FieldConfig = field(default_factory=FieldConfig.published)
    every: int = SAMPLES_PER_STATE
    epochs: int = EPOCHS
    seconds: float = 20.0
    name: str = "HNF, literal"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Minimise L_mag by Adam and return the epoch with the least validation loss. Deterministic.

        Raises
        ------
        UsageError
            If there are fewer than 10 windows, or the sample rate is not 10 kHz.
        """
        token = np.zeros(TOKEN_DIM, dtype=np.float32) if specimen.token is None else specimen.token
        windows = cut_windows(specimen.recordings, self.seconds)
        data = build_window_batch(windows, token, specimen.mechanics, self.config, self.every)
        network = train_network(data, self.config, self.epochs, seed)
        trained = Field(self.config, network.to_numpy_parameters(), None)
        return FittedPublishedHnf(trained, token, specimen.mechanics)


@dataclass(frozen=True)
class FittedPublishedHnf:
    """The model of one material. It has no randomness: every seed gives the same signal."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Render by temporal rendering only, without the product's contact transients."""
        signals = []
        for action in actions:
            prepared = prepare_stroke(self.field, uniform_stroke(action, self.token, self.mechanics), seed=seed)
            signals.append(render_carriers(prepared, 0, prepared.count))
        return signals


@dataclass(frozen=True)
class WindowBatch:
    """Training data of all windows.

    Attributes
    ----------
    x, gate
        (C, Q, D) and (C, Q, K): inputs of F_Θ at Q points of each window.
    samples
        (C, 1000) recorded samples.
    interpolation
        (1000, Q) linear interpolation from points to samples.
    role
        (C,) 0 train, 1 validation, 2 test.
    """

    x: Tensor
    gate: Tensor
    samples: Tensor
    interpolation: Tensor
    role: NDArray[np.int_]


def cut_windows(recordings: Sequence[Recording], seconds: float) -> list[tuple[Action, int, Float]]:
    """Return (action, first sample, (1000,) samples) of windows, in runs of ten spread over all recordings.

    Their total duration is about `seconds`.
    """
    out: list[tuple[Action, int, Float]] = []
    for recording in recordings:
        if recording.sample_rate != MODEL_RATE_HZ:
            raise UsageError(f"{recording.source} has {recording.sample_rate:g} Hz.", remedy="Resample it to 10 kHz.")
        for start in range(0, len(recording.samples) - WINDOW_SAMPLES + 1, WINDOW_SAMPLES):
            out.append((recording.action, start, recording.samples[start : start + WINDOW_SAMPLES]))
    if len(out) < SPLIT_LENGTH:
        raise UsageError(f"{len(out)} windows cannot be split 8/1/1.", remedy="Give at least 1 s of recordings.")
    run_count = len(out) // SPLIT_LENGTH
    wanted_runs = min(max(round(seconds * MODEL_RATE_HZ / WINDOW_SAMPLES / SPLIT_LENGTH), 1), run_count)
    first = np.unique(np.linspace(0, run_count - 1, wanted_runs).round().astype(int)) * SPLIT_LENGTH
    return [window for low in first for window in out[low : low + SPLIT_LENGTH]]


def build_window_batch(
    windows: Sequence[tuple[Action, int, Float]],
    token: NDArray[np.float32],
    mechanics: Mechanics,
    config: FieldConfig,
    every: int,
) -> WindowBatch:
    """Build F_Θ's inputs at every `every`-th sample of each window, including both ends."""
    offset = np.arange(0, WINDOW_SAMPLES + every, every)
    xs, gates = [], []
    for action, start, _ in windows:
        local = sample_action(action, (start + offset) / MODEL_RATE_HZ)
        stroke = uniform_stroke(local, token, mechanics)
        inputs = build_inputs(build_condition(stroke, local, stroke.token_index), config.carriers, config.physics)
        xs.append(inputs.x)
        gates.append(inputs.gate)
    sample = np.arange(WINDOW_SAMPLES) / every
    interpolation = np.maximum(1.0 - np.abs(sample[:, None] - np.arange(len(offset))), 0.0)
    role = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1, 2])[np.arange(len(windows)) % SPLIT_LENGTH]
    arrays = (
        np.stack(xs),
        np.stack(gates),
        np.stack([window_samples for _, _, window_samples in windows]),
        interpolation,
    )
    x, gate, samples, interpolation_tensor = (torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays)
    return WindowBatch(x, gate, samples, interpolation_tensor, role)


def sample_action(action: Action, time_s: Float) -> Action:
    """Return u at these times by linear interpolation, with direction as a vector."""
    direction = np.stack([np.interp(time_s, action.time, action.direction[:, axis]) for axis in range(2)], axis=1)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    nearest = np.clip(np.rint(time_s * action.rate).astype(int), 0, len(action.speed) - 1)
    return replace(
        action,
        rate=ACTION_RATE_HZ,
        direction=np.where(length > 1e-9, direction / np.maximum(length, 1e-9), action.direction[nearest]),
        speed=np.interp(time_s, action.time, action.speed),
        force=np.interp(time_s, action.time, action.force),
        position=np.interp(time_s, action.time, action.position),
        contact=action.contact[nearest],
    )


def predict_windows(network: FieldNetwork, data: WindowBatch, rows: Tensor) -> Tensor:
    """Return (C, 1000) â(t_i) = Σ_n w_{i,n} α_{i,n}, linearly interpolated between the points."""
    count, points, width = data.x[rows].shape
    gate = data.gate[rows].reshape(count * points, -1)
    alpha, sigma_dt = network(data.x[rows].reshape(count * points, width), torch.zeros_like(gate), gate)
    rendered = (render_weights(sigma_dt) * alpha[:, :, 0]).sum(dim=1)
    out: Tensor = rendered.reshape(count, points) @ data.interpolation.T
    return out


def train_network(data: WindowBatch, config: FieldConfig, epochs: int, seed: int) -> FieldNetwork:
    """Train by Adam with cosine annealing; gradients of a batch are accumulated in chunks."""
    torch.set_num_threads(1)
    network = FieldNetwork(config, initial_parameters(config, seed))
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    anneal = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    generator = torch.Generator().manual_seed(seed)
    train_rows, validation_rows = (torch.from_numpy(np.flatnonzero(data.role == role)) for role in (0, 1))
    chunk = max(MAX_EVALUATIONS // data.x.shape[1], 1)
    best, least_loss = copy.deepcopy(network.state_dict()), math.inf
    for _ in range(epochs):
        for rows in torch.split(train_rows[torch.randperm(len(train_rows), generator=generator)], WINDOWS_PER_BATCH):
            optimiser.zero_grad()
            for chunk_rows in torch.split(rows, chunk):
                loss = compute_l_mag(predict_windows(network, data, chunk_rows), data.samples[chunk_rows]) * (
                    len(chunk_rows) / len(rows)
                )
                loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        anneal.step()
        with torch.no_grad():
            validation_loss = float(
                compute_l_mag(predict_windows(network, data, validation_rows), data.samples[validation_rows])
            )
        if validation_loss < least_loss:
            best, least_loss = copy.deepcopy(network.state_dict()), validation_loss
    network.load_state_dict(best)
    return network
