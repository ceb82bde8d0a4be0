"""Fit F_Θ to the spectra of simulated steady strokes by likelihood: AdamW with cosine annealing, all data in memory.

A `Checkpoint` holds everything that the next epoch of a training run depends on, in one safetensors file.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..field.carriers import MODEL_RATE_HZ, Carriers
from ..field.features import DIRECTION_COLUMN, build_inputs
from ..field.field import FieldConfig, initial_parameters
from ..field.linear_contact import Condition
from ..files import write_bytes
from ..material.contact_model import Mechanics
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, TOKEN_DIM
from ..metrics.spectra import WINDOW_SAMPLES, hann_window
from ..safetensors_io import dump_tensors, load_tensors
from .model import FieldNetwork, accumulate_steady
from .simulated_strokes import (
    FINE_BINS,
    SteadyStroke,
    compute_bin_widths,
    make_speed_grid,
    pool_bins,
    withhold_mechanics,
)

DENSITY_FLOOR = 1e-9
"""Density added to both sides [(m/s²)²/Hz]: 1 mm/s² over the band, below which nothing is perceptible."""
COARSE_WEIGHT = 4.0
"""Weight of a coarse band, relative to a fine bin."""
TOTAL_WEIGHT = 15.0
"""Weight of the total power. Without it a tone far too loud costs only the logarithm of its few bins."""
OUTLIER_RATIO = 20.0
"""Ratio of observed to expected power beyond which the loss is logarithmic: one hop off the surface would outweigh all
else."""


class WindowLikelihood:
    """Negative Whittle log-likelihood per observation: 100 fine bins, seven coarse bands, and the total power.

    counted_bins: (107,) bool, bins and bands that count; None for all.
    """

    def __init__(self, counted_bins: NDArray[np.bool_] | None = None) -> None:
        width = compute_bin_widths()
        counted = np.ones(len(width), dtype=bool) if counted_bins is None else counted_bins
        self.width = torch.tensor(width * counted, dtype=torch.float32)
        self.weight = torch.ones(len(width) + 1)
        self.weight[FINE_BINS:-1] = COARSE_WEIGHT
        self.weight[-1] = TOTAL_WEIGHT
        self.weight[:-1] *= torch.tensor(counted, dtype=torch.float32)

    def __call__(self, expected: Tensor, recorded: Tensor) -> Tensor:
        """Return the mean loss of n spectra; both arguments are (n, 107) densities.

        DENSITY_FLOOR must have been added to them.
        """
        first, second = (
            torch.cat([density, (density @ self.width)[:, None]], dim=1) for density in (expected, recorded)
        )
        return compute_whittle_loss(first, second, self.weight).mean() / self.weight.sum()


def compute_arc_density(power: Tensor, speed: Tensor, table: Tensor) -> Tensor:
    """Compute the expected densities (n, 107) of arc carriers (noise bands along the path) of powers (n, Ka).

    table: (S, Ka, 107) densities of unit power at S speeds. speed: (n,) index of each row's speed.
    """
    order = torch.argsort(speed)  # Not stable, because the shipped weights were trained in this order.
    values, counts = torch.unique_consecutive(speed[order], return_counts=True)
    groups = power[order].split(counts.tolist())  # type: ignore[no-untyped-call]
    density = torch.cat([group @ table[value] for group, value in zip(groups, values.tolist(), strict=True)])
    return density[torch.argsort(order)]


def compute_whittle_loss(expected: Tensor, recorded: Tensor, weight: Tensor) -> Tensor:
    """Compute the negative Whittle log-likelihood per row, Σ w (log S + P / S), of densities S expected, P recorded.

    Notes
    -----
    P. Whittle (1953), "Estimation and information in stationary time series". The expectation is minimal at S = E P; a
    loss on magnitudes of random draws would learn too quiet a signal. Beyond OUTLIER_RATIO the term P / S continues as
    a logarithm, so that single outliers weigh less; the mean of five windows of Gaussian noise never reaches it.
    """
    ratio = recorded / expected
    soft = OUTLIER_RATIO * (1.0 + torch.log(torch.clamp(ratio, min=OUTLIER_RATIO) / OUTLIER_RATIO))
    return (weight * (torch.log(expected) + torch.where(ratio > OUTLIER_RATIO, soft, ratio))).sum(dim=-1)


Float = NDArray[np.float64]

_ZERO_PADDING = 64


def compute_band_expectation(edges: Float) -> Float:
    """Compute the expected densities (B, 107) of noise bands of unit power between edges[b] and edges[b + 1] [Hz].

    The window's kernel |W|² is integrated over the band and over its mirror image at negative frequencies.
    """
    kernel = np.square(np.abs(np.fft.fft(hann_window(WINDOW_SAMPLES), WINDOW_SAMPLES * _ZERO_PADDING)))
    kernel = np.fft.fftshift(kernel)
    offset = np.fft.fftshift(np.fft.fftfreq(WINDOW_SAMPLES * _ZERO_PADDING, 1.0 / MODEL_RATE_HZ))
    cumulative = np.cumsum(kernel) / kernel.sum()
    bins = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / MODEL_RATE_HZ)

    def cumulative_power(frequency: Float) -> Float:
        return np.asarray(np.interp(frequency[:, None] - bins[None, :], offset, cumulative, left=0.0, right=1.0))

    low, high = edges[:-1], edges[1:]
    fraction = cumulative_power(high) - cumulative_power(low) + cumulative_power(-low) - cumulative_power(-high)
    return pool_bins(fraction / (high - low)[:, None])


def compute_expectation_matrices(carriers: Carriers, speeds: Float) -> tuple[Float, Float]:
    """Compute the expected densities of time carriers (Kt, 107) and of arc carriers at S speeds (S, Ka, 107)."""
    time = compute_band_expectation(carriers.time_edges()) if carriers.time_count else np.zeros((0, 107))
    arc = np.stack([compute_band_expectation(carriers.arc_edges() * speed) for speed in speeds])
    return time, arc


@dataclass(frozen=True)
class Schedule:
    """Hyperparameters of `fit_network`.

    Attributes
    ----------
    epochs
        Number of epochs.
    batch
        Strokes per step.
    learning_rate
        Learning rate of AdamW, annealed to 1 % by a cosine.
    decay
        Decoupled weight decay.
    token_noise
        Standard deviation of the noise added to the material token as a network input (not as input of the linear
        contact), so that a few hundred surfaces are not memorised.
    ridge
        Penalty on the log-amplitude head, whose output is a correction to the linear contact's prediction: where there
        are no data the correction stays 0.
    """

    epochs: int = 100
    batch: int = 256
    learning_rate: float = 2e-3
    decay: float = 1e-4
    token_noise: float = 0.3
    ridge: float = 1e-3


@dataclass(frozen=True)
class TrainingSet:
    """Network inputs and observed spectra of n strokes; inputs exist in V variants.

    x: (V, n, D) inputs. prior: (V, n, K) log amplitudes of the linear contact. gate: (n, K) factor on the output.
    speed: (n,) index into the speed grid. power: (n, 107) spectral densities (100 bins of 10 Hz, seven bands above). In
    variant 0 all mechanics (stiffness, damping, friction) are known; the others lack some, or have the token of another
    patch.
    """

    x: Tensor
    prior: Tensor
    gate: Tensor
    speed: Tensor
    power: Tensor


def make_condition(
    strokes: Sequence[SteadyStroke], tokens: NDArray[np.float32], mechanics: Sequence[Mechanics]
) -> Condition:
    """Build the field's input (Condition) for steady strokes, which must share one probe.

    tokens: (surfaces, TOKEN_DIM). mechanics: one per stroke.
    """
    angle = np.array([stroke.angle for stroke in strokes])
    count = len(strokes)
    return Condition(
        tokens=tokens[[stroke.surface for stroke in strokes]].astype(np.float64),
        mechanics=tuple(mechanics),
        material=np.arange(count, dtype=np.int32),
        direction=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        speed=make_speed_grid()[[stroke.speed for stroke in strokes]],
        force=np.array([stroke.force for stroke in strokes]),
        contact=np.ones(count, dtype=bool),
        probe=strokes[0].probe,
    )


def build_network_inputs(
    config: FieldConfig, strokes: Sequence[SteadyStroke], tokens: NDArray[np.float32], mechanics: Sequence[Mechanics]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Compute network inputs x (n, D), prior (n, K …) and gate (n, K) (see features.Inputs) of n steady strokes.

    tokens: (surfaces, TOKEN_DIM), indexed by the strokes. mechanics: one per stroke.
    """
    outputs: list[NDArray[np.float32]] = []
    for probe in sorted({stroke.probe for stroke in strokes}):
        rows = np.array([row for row, stroke in enumerate(strokes) if stroke.probe == probe])
        inputs = build_inputs(
            make_condition([strokes[row] for row in rows], tokens, [mechanics[row] for row in rows]),
            config.carriers,
            config.physics,
            config.action_octaves,
            config.directed,
            config.line_gains,
            config.stroke_frame,
        )
        arrays = (inputs.x, inputs.prior, inputs.gate)
        outputs = outputs or [np.zeros((len(strokes), array.shape[1]), dtype=np.float32) for array in arrays]
        for output, array in zip(outputs, arrays, strict=True):
            output[rows] = array
    return outputs[0], outputs[1], outputs[2]


