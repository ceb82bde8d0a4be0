"""Fit one field to recordings of one material: expected-power likelihood, AdamW with cosine annealing, early stopping.

Recordings are cut into windows of 0.1 s, F_Θ is evaluated at states of the hand in each window, and the spectrum it
predicts is fitted by the Whittle likelihood (P. Whittle 1953), Σ log S + P / S with S expected and P recorded, least in
expectation at S = E P. The paper's loss L_mag compares the magnitudes of two random draws and learns a signal up to 2
dB too quiet; a field of the published form is trained with it (`published_form`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..datasets.recording import Recording
from ..field.field import Field, FieldConfig, initial_parameters
from ..field.render_weights import STEP_S
from ..field.training_ranges import compute_training_ranges
from ..files import content_hash
from ..material.contact_model import UNKNOWN_MECHANICS, Mechanics
from ..material.token import TOKEN_DIM
from ..metrics.spectra import WINDOW_SAMPLES
from .fit import (
    DENSITY_FLOOR,
    Checkpoint,
    WindowLikelihood,
    compute_arc_density,
    compute_expectation_matrices,
    load_checkpoint,
    save_checkpoint,
)
from .model import FieldNetwork, render_weights
from .published_form import MagnitudeTask
from .windows import (
    FINE_BINS,
    HOP,
    TEST,
    TRAIN,
    VALIDATION,
    States,
    Windows,
    build_state_inputs,
    compute_bin_widths,
    cut_windows,
)

Float = NDArray[np.float64]

SPEED_NODES = 96
"""Speeds at which the expectation of arc carriers is tabulated, log-spaced: over a tenfold range the step is narrower
than a carrier."""


@dataclass(frozen=True)
class RenderedInputs:
    """Network inputs at the s hand states that n windows need, and which rows each window uses.

    Attributes
    ----------
    x
        (s, D) network inputs.
    prior, gate
        (s, K) log amplitudes of the linear contact, and factor on the output.
    phase
        (s, K) phase of a carrier over one Δt [rad].
    speed
        (s,) index into the speeds of make_speed_table.
    state_rows
        (n, Q, P) rows of the arrays above, for Q evaluated states in a window and P past states of each (P = 1 for
        "heads").
    alive
        (n, Q, P) 0 if that past state lies before the recording, else 1.
    share
        (Q,) weight of each of the Q states in a window.
    """

    x: Tensor
    prior: Tensor
    gate: Tensor
    phase: Tensor
    speed: Tensor
    state_rows: Tensor
    alive: Tensor
    share: Tensor


def make_speed_table(states: States) -> Float:
    """Return the speeds (SPEED_NODES,) [m/s] for which expected spectra are tabulated, covering those of the states."""
    moving = states.speed[states.speed > 1e-3]
    low, high = (float(moving.min()), float(moving.max())) if len(moving) else (0.01, 0.1)
    return np.geomspace(low, max(high, 1.01 * low), SPEED_NODES)


def build_rendered_inputs(
    config: FieldConfig, states: States, windows: Windows, token: NDArray[np.float32], mechanics: Mechanics
) -> RenderedInputs:
    """Compute the network inputs for all windows, which do not change during training."""
    past = config.states if config.accumulation == "past" else 1
    state_index = windows.node[:, :, None] - config.stride * np.arange(past)
    alive = state_index >= windows.first[windows.node][:, :, None]
    used, rows = np.unique(np.where(alive, state_index, windows.node[:, :, None]), return_inverse=True)
    x, prior, gate = (torch.tensor(values) for values in build_state_inputs(config, states, used, token, mechanics))
    speed = states.speed[used]
    carriers, phase = config.carriers, np.zeros((len(used), config.carriers.count), dtype=np.float32)
    if config.accumulation == "heads":
        edges = carriers.time_edges()
        phase[:, carriers.time_slice] = np.pi * (edges[1:] + edges[:-1]) * STEP_S
        phase[:, carriers.arc_slice] = 2.0 * np.pi * speed[:, None] * carriers.arc_centres() * STEP_S
    table = np.log(make_speed_table(states))
    nearest = np.rint((np.log(np.maximum(speed, 1e-6)) - table[0]) / (table[1] - table[0]))
    return RenderedInputs(
        x, prior, gate, torch.tensor(phase), torch.tensor(np.clip(nearest, 0, SPEED_NODES - 1).astype(np.int64)),
        torch.tensor(rows.reshape(state_index.shape)), torch.tensor(alive.astype(np.float32)),
        torch.tensor(windows.node_weight, dtype=torch.float32),
    )  # fmt: skip


class RenderedPower:
    """Computation of the spectra (rows, 107) that a network predicts for windows of the recordings.

    speeds: from make_speed_table.
    """

    def __init__(self, config: FieldConfig, speeds: Float) -> None:
        used = speeds if config.carriers.arc_count else speeds[:1]
        time, arc = compute_expectation_matrices(config.carriers, used)
        self.config = config
        self.time = torch.tensor(time, dtype=torch.float32)
        self.arc = torch.tensor(arc, dtype=torch.float32)

    def __call__(self, network: FieldNetwork, inputs: RenderedInputs, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the predicted spectra (rows, 107) of the windows `rows`, and the α head's raw outputs."""
        carriers, states = self.config.carriers, inputs.state_rows[rows]
        flat = states.reshape(-1)
        head, sigma_dt = network.evaluate_heads(inputs.x[flat])
        alpha = network.compute_emission(head, inputs.prior[flat], inputs.gate[flat])
        if self.config.accumulation == "past":
            density = sigma_dt.reshape(*states.shape, -1).diagonal(dim1=-2, dim2=-1)
            weight = render_weights(density) * inputs.alive[rows]
            amplitude = (weight[..., None] * alpha.reshape(*states.shape, -1)).sum(dim=-2)
            power = amplitude.square()
        else:
            lag = torch.arange(self.config.states, dtype=torch.float32)[None, :, None] * inputs.phase[flat][:, None, :]
            emitted = render_weights(sigma_dt)[..., None] * alpha
            real, imaginary = (emitted * torch.cos(lag)).sum(dim=1), (emitted * torch.sin(lag)).sum(dim=1)
            power = (real.square() + imaginary.square()).reshape(*states.shape[:2], -1)
        out = torch.einsum("q,rqk,kb->rb", inputs.share, power[..., carriers.time_slice], self.time)
        if carriers.arc_count:
            speed = inputs.speed[states[..., 0]]
            dense = compute_arc_density(power[..., carriers.arc_slice].flatten(0, 1), speed.flatten(), self.arc)
            out = out + torch.einsum("q,rqb->rb", inputs.share, dense.reshape(*speed.shape, -1))
        return out, head


