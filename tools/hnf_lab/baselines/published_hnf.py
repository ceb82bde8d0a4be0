"""L_mag, the published loss: squared differences of magnitudes, in torch.

The literal HNF: F_Θ as published, trained with L_mag through temporal rendering, window by window.

Haptic Neural Fields (CVPR 2026): L = 4, H = 1024, N = 5 heads of one state, one constant carrier, Adam at 1e-2 with a
cosine over 100 epochs, C = 200 windows of 1000 samples, split 8/1/1 over every 10 consecutive windows. â is a pointwise
function of u(t): where the action has nothing above 20 Hz, neither has â.
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
"""Bins 1 … 100 of a 1000-sample window at 10 kHz: 10–1000 Hz, DC left out."""


def compute_l_mag(predicted: Tensor, recorded: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """Mean over C segments and K bins of (|DFT(â_c)|_k − |DFT(a_c)|_k)², Hann window (HNF, CVPR 2026).

    predicted, recorded: (C, 1000) m/s². The DFT is the plain sum, unscaled. Returns a scalar in (m/s²)². Raises
    ValueError where the shapes differ or segments are not of 1000 samples.

    Between two random draws its minimum is too quiet (docs/rivals.md); it is here for the literal model and to be
    reported.
    """
    if predicted.shape != recorded.shape or predicted.ndim != 2 or predicted.shape[1] != WINDOW_SAMPLES:
        raise ValueError(
            f"l_mag takes two (C, {WINDOW_SAMPLES}), not {tuple(predicted.shape)}, {tuple(recorded.shape)}."
        )
    return (compute_magnitudes(predicted, bins) - compute_magnitudes(recorded, bins)).square().mean()


def compute_magnitudes(segments: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """(C, W) → (C, bins) |DFT| of Hann-windowed segments, bins 1 …. The gradient at a silent bin is 0."""
    shape = torch.from_numpy(hann_window(segments.shape[-1])).to(segments.dtype)
    spectrum: Tensor = torch.fft.rfft(segments * shape)[..., 1 : bins + 1]
    return spectrum.abs()


Float = NDArray[np.float64]

WINDOWS_PER_BATCH = 200
LEARNING_RATE, EPOCHS = 1e-2, 100
SPLIT_LENGTH = 10
"""Consecutive windows that are split 8/1/1."""
MAX_EVALUATIONS = 20_000
"""Evaluations of F_Θ held for the gradient at once; bounds memory, changes nothing else."""


@dataclass(frozen=True)
class PublishedHnf:
    """Method: the paper's model and loss.

    every: samples between evaluations of F_Θ while training, with straight lines between; 1 is the letter, 50 the
    action rate, beyond which a smooth action has nothing (and 50 times faster). seconds: of recordings that are used.
    """

    config: FieldConfig = field(default_factory=FieldConfig.published)
    every: int = SAMPLES_PER_STATE
    epochs: int = EPOCHS
    seconds: float = 20.0
    name: str = "HNF, literal"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Adam on L_mag; the epoch with the least validation loss is kept. Deterministic.
        Raises UsageError where there are fewer than 10 windows, or recordings of another rate than 10 kHz."""
        token = np.zeros(TOKEN_DIM, dtype=np.float32) if specimen.token is None else specimen.token
        windows = cut_windows(specimen.recordings, self.seconds)
        data = build_window_batch(windows, token, specimen.mechanics, self.config, self.every)
        network = train_network(data, self.config, self.epochs, seed)
        trained = Field(self.config, network.to_numpy_parameters(), None)
        return FittedPublishedHnf(trained, token, specimen.mechanics)


@dataclass(frozen=True)
class FittedPublishedHnf:
    """One material. Nothing in it is random: every seed gives the same signal."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Temporal rendering alone, without the product's contact transients."""
        out = []
        for action in actions:
            prepared = prepare_stroke(self.field, uniform_stroke(action, self.token, self.mechanics), seed=seed)
            out.append(render_carriers(prepared, 0, prepared.count))
        return out


@dataclass(frozen=True)
class WindowBatch:
    """x (C, Q, D) and gate (C, Q, K): inputs of F_Θ at Q places of each window. samples: (C, 1000). reading: (1000, Q)
    linear interpolation from places to samples. role: (C,) 0 train, 1 validation, 2 test."""

    x: Tensor
    gate: Tensor
    samples: Tensor
    interpolation: Tensor
    role: NDArray[np.int_]