def build_training_set(
    config: FieldConfig,
    strokes: Sequence[SteadyStroke],
    tokens: NDArray[np.float32],
    power: Float,
    variants: int,
    seed: int,
    alternative_surfaces: Sequence[Sequence[int]] = (),
) -> TrainingSet:
    """Build the network inputs of every stroke, once as it is, and in variants with some mechanics unknown.

    Parameters
    ----------
    config
        Architecture.
    strokes
        The n strokes.
    tokens
        (surfaces, TOKEN_DIM), which the strokes refer to by index.
    power
        (n, 107) observed spectral densities.
    variants
        Number of variants with the stroke's own token: the first with all mechanics, the others with random ones
        withheld.
    seed
        Seed of the random choices.
    alternative_surfaces
        For each further variant a surface per stroke, of the same material, whose token replaces the stroke's own; in
        every second of these some mechanics are withheld. This teaches the network that patches of one material differ
        by chance; it is used on patches it has never seen.

    Returns
    -------
    TrainingSet
        As torch tensors.
    """
    rng = np.random.default_rng(seed)
    known = [stroke.mechanics for stroke in strokes]
    inputs = []
    for variant in range(variants):
        mechanics = known if variant == 0 else [withhold_mechanics(each, rng) for each in known]
        inputs.append(build_network_inputs(config, strokes, tokens, mechanics))
    for variant, surfaces in enumerate(alternative_surfaces):
        mechanics = known if variant % 2 == 0 else [withhold_mechanics(each, rng) for each in known]
        moved_strokes = [replace(stroke, surface=surface) for stroke, surface in zip(strokes, surfaces, strict=True)]
        inputs.append(build_network_inputs(config, moved_strokes, tokens, mechanics))
    return TrainingSet(
        torch.tensor(np.stack([each[0] for each in inputs])),
        torch.tensor(np.stack([each[1] for each in inputs])),
        torch.tensor(inputs[0][2]),
        torch.tensor([stroke.speed for stroke in strokes]),
        torch.tensor(power, dtype=torch.float32),
    )