ProgressCallback = Callable[[int, int, float], None]
"""Called after every epoch with (epoch, epochs, validation loss)."""

SILENT_LOG_AMPLITUDE = -12.0
"""Initial log amplitude of bands above the recordings' bandwidth, which stay silent because nothing is known of them.
"""


@dataclass(frozen=True)
class Schedule:
    """Hyperparameters of `train_material`.

    Attributes
    ----------
    epochs
        Largest number of epochs.
    batches
        Smallest number of batches in an epoch; a short recording is repeated within it.
    batch
        Windows per batch.
    learning_rate, decay
        Learning rate and weight decay of AdamW.
    last_rate
        Share of the learning rate that a cosine has fallen to at the end.
    smoothness
        Weight on the squared second difference of log amplitude between neighbouring 10 Hz bands, per window: ten
        seconds near one speed and force do not determine a hundred bands.
    patience
        Epochs without a better validation loss after which training stops; the best epoch is returned.
    """

    epochs: int = 40
    batches: int = 32
    batch: int = 256
    learning_rate: float = 3e-3
    decay: float = 1e-2
    smoothness: float = 3.0
    patience: int = 15
    last_rate: float = 0.01

    @staticmethod
    def published(epochs: int = 100) -> Schedule:
        """Return the paper's: Adam at 1e-2 with a cosine, C = 200 windows a step, every epoch to the end."""
        return Schedule(epochs, 0, 200, 1e-2, 0.0, 0.0, epochs, 0.0)


@dataclass(frozen=True)
class HeldOutMetrics:
    """Metrics of a trained field over the test windows.

    Attributes
    ----------
    windows
        Number of windows.
    loss
        Negative log-likelihood per bin.
    distance_db
        RMS difference between expected and recorded mean spectrum [dB], over the bins in 20–1000 Hz within 30 dB of the
        peak.
    bias_db
        Expected over recorded total power [dB].
    l_mag_share
        The paper's L_mag of the expected magnitudes, √(π S) / 2, over the recorded power; 0.215 is the optimum on
        Gaussian noise, 1 is silence.
    scatter_db
        distance_db of a perfect model on Gaussian noise, 4.34 / √windows.
    """

    windows: int
    loss: float
    distance_db: float
    bias_db: float
    l_mag_share: float
    scatter_db: float


