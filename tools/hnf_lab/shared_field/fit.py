"""Fit F_Θ to the spectra of simulated steady strokes by likelihood: AdamW with cosine annealing, all data in memory."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hnf_core.field.carriers import Carriers
from hnf_core.field.features import DIRECTION_COLUMN, build_inputs
from hnf_core.field.field import FieldConfig, initial_parameters
from hnf_core.field.linear_contact import Condition
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, TOKEN_DIM
from hnf_core.training.fit import (
    DENSITY_FLOOR,
    Float,
    WindowLikelihood,
    compute_arc_density,
    compute_expectation_matrices,
)
from hnf_core.training.model import FieldNetwork, accumulate_steady
from hnf_lab.shared_field.simulated_strokes import SteadyStroke, make_speed_grid, withhold_mechanics


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
