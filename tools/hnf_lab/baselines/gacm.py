"""Baseline GACM, a RECONSTRUCTION of the generative action-conditional model of Heravi et al.

N. Heravi, W. Yuan, A. M. Okamura & J. Bohg (2020), "Learning an action-conditional model for haptic texture
generation", ICRA; N. Heravi, H. Culbertson, A. M. Okamura & J. Bohg (2024), IEEE Transactions on Haptics. Published: a
texture vector from the GelSight image, ten recent forces and speeds, multilayer perceptrons, the next 0.1 s at 1 kHz as
51 DFT magnitudes, mean squared magnitude error, phases by Griffin–Lim. Layer sizes and windows are not published, nor
readable code; those here are ours. The texture vector is our token, so that GACM and the field have the same image.

GACM has no direction of motion. As published it contains nothing above 500 Hz, and a squared error between magnitudes
of random draws is least at their mean, so its signal has π/4 of a Gaussian texture's power (−1.05 dB). `improved`
corrects both (2.5 kHz, sqrt(4/π)) and is not the published method. Both are favoured over the original in one point:
the ten actions end with the window they describe, not before it.

Phases: D. Griffin & J. Lim (1984), "Signal estimation from modified short-time Fourier transform", IEEE TASSP 32(2).
Take the phases of the current signal, apply the target magnitudes, and overlap-add by least squares; the squared
distance of the magnitudes never rises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hnf_core.action.action import Action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import UsageError
from hnf_core.field.features import normalise_tokens
from hnf_core.field.resampling import resample
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import hann_window

from .interface import FittedMaterial, FittedSharedModel, Form, MaterialRecordings

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def compute_stft(samples: Float, window: int, hop: int) -> Complex:
    """Return the (frames, window // 2 + 1) Hann spectra at 0, hop, 2 hop …; n = window + (frames − 1) hop."""
    frames = np.lib.stride_tricks.sliding_window_view(samples, window)[::hop]
    return np.asarray(np.fft.rfft(frames * hann_window(window), axis=1))


def overlap_add(spectra: Complex, window: int, hop: int) -> Float:
    """Return the signal whose STFT is nearest to the spectra by least squares (Griffin & Lim 1984, eq. 6).

    Near its two ends only the flank of one window contributes: add a window there and cut it off.
    """
    shape, count = hann_window(window), len(spectra)
    frames = np.fft.irfft(spectra, window, axis=1) * shape
    total, weight = np.zeros(window + (count - 1) * hop), np.zeros(window + (count - 1) * hop)
    for index in range(count):
        span = slice(index * hop, index * hop + window)
        total[span] += frames[index]
        weight[span] += np.square(shape)
    return np.asarray(total / np.maximum(weight, 1e-12))


def run_griffin_lim(magnitude: Float, window: int, hop: int, iterations: int, start: Float) -> Float:
    """Iterate a signal towards short-time magnitudes (frames, window // 2 + 1).

    The phases start from those of `start`, (window + (frames − 1) hop,), the length of the result.
    """
    signal = start
    for _ in range(iterations):
        spectra = compute_stft(signal, window, hop)
        size = np.abs(spectra)
        phase = np.divide(spectra, size, out=np.ones_like(spectra), where=size > 0.0)
        signal = overlap_add(magnitude * phase, window, hop)
    return signal


def compute_inconsistency(magnitude: Float, signal: Float, window: int, hop: int) -> float:
    """Return Σ (|STFT| − magnitude)² over both halves of the spectrum, which the iteration reduces."""
    squared_error = np.square(np.abs(compute_stft(signal, window, hop)) - magnitude)
    squared_error[:, 1 : (window + 1) // 2] *= 2.0
    return float(squared_error.sum())


RATE_HZ, WIDE_RATE_HZ = 1000.0, 2500.0
FINE_RATE_HZ = 10_000.0
WINDOW_S = 0.1
RECENT_STEPS = 10
RECENT_STEP_S = 0.01
FLOOR_M_S, FLOOR_N = 1e-3, 0.02
HIDDEN = 256
ACTION_FEATURES = 64
BATCH = 256
STEPS = 4000
LEARNING_RATE = 1e-3
ITERATIONS = 64
GAUSSIAN_GAIN = 2.0 / np.sqrt(np.pi)
"""Ratio sqrt(E|X|²) / E|X| of a complex normal variable."""


class GacmNetwork(nn.Module):
    """Texture (n, TOKEN_DIM), recent actions (n, 2 · RECENT_STEPS) → magnitudes (n, bins) ≥ 0, in units of `scale`."""

    def __init__(self, bins: int) -> None:
        super().__init__()
        self.action = nn.Sequential(nn.Linear(2 * RECENT_STEPS, ACTION_FEATURES), nn.ReLU(),
                                    nn.Linear(ACTION_FEATURES, ACTION_FEATURES), nn.ReLU())  # fmt: skip
        self.texture = nn.Sequential(nn.Linear(TOKEN_DIM, ACTION_FEATURES), nn.ReLU())
        self.magnitude = nn.Sequential(nn.Linear(2 * ACTION_FEATURES, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN),
                                       nn.ReLU(), nn.Linear(HIDDEN, bins), nn.Softplus())  # fmt: skip

    def forward(self, texture: Tensor, recent: Tensor) -> Tensor:
        magnitude: Tensor = self.magnitude(torch.cat([self.texture(texture), self.action(recent)], dim=-1))
        return magnitude


@dataclass(frozen=True)
class FrameSize:
    """Size of a spectrum. rate: sample rate [Hz]."""

    rate: float

    @property
    def window(self) -> int:
        return round(WINDOW_S * self.rate)

    @property
    def bins(self) -> int:
        return self.window // 2 + 1

    @property
    def hop(self) -> int:
        return self.window // 4


@dataclass(frozen=True)
class TrainingFrames:
    """Texture (n, TOKEN_DIM), recent (n, 2 · RECENT_STEPS), Hann magnitude (n, bins), and weight (n,)."""

    texture: Tensor
    recent: Tensor
    magnitude: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Gacm:
    """Shared method: one network for many materials."""

    improved: bool = False
    steps: int = STEPS

    @property
    def name(self) -> str:
        return f"GACM (reconstruction{', widened to 1.25 kHz, power corrected' if self.improved else ''})"

    @property
    def form(self) -> Form:
        return "natural"

    def fit(self, specimens: Sequence[MaterialRecordings], seed: int) -> FittedSharedModel:
        """Minimise the mean of (|A| − |Â|)² by Adam with cosine annealing.

        Every material's error is divided by its power, so that the loudest does not dominate. Raises UsageError if a
        specimen has no token.
        """
        frame = FrameSize(WIDE_RATE_HZ if self.improved else RATE_HZ)
        frames_by_material = [make_frames(specimen, frame) for specimen in specimens]
        data = TrainingFrames(
            *(
                torch.cat(columns)
                for columns in zip(*(_get_columns(frames) for frames in frames_by_material), strict=True)
            )
        )
        scale = max(float(data.magnitude.square().mean().sqrt()), 1e-9)
        network = train_network(data, scale, self.steps, seed)
        return GacmModel(network, frame, scale, GAUSSIAN_GAIN if self.improved else 1.0)


@dataclass(frozen=True)
class GacmSingleMaterial:
    """The same network for one material, with a constant texture vector."""

    improved: bool = False
    steps: int = STEPS

    @property
    def name(self) -> str:
        return Gacm(self.improved).name + ", one material"

    @property
    def form(self) -> Form:
        return "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        token = np.zeros(TOKEN_DIM, dtype=np.float32)
        alone = MaterialRecordings(specimen.name, specimen.recordings, token, specimen.mechanics, specimen.category)
        return Gacm(self.improved, self.steps).fit([alone], seed).for_material(token, specimen.mechanics)


@dataclass(frozen=True)
class GacmModel:
    """Trained model. scale: unit of the network's magnitudes. gain: additional factor."""

    network: GacmNetwork
    frame: FrameSize
    scale: float
    gain: float

    def for_material(self, token: NDArray[np.float32], mechanics: Mechanics) -> FittedMaterial:
        """Return the model for one material by its token; GACM does not use the mechanics."""
        del mechanics
        return FittedGacm(self, token)


@dataclass(frozen=True)
class FittedGacm:
    model: GacmModel
    token: NDArray[np.float32]

    def predict_magnitudes(self, action: Action, start_s: Float) -> Float:
        """Return (n, bins) |DFT| of the 0.1 s Hann windows that begin at these times; 0 without contact."""
        recent = torch.from_numpy(get_recent_action(action, start_s + WINDOW_S))
        texture = torch.from_numpy(normalise_tokens(self.token.astype(np.float64))).float().expand(len(start_s), -1)
        with torch.no_grad():
            magnitude = self.model.network(texture, recent).numpy().astype(np.float64)
        return np.asarray(
            magnitude * self.model.scale * self.model.gain * _compute_contact_share(action, start_s)[:, None]
        )

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Run Griffin–Lim with a hop of a quarter window, from phases of seeded noise, and resample to 10 kHz."""
        window, hop, rate = self.model.frame.window, self.model.frame.hop, self.model.frame.rate
        signals = []
        for index, action in enumerate(actions):
            count = round(action.duration_s * FINE_RATE_HZ)
            frames = int(np.ceil((action.duration_s * rate + 2 * window) / hop)) + 1
            start = (np.arange(frames) * hop - window) / rate
            noise = np.random.default_rng([seed, index]).standard_normal(window + (frames - 1) * hop)
            signal = run_griffin_lim(self.predict_magnitudes(action, start), window, hop, ITERATIONS, noise)
            lead = round(window / rate * FINE_RATE_HZ)
            signals.append(resample(signal, rate, FINE_RATE_HZ)[0][lead : lead + count])
        return signals


def make_frames(specimen: MaterialRecordings, frame: FrameSize) -> TrainingFrames:
    """Make all half-overlapping windows of 0.1 s in contact. Raises UsageError without a token."""
    if specimen.token is None:
        raise UsageError(
            f"'{specimen.name}' has no token.", remedy="Give its sensor image, or fit one material alone (GacmAlone)."
        )
    recent, magnitude = [], []
    for recording in specimen.recordings:
        start_s, measured = compute_magnitudes(recording, frame)
        is_moving = _compute_contact_share(recording.action, start_s) == 1.0
        recent.append(get_recent_action(recording.action, start_s[is_moving] + WINDOW_S))
        magnitude.append(measured[is_moving])
    observed = np.concatenate(magnitude)
    if len(observed) == 0:
        raise UsageError(f"'{specimen.name}' is never touched for a tenth of a second.", remedy="Record it longer.")
    texture = np.tile(normalise_tokens(specimen.token.astype(np.float64)), (len(observed), 1))
    weight = np.full(len(observed), 1.0 / max(float(np.mean(np.square(observed))), 1e-12))
    arrays = (texture, np.concatenate(recent), observed, weight)
    return TrainingFrames(*(torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays))


def compute_magnitudes(recording: Recording, frame: FrameSize) -> tuple[Float, Float]:
    """Return start [s] and |DFT| (n, bins) of half-overlapping 0.1 s Hann windows at the frame's rate."""
    resampled = resample(recording.samples, recording.sample_rate, frame.rate)[0]
    if len(resampled) < frame.window:
        return np.zeros(0), np.zeros((0, frame.bins))
    hop = frame.window // 2
    windows = np.lib.stride_tricks.sliding_window_view(resampled, frame.window)[::hop]
    return np.arange(len(windows)) * hop / frame.rate, np.abs(np.fft.rfft(windows * hann_window(frame.window), axis=1))


def get_recent_action(action: Action, end_s: Float) -> NDArray[np.float32]:
    """Return (n, 2 · RECENT_STEPS) log force and log speed at end, end − 10 ms …, GACM's only view of the action."""
    time_s = end_s[:, None] - RECENT_STEP_S * np.arange(RECENT_STEPS)
    force = np.interp(time_s, action.time, action.force)
    speed = np.interp(time_s, action.time, action.speed)
    columns = [np.log(np.maximum(force, FLOOR_N)), np.log(np.maximum(speed, FLOOR_M_S) / 0.1)]
    return np.asarray(np.concatenate(columns, axis=1), dtype=np.float32)


def train_network(data: TrainingFrames, scale: float, steps: int, seed: int) -> GacmNetwork:
    """Minimise the weighted mean of (|A| − |Â|)². Deterministic."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    network = GacmNetwork(data.magnitude.shape[1])
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    anneal = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        rows = torch.randint(len(data.weight), (BATCH,), generator=generator)
        predicted = scale * network(data.texture[rows], data.recent[rows])
        loss = (data.weight[rows, None] * (predicted - data.magnitude[rows]).square()).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        anneal.step()
    return network


def _get_columns(frames: TrainingFrames) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return frames.texture, frames.recent, frames.magnitude, frames.weight


def _compute_contact_share(action: Action, start_s: Float) -> Float:
    """Return the (n,) fraction of each window in contact and in motion."""
    time_s = start_s[:, None] + np.arange(5) / 4.0 * WINDOW_S
    sliding = (action.contact & (action.speed > FLOOR_M_S)).astype(np.float64)
    return np.asarray(np.interp(time_s, action.time, sliding, left=0.0, right=0.0).mean(axis=1))