@dataclass(frozen=True)
class TrainingResult:
    """Result of a training.

    field: of the best epoch. history: (epochs, 3) number, training loss and validation loss. test: metrics of the test
    windows, None if the recordings are too short to have any.
    """

    field: Field
    history: Float
    test: HeldOutMetrics | None


def train_material(
    recordings: Sequence[Recording],
    config: FieldConfig,
    seed: int,
    *,
    schedule: Schedule = Schedule(),
    token: NDArray[np.float32] | None = None,
    mechanics: Mechanics = UNKNOWN_MECHANICS,
    checkpoint: Path | None = None,
    watch: ProgressCallback | None = None,
    add_reversed: bool = False,
    added: Sequence[Recording] = (),
    raw: bool = False,
    keep_checkpoint: bool = False,
) -> TrainingResult:
    """Fit F_Θ to recordings of one material with one probe.

    Equal arguments give equal weights on one machine, whether or not the run was killed in between.

    Parameters
    ----------
    recordings
        Recordings of one material with one probe.
    config
        Architecture.
    seed
        Seed of initialisation and batches.
    schedule
        Hyperparameters.
    token, mechanics
        Token, and stiffness, damping and friction, of the material, if known.
    checkpoint
        File from which a killed run continues; it is removed when training ends.
    watch
        Called after every epoch.
    add_reversed
        Train on the recordings played backward too, as if the hand had moved the other way.
    added
        Further recordings, for training alone.
    raw
        True to train a field of the published form on raw actions.
    keep_checkpoint
        True to keep the checkpoint when training ends.

    Returns
    -------
    TrainingResult
        The field of the best epoch, the losses and the test metrics.

    Raises
    ------
    UsageError
        If the recordings are too short or of several probes.
    """
    torch.set_num_threads(1)
    literal = config.carriers.constant
    states, windows = cut_windows(
        recordings, added, hop=WINDOW_SAMPLES if literal else HOP, raw=raw and literal, add_reversed=add_reversed
    )
    values = np.zeros(TOKEN_DIM, dtype=np.float32) if token is None else token
    task: _TrainingTask | MagnitudeTask
    if literal:
        task = MagnitudeTask(config, schedule.batch, states, windows, values, mechanics, raw=raw)
    else:
        inputs = build_rendered_inputs(config, states, windows, values, mechanics)
        task = _TrainingTask(config, schedule.smoothness, inputs, windows, make_speed_table(states))
    network, history = _train_epochs(
        task, _make_initial_parameters(config, windows, seed), schedule, seed, checkpoint, watch
    )
    if checkpoint and not keep_checkpoint:
        checkpoint.unlink(missing_ok=True)
    strokes = (*recordings, *added)
    ranges = compute_training_ranges(
        [recording.action for recording in strokes], values[None, :], [mechanics],
        directed=["direction" in recording.known for recording in strokes],
    )  # fmt: skip
    field = Field(config, network.to_numpy_parameters(), ranges)
    return TrainingResult(field, history, _compute_test_metrics(task, network, windows))