@lru_cache(maxsize=2)
def _load_expectation_matrices(carriers: Carriers) -> tuple[Tensor, Tensor]:
    time, arc = compute_expectation_matrices(carriers, make_speed_grid())
    return torch.tensor(time, dtype=torch.float32), torch.tensor(arc, dtype=torch.float32)


class Likelihood:
    """Negative log-likelihood of the observed power of steady strokes."""

    def __init__(self, config: FieldConfig) -> None:
        self.carriers = config.carriers
        self.time, self.arc = _load_expectation_matrices(config.carriers)
        self.likelihood = WindowLikelihood()

    def compute_expected_power(self, amplitude: Tensor, speed: Tensor) -> Tensor:
        """Compute the expected spectral densities (n, 107) of carriers with amplitudes (n, K).

        speed: (n,) index into the speed grid.
        """
        power = amplitude.square()
        time = power[:, self.carriers.time_slice] @ self.time
        return time + compute_arc_density(power[:, self.carriers.arc_slice], speed, self.arc) + DENSITY_FLOOR

    def __call__(self, amplitude: Tensor, speed: Tensor, power: Tensor) -> Tensor:
        return self.likelihood(self.compute_expected_power(amplitude, speed), power + DENSITY_FLOOR)


def fit_network(config: FieldConfig, data: TrainingSet, schedule: Schedule, seed: int) -> FieldNetwork:
    """Train from initial_parameters(config, seed); deterministic for a given number of threads.

    The σ head, which weights past states, is not trained: on a steady stroke these are equal, and σ would only be a
    second gain.
    """
    network = FieldNetwork(config, initial_parameters(config, seed))
    for name in ("sigma_weight", "sigma_bias"):
        network.weights[name].requires_grad_(False)
    likelihood = Likelihood(config)
    generator = torch.Generator().manual_seed(seed)
    trained = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(trained, lr=schedule.learning_rate, weight_decay=schedule.decay, foreach=True)
    count, variants = len(data.speed), len(data.x)
    steps = schedule.epochs * math.ceil(count / schedule.batch)
    anneal = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, schedule.learning_rate * 0.01)
    for epoch in range(schedule.epochs):
        order = torch.randperm(count, generator=generator)
        total = 0.0
        for rows in torch.tensor_split(order, tuple(range(schedule.batch, count, schedule.batch))):
            variant = torch.randint(variants, (len(rows),), generator=generator)
            x = data.x[variant, rows]
            if not config.stroke_frame:
                x = rotate_inputs(x, torch.rand(len(rows), generator=generator) * (2.0 * math.pi))
            x[:, :TOKEN_DIM] += schedule.token_noise * torch.randn(len(rows), TOKEN_DIM, generator=generator)
            head, sigma_dt = network.evaluate_heads(x)
            amplitude = accumulate_steady(
                network.compute_emission(head, data.prior[variant, rows], data.gate[rows]), sigma_dt
            )
            loss = likelihood(amplitude, data.speed[rows], data.power[rows]) + schedule.ridge * head.square().mean()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(trained, 1.0, foreach=True)
            optimiser.step()
            anneal.step()
            total += float(loss.detach()) * len(rows)
        print(f"\repoch {epoch + 1}/{schedule.epochs} loss {total / count:.4f}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return network


def rotate_inputs(x: Tensor, angle: Tensor) -> Tensor:
    """Rotate surface and stroke in every row of network inputs together by angle (n,) [rad].

    Data augmentation: the result may not depend on the orientation of the tangent frame.
    """
    width, bands = len(BAND_FEATURES), range(len(BAND_WAVELENGTHS_M))
    two = [band * width + BAND_FEATURES.index("cos2") for band in bands]
    four = [band * width + BAND_FEATURES.index("cos4") for band in bands]
    columns = torch.tensor([*two, *four, DIRECTION_COLUMN])
    folds = torch.tensor([2.0] * len(two) + [4.0] * len(four) + [1.0])
    cos, sin = torch.cos(angle[:, None] * folds), torch.sin(angle[:, None] * folds)
    first, second = x[:, columns], x[:, columns + 1]
    x = x.clone()
    x[:, columns] = first * cos - second * sin
    x[:, columns + 1] = first * sin + second * cos
    return x


FORMAT = "hnf-checkpoint-1"


@dataclass(frozen=True)
class Checkpoint:
    """State of a training run after `epoch` epochs.

    tensors: network, optimiser, best weights and random state, by name. history: (epoch, 3) epoch number, training loss
    and validation loss.
    """

    epoch: int
    tensors: Mapping[str, NDArray[np.generic]]
    history: NDArray[np.float64]


def save_checkpoint(path: Path, checkpoint: Checkpoint, fingerprint: str) -> None:
    """Write a checkpoint atomically, with a hash (fingerprint) of the run's data and settings. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value) for name, value in checkpoint.tensors.items()}
    tensors["history"] = checkpoint.history
    metadata = {"format": FORMAT, "fingerprint": fingerprint, "epoch": str(checkpoint.epoch)}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_checkpoint(path: Path, fingerprint: str) -> Checkpoint | None:
    """Read the checkpoint of the run with this fingerprint.

    Returns None if there is none, if it is damaged, or if it belongs to other data, another architecture or another
    seed; the run then starts from the beginning.
    """
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        if metadata["format"] != FORMAT or metadata["fingerprint"] != fingerprint:
            return None
        history = tensors.pop("history")
        return Checkpoint(int(metadata["epoch"]), tensors, history)
    except (OSError, ValueError, KeyError, TypeError):
        return None