def cut_windows(recordings: Sequence[Recording], seconds: float) -> list[tuple[Action, int, Float]]:
    """(action, first sample, (1000,) samples) of whole windows: runs of ten, spread evenly over all recordings until
    they make up this many seconds."""
    out: list[tuple[Action, int, Float]] = []
    for recording in recordings:
        if recording.sample_rate != MODEL_RATE_HZ:
            raise UsageError(f"{recording.source} has {recording.sample_rate:g} Hz.", remedy="Resample it to 10 kHz.")
        for start in range(0, len(recording.samples) - WINDOW_SAMPLES + 1, WINDOW_SAMPLES):
            out.append((recording.action, start, recording.samples[start : start + WINDOW_SAMPLES]))
    if len(out) < SPLIT_LENGTH:
        raise UsageError(f"{len(out)} windows cannot be split 8/1/1.", remedy="Give at least 1 s of recordings.")
    there = len(out) // SPLIT_LENGTH
    wanted = min(max(round(seconds * MODEL_RATE_HZ / WINDOW_SAMPLES / SPLIT_LENGTH), 1), there)
    first = np.unique(np.linspace(0, there - 1, wanted).round().astype(int)) * SPLIT_LENGTH
    return [window for low in first for window in out[low : low + SPLIT_LENGTH]]


def build_window_batch(
    windows: Sequence[tuple[Action, int, Float]],
    token: NDArray[np.float32],
    mechanics: Mechanics,
    config: FieldConfig,
    every: int,
) -> WindowBatch:
    """F_Θ's inputs at every `every`-th sample of each window, both ends among them."""
    place = np.arange(0, WINDOW_SAMPLES + every, every)
    xs, gates = [], []
    for action, start, _ in windows:
        local = sample_action(action, (start + place) / MODEL_RATE_HZ)
        stroke = uniform_stroke(local, token, mechanics)
        inputs = build_inputs(build_condition(stroke, local, stroke.token_index), config.carriers, config.physics)
        xs.append(inputs.x)
        gates.append(inputs.gate)
    sample = np.arange(WINDOW_SAMPLES) / every
    reading = np.maximum(1.0 - np.abs(sample[:, None] - np.arange(len(place))), 0.0)
    role = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1, 2])[np.arange(len(windows)) % SPLIT_LENGTH]
    arrays = (np.stack(xs), np.stack(gates), np.stack([each for _, _, each in windows]), reading)
    x, gate, samples, read = (torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays)
    return WindowBatch(x, gate, samples, read, role)


def sample_action(action: Action, time_s: Float) -> Action:
    """u at these times, read linearly; direction as a vector."""
    turned = np.stack([np.interp(time_s, action.time, action.direction[:, axis]) for axis in range(2)], axis=1)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    nearest = np.clip(np.rint(time_s * action.rate).astype(int), 0, len(action.speed) - 1)
    return replace(
        action,
        rate=ACTION_RATE_HZ,
        direction=np.where(length > 1e-9, turned / np.maximum(length, 1e-9), action.direction[nearest]),
        speed=np.interp(time_s, action.time, action.speed),
        force=np.interp(time_s, action.time, action.force),
        position=np.interp(time_s, action.time, action.position),
        contact=action.contact[nearest],
    )


def predict_windows(network: FieldNetwork, data: WindowBatch, rows: Tensor) -> Tensor:
    """(C, 1000) â(t_i) = Σ_n w_{i,n} α_{i,n} at the places, straight lines between them."""
    count, places, width = data.x[rows].shape
    gate = data.gate[rows].reshape(count * places, -1)
    alpha, sigma_dt = network(data.x[rows].reshape(count * places, width), torch.zeros_like(gate), gate)
    rendered = (render_weights(sigma_dt) * alpha[:, :, 0]).sum(dim=1)
    out: Tensor = rendered.reshape(count, places) @ data.interpolation.T
    return out


def train_network(data: WindowBatch, config: FieldConfig, epochs: int, seed: int) -> FieldNetwork:
    """Adam, cosine annealing over the epochs; gradients of a batch of SEGMENTS windows are summed chunk by chunk."""
    torch.set_num_threads(1)
    network = FieldNetwork(config, initial_parameters(config, seed))
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    anneal = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    generator = torch.Generator().manual_seed(seed)
    mine, other = (torch.from_numpy(np.flatnonzero(data.role == role)) for role in (0, 1))
    chunk = max(MAX_EVALUATIONS // data.x.shape[1], 1)
    best, least = copy.deepcopy(network.state_dict()), math.inf
    for _ in range(epochs):
        for rows in torch.split(mine[torch.randperm(len(mine), generator=generator)], WINDOWS_PER_BATCH):
            optimiser.zero_grad()
            for part in torch.split(rows, chunk):
                loss = compute_l_mag(predict_windows(network, data, part), data.samples[part]) * (len(part) / len(rows))
                loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        anneal.step()
        with torch.no_grad():
            held = float(compute_l_mag(predict_windows(network, data, other), data.samples[other]))
        if held < least:
            best, least = copy.deepcopy(network.state_dict()), held
    network.load_state_dict(best)
    return network