class _TrainingTask:
    """Data of a training run, and its loss over a subset of the windows."""

    magnitude_power = 0.25 * math.pi
    """Square of a bin's expected magnitude, over its expected power."""

    def __init__(
        self, config: FieldConfig, smoothness: float, inputs: RenderedInputs, windows: Windows, speeds: Float
    ) -> None:
        self.config, self.smoothness, self.inputs = config, smoothness, inputs
        self.expected = RenderedPower(config, speeds)
        self.power = torch.tensor(windows.power + DENSITY_FLOOR, dtype=torch.float32)
        self.role = windows.role
        self.likelihood = WindowLikelihood(windows.counted_bins)

    def get_data(self) -> tuple[Tensor, ...]:
        """Return everything that the loss depends on besides the network."""
        return self.power, self.inputs.x, self.inputs.state_rows, self.likelihood.weight

    def accumulate_gradient(self, network: FieldNetwork, rows: Tensor) -> float:
        """Add the gradient of the windows `rows` to the network's parameters, and return their loss."""
        loss, head = self.compute_loss(network, rows)
        (loss + self.smoothness * self.compute_roughness(head)).backward()  # type: ignore[no-untyped-call]
        return float(loss.detach())

    def predict_power(self, network: FieldNetwork, rows: Tensor) -> Tensor:
        """Return the expected densities (rows, 107) of some windows."""
        return self.expected(network, self.inputs, rows)[0]

    def compute_loss(self, network: FieldNetwork, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean negative log-likelihood of the windows `rows`, and the α head's outputs."""
        density, head = self.expected(network, self.inputs, rows)
        return self.likelihood(density + DENSITY_FLOOR, self.power[rows]), head

    def evaluate_loss(self, network: FieldNetwork, rows: Tensor) -> float:
        """Return the mean loss of the windows `rows`, computed without gradients."""
        with torch.no_grad():
            return float(np.mean([float(self.compute_loss(network, chunk)[0]) for chunk in rows.split(1024)]))  # type: ignore[no-untyped-call]

    def compute_roughness(self, head: Tensor) -> Tensor:
        """Return the mean squared second difference of log amplitude between neighbouring 10 Hz bands."""
        fine = self.config.carriers.time_slice.start + 1
        bands = head[..., fine : fine + FINE_BINS - 1]
        return (bands[..., 2:] - 2.0 * bands[..., 1:-1] + bands[..., :-2]).square().mean()


def _select_rows(task: _TrainingTask | MagnitudeTask, role: int) -> Tensor:
    """Return the indices of the windows with a role (TRAIN, VALIDATION or TEST)."""
    return torch.tensor(np.flatnonzero(task.role == role))


def _compute_test_metrics(
    task: _TrainingTask | MagnitudeTask, network: FieldNetwork, windows: Windows
) -> HeldOutMetrics | None:
    """Compute the metrics of the test windows; None if there are none."""
    rows = _select_rows(task, TEST)
    if len(rows) == 0:
        return None
    with torch.no_grad():
        density = np.concatenate([task.predict_power(network, chunk).numpy() for chunk in rows.split(1024)])  # type: ignore[no-untyped-call]
    power = windows.power[rows.numpy()]
    expected, recorded = (power_rows.mean(axis=0, dtype=np.float64) + DENSITY_FLOOR for power_rows in (density, power))
    counted = np.flatnonzero(windows.counted_bins[:FINE_BINS])
    error_magnitude = np.sqrt(task.magnitude_power * density[:, counted]) - np.sqrt(power[:, counted])
    fine_bins = counted[1:]
    loud = fine_bins[recorded[fine_bins] > 1e-3 * recorded[fine_bins].max()]
    error = 10.0 * np.log10(expected[loud] / recorded[loud])
    width = compute_bin_widths() * windows.counted_bins
    return HeldOutMetrics(
        len(rows), task.evaluate_loss(network, rows), float(np.sqrt(np.mean(np.square(error)))),
        float(10.0 * np.log10((expected @ width) / (recorded @ width))),
        float(np.sum(np.square(error_magnitude)) / np.sum(power[:, counted])), 4.34 / math.sqrt(len(rows)),
    )  # fmt: skip


def _make_initial_parameters(config: FieldConfig, windows: Windows, seed: int) -> dict[str, NDArray[np.float32]]:
    """Return the network's initial parameters.

    Without the linear contact (config.physics) every band starts at its mean power over the training windows.
    """
    parameters = initial_parameters(config, seed)
    if config.physics or config.emission != "log":
        return parameters
    mean = windows.power[windows.role == TRAIN].mean(axis=0)
    bin_edges = np.concatenate([[0.0], np.cumsum(compute_bin_widths())])
    carriers, bias = config.carriers, parameters["alpha.bias"].copy()
    edges = carriers.time_edges()
    density = np.interp(np.sqrt(edges[1:] * edges[:-1]), 0.5 * (bin_edges[1:] + bin_edges[:-1]), mean)
    heads = config.alpha_heads
    power_fraction = 0.5 if carriers.arc_count else 1.0
    level = 0.5 * np.log(power_fraction * np.maximum(density, DENSITY_FLOOR) * np.diff(edges)) - np.log(heads)
    counted = windows.counted_bins[
        np.clip(np.searchsorted(bin_edges, edges[:-1], side="right") - 1, 0, len(windows.counted_bins) - 1)
    ]
    arc = np.full(config.alpha_outputs - carriers.time_count, 0.0)
    if carriers.arc_count:
        arc += 0.5 * np.log(
            power_fraction * np.maximum(np.sum(mean * compute_bin_widths()), DENSITY_FLOOR) / carriers.arc_count
        )
    bias[:] = np.tile(np.concatenate([np.where(counted, level, SILENT_LOG_AMPLITUDE), arc]), heads)
    parameters["alpha.weight"] = 0.1 * parameters["alpha.weight"]
    parameters["alpha.bias"] = bias.astype(np.float32)
    return parameters


def _train_epochs(
    task: _TrainingTask | MagnitudeTask,
    start: dict[str, NDArray[np.float32]],
    schedule: Schedule,
    seed: int,
    checkpoint: Path | None,
    watch: ProgressCallback | None,
) -> tuple[FieldNetwork, Float]:
    """Run the epochs from parameters `start` or the checkpoint; return the best network and the losses per epoch."""
    train, validation = _select_rows(task, TRAIN), _select_rows(task, VALIDATION)
    fingerprint = _compute_fingerprint(task, schedule, seed)
    network = FieldNetwork(task.config, start)
    optimiser = torch.optim.AdamW(network.parameters(), lr=schedule.learning_rate, weight_decay=schedule.decay)
    generator = torch.Generator().manual_seed(seed)
    repeats = max(1, math.ceil(schedule.batches * schedule.batch / len(train)))
    restored = load_checkpoint(checkpoint, fingerprint) if checkpoint else None
    history = np.zeros((0, 3)) if restored is None else restored.history
    best = (
        network.to_numpy_parameters()
        if restored is None
        else _restore_checkpoint(restored, network, optimiser, generator)
    )
    for epoch in range(len(history), schedule.epochs):
        if len(history) - _find_best_epoch(history) > schedule.patience:
            break
        order = torch.cat([train[torch.randperm(len(train), generator=generator)] for _ in range(repeats)])
        batches = order.split(schedule.batch)  # type: ignore[no-untyped-call]
        total = 0.0
        for step, rows in enumerate(batches):
            progress = (epoch + step / len(batches)) / schedule.epochs
            middle, swing = 0.5 * (1.0 + schedule.last_rate), 0.5 * (1.0 - schedule.last_rate)
            optimiser.param_groups[0]["lr"] = schedule.learning_rate * (middle + swing * math.cos(math.pi * progress))
            optimiser.zero_grad()
            total += task.accumulate_gradient(network, rows) * len(rows)
            optimiser.step()
        row = [epoch + 1.0, total / len(order), task.evaluate_loss(network, validation)]
        history = np.vstack([history, row])
        if _find_best_epoch(history) == len(history):
            best = network.to_numpy_parameters()
        if checkpoint:
            save_checkpoint(checkpoint, _make_checkpoint(network, optimiser, generator, best, history), fingerprint)
        if watch:
            watch(epoch + 1, schedule.epochs, row[2])
    return FieldNetwork(task.config, best), history


def _find_best_epoch(history: Float) -> int:
    """Return the number of the epoch with the lowest validation loss, 0 if there was none yet."""
    return int(np.argmin(history[:, 2])) + 1 if len(history) else 0


def _make_checkpoint(
    network: FieldNetwork,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    best: dict[str, NDArray[np.float32]],
    history: Float,
) -> Checkpoint:
    """Collect weights, optimiser state, best weights, random state and losses in a checkpoint."""
    tensors: dict[str, NDArray[np.generic]] = {f"best.{name}": value for name, value in best.items()}
    for name, parameter in network.named_parameters():
        tensors[f"network.{name}"] = parameter.detach().numpy()
        for key, value in optimiser.state[parameter].items():
            tensors[f"optimiser.{name}.{key}"] = value.numpy()
    tensors["random"] = generator.get_state().numpy()
    return Checkpoint(len(history), tensors, history)


def _restore_checkpoint(
    checkpoint: Checkpoint, network: FieldNetwork, optimiser: torch.optim.Optimizer, generator: torch.Generator
) -> dict[str, NDArray[np.float32]]:
    """Restore network, optimiser and random state in place; return the best weights so far."""
    stored = checkpoint.tensors
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            parameter.copy_(torch.tensor(stored[f"network.{name}"]))
            prefix = f"optimiser.{name}."
            optimiser.state[parameter] = {
                key.removeprefix(prefix): torch.tensor(value) for key, value in stored.items() if key.startswith(prefix)
            }
    generator.set_state(torch.tensor(stored["random"]))
    return {
        name.removeprefix("best."): np.asarray(value, dtype=np.float32)
        for name, value in stored.items()
        if name.startswith("best.")
    }


def _compute_fingerprint(task: _TrainingTask | MagnitudeTask, schedule: Schedule, seed: int) -> str:
    """Hash data, architecture, schedule, seed and versions, which must be the same to continue from a checkpoint."""
    words = repr((task.config, schedule, seed, torch.__version__, np.__version__))
    return content_hash(words, *(array.numpy().tobytes() for array in task.get_data()))
