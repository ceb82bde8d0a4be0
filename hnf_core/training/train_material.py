"""What F_Θ, rendered over time, leads one to expect of a window: the torch side of the expected-power likelihood.

One field for one material, from recordings of it: the expected-power likelihood, Adam, a cosine, early stopping.

P. Whittle (1953): where S is expected and P recorded, Σ log S + P / S is least in expectation at S = E P. L_mag of the
paper compares two random draws and learns up to 2 dB too quiet a signal; the laboratory has it (published_hnf.py).
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
from ..field.features import build_inputs
from ..field.field import Field, FieldConfig, initial_parameters
from ..field.linear_contact import Condition
from ..field.temporal_rendering import STEP_S
from ..field.training_ranges import compute_training_ranges
from ..files import content_hash
from ..material.contact_model import UNKNOWN_MECHANICS, Mechanics
from ..material.token import TOKEN_DIM
from .checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from .likelihood import DENSITY_FLOOR, WindowLikelihood, compute_arc_density, compute_expectation_matrices
from .model import FieldNetwork, render_weights
from .simulated_strokes import FINE_BINS, compute_bin_widths
from .windows import TEST, TRAIN, VALIDATION, States, Windows, cut_windows

Float = NDArray[np.float64]

SPEED_NODES = 96
"""Speeds at which the arc carriers' expectation is tabulated, evenly in log: within a tenfold range their step is
smaller than a carrier is wide."""
STATES_PER_CHUNK = 4096


@dataclass(frozen=True)
class RenderedInputs:
    """F_Θ's inputs at the states that windows need (s of them), and where each window finds its own.

    x: (s, D). prior, gate: (s, K). phase: (s, K) radians by which a carrier turns in one Δt. speed: (s,) index into
    the tabulated speeds. at: (n, Q, P) rows of the above: node by past state (P = 1 for "heads"). alive: (n, Q, P)
    0 where that past lies before the recording. share: (Q,).
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
    """(SPEED_NODES,) m/s over the speeds that occur."""
    moving = states.speed[states.speed > 1e-3]
    low, high = (float(moving.min()), float(moving.max())) if len(moving) else (0.01, 0.1)
    return np.geomspace(low, max(high, 1.01 * low), SPEED_NODES)


def build_rendered_inputs(
    config: FieldConfig, states: States, windows: Windows, token: NDArray[np.float32], mechanics: Mechanics
) -> RenderedInputs:
    """Everything that stays the same while the network learns."""
    past = config.states if config.accumulation == "past" else 1
    wanted = windows.node[:, :, None] - config.stride * np.arange(past)
    alive = wanted >= windows.first[windows.node][:, :, None]
    used, at = np.unique(np.where(alive, wanted, windows.node[:, :, None]), return_inverse=True)
    parts = [
        _build_state_inputs(config, states, used[low : low + STATES_PER_CHUNK], token, mechanics)
        for low in range(0, len(used), STATES_PER_CHUNK)
    ]
    x, prior, gate = (torch.tensor(np.concatenate(column)) for column in zip(*parts, strict=True))
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
        torch.tensor(at.reshape(wanted.shape)), torch.tensor(alive.astype(np.float32)),
        torch.tensor(windows.node_weight, dtype=torch.float32),
    )  # fmt: skip


class RenderedPower:
    """Expected power of windows, (rows, 107), given a network. speeds: from speed_table."""

    def __init__(self, config: FieldConfig, speeds: Float) -> None:
        used = speeds if config.carriers.arc_count else speeds[:1]
        time, arc = compute_expectation_matrices(config.carriers, used)
        self.config = config
        self.time = torch.tensor(time, dtype=torch.float32)
        self.arc = torch.tensor(arc, dtype=torch.float32)

    def __call__(self, network: FieldNetwork, inputs: RenderedInputs, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Also the α head's raw outputs of those rows, for regularisation."""
        carriers, at = self.config.carriers, inputs.state_rows[rows]
        flat = at.reshape(-1)
        head, sigma_dt = network.evaluate_heads(inputs.x[flat])
        alpha = network.compute_emission(head, inputs.prior[flat], inputs.gate[flat])
        if self.config.accumulation == "past":
            memory = sigma_dt.reshape(*at.shape, -1).diagonal(dim1=-2, dim2=-1)
            weight = render_weights(memory) * inputs.alive[rows]
            amplitude = (weight[..., None] * alpha.reshape(*at.shape, -1)).sum(dim=-2)
            power = amplitude.square()
        else:
            lag = torch.arange(self.config.states, dtype=torch.float32)[None, :, None] * inputs.phase[flat][:, None, :]
            emitted = render_weights(sigma_dt)[..., None] * alpha
            real, imaginary = (emitted * torch.cos(lag)).sum(dim=1), (emitted * torch.sin(lag)).sum(dim=1)
            power = (real.square() + imaginary.square()).reshape(*at.shape[:2], -1)
        out = torch.einsum("q,rqk,kb->rb", inputs.share, power[..., carriers.time_slice], self.time)
        if carriers.arc_count:
            speed = inputs.speed[at[..., 0]]
            dense = compute_arc_density(power[..., carriers.arc_slice].flatten(0, 1), speed.flatten(), self.arc)
            out = out + torch.einsum("q,rqb->rb", inputs.share, dense.reshape(*speed.shape, -1))
        return out, head


def _build_state_inputs(
    config: FieldConfig, states: States, rows: NDArray[np.int64], token: NDArray[np.float32], mechanics: Mechanics
) -> tuple[NDArray[np.float32], ...]:
    condition = Condition(
        tokens=np.tile(token.astype(np.float64), (len(rows), 1)),
        mechanics=(mechanics,),
        material=np.zeros(len(rows), dtype=np.int32),
        direction=states.direction[rows],
        speed=states.speed[rows],
        force=states.force[rows],
        contact=states.contact[rows],
        probe=states.probe,
    )
    inputs = build_inputs(condition, config.carriers, config.physics, config.action_octaves, config.directed)
    return inputs.x.astype(np.float32), inputs.prior.astype(np.float32), inputs.gate.astype(np.float32)


ProgressCallback = Callable[[int, int, float], None]
"""Called after every epoch with (epoch, epochs, validation loss)."""

SILENT_LOG_AMPLITUDE = -12.0
"""Log amplitude of bands above the recordings' rate: nothing is known there, and nothing is played."""


@dataclass(frozen=True)
class Schedule:
    """batches: of `batch` windows in one epoch, at least (a short recording is gone through several times). patience:
    epochs without a better validation loss before training stops; the best epoch is kept. smoothness: weight on the
    squared second difference of log amplitude between neighbouring 10 Hz bands, per window: some ten seconds near one
    speed and force cannot tell a hundred bands apart."""

    epochs: int = 40
    batches: int = 32
    batch: int = 256
    learning_rate: float = 3e-3
    decay: float = 1e-2
    smoothness: float = 3.0
    patience: int = 15


@dataclass(frozen=True)
class HeldOutMetrics:
    """Over n held-out windows. loss: negative log-likelihood per bin. distance_db: RMS difference between expected and
    recorded mean spectrum (bins heard in 20–1000 Hz within 30 dB of the peak). bias_db: of the whole power.
    l_mag_share: the paper's L_mag of the magnitudes expected, √(π S) / 2, over the recorded power; 0.215 is the best
    possible on Gaussian noise, 1 is silence.
    scatter_db: what distance_db a perfect model would show on Gaussian noise, 4.34 / √n."""

    windows: int
    loss: float
    distance_db: float
    bias_db: float
    l_mag_share: float
    scatter_db: float


@dataclass(frozen=True)
class TrainingResult:
    """field: the best epoch's. history: (epochs, 3) number, training and validation loss. test: of the tenth that
    training never saw, None where the recordings are too short to have one."""

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
) -> TrainingResult:
    """Fit F_Θ to recordings of one material with one probe.

    token, mechanics: of the material, where known. checkpoint: file that a killed run is taken up from; it is removed
    when training ends. Deterministic: equal arguments give equal weights on one machine, killed in between or not.
    Raises UsageError where the recordings are too short or of several probes.
    """
    torch.set_num_threads(1)
    states, windows = cut_windows(recordings)
    values = np.zeros(TOKEN_DIM, dtype=np.float32) if token is None else token
    inputs = build_rendered_inputs(config, states, windows, values, mechanics)
    task = _TrainingTask(config, schedule, inputs, windows, RenderedPower(config, make_speed_table(states)))
    network, history = _train_epochs(
        task, _make_initial_parameters(config, windows, seed), seed, checkpoint, _compute_fingerprint(task, seed), watch
    )
    ranges = compute_training_ranges(
        [recording.action for recording in recordings], values[None, :], [mechanics],
        directed=["direction" in recording.known for recording in recordings],
    )  # fmt: skip
    field = Field(config, network.to_numpy_parameters(), ranges)
    return TrainingResult(field, history, _compute_test_metrics(task, network, windows))


class _TrainingTask:
    """What is to be learned: the loss over rows of windows."""

    def __init__(
        self, config: FieldConfig, schedule: Schedule, inputs: RenderedInputs, windows: Windows, expected: RenderedPower
    ) -> None:
        self.config, self.schedule, self.inputs, self.expected = config, schedule, inputs, expected
        self.power = torch.tensor(windows.power + DENSITY_FLOOR, dtype=torch.float32)
        self.role = windows.role
        self.likelihood = WindowLikelihood(windows.counted_bins)

    def select_rows(self, role: int) -> Tensor:
        return torch.tensor(np.flatnonzero(self.role == role))

    def compute_loss(self, network: FieldNetwork, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Mean negative log-likelihood of rows, and the α head's outputs."""
        density, head = self.expected(network, self.inputs, rows)
        return self.likelihood(density + DENSITY_FLOOR, self.power[rows]), head

    def evaluate_loss(self, network: FieldNetwork, rows: Tensor) -> float:
        with torch.no_grad():
            return float(np.mean([float(self.compute_loss(network, part)[0]) for part in rows.split(1024)]))  # type: ignore[no-untyped-call]

    def compute_roughness(self, head: Tensor) -> Tensor:
        """Mean squared second difference of log amplitude over the fine time bands."""
        fine = self.config.carriers.time_slice.start + 1
        bands = head[..., fine : fine + FINE_BINS - 1]
        return (bands[..., 2:] - 2.0 * bands[..., 1:-1] + bands[..., :-2]).square().mean()


def _compute_test_metrics(task: _TrainingTask, network: FieldNetwork, windows: Windows) -> HeldOutMetrics | None:
    rows = task.select_rows(TEST)
    if len(rows) == 0:
        return None
    with torch.no_grad():
        density = np.concatenate([task.expected(network, task.inputs, part)[0].numpy() for part in rows.split(1024)])  # type: ignore[no-untyped-call]
    power = windows.power[rows]
    expected, recorded = (each.mean(axis=0, dtype=np.float64) + DENSITY_FLOOR for each in (density, power))
    heard = np.flatnonzero(windows.counted_bins[:FINE_BINS])
    missed = np.sqrt(0.25 * np.pi * density[:, heard]) - np.sqrt(power[:, heard])
    fine = heard[1:]
    loud = fine[recorded[fine] > 1e-3 * recorded[fine].max()]
    error = 10.0 * np.log10(expected[loud] / recorded[loud])
    width = compute_bin_widths() * windows.counted_bins
    return HeldOutMetrics(
        len(rows), task.evaluate_loss(network, rows), float(np.sqrt(np.mean(np.square(error)))),
        float(10.0 * np.log10((expected @ width) / (recorded @ width))),
        float(np.sum(np.square(missed)) / np.sum(power[:, heard])), 4.34 / math.sqrt(len(rows)),
    )  # fmt: skip


def _make_initial_parameters(config: FieldConfig, windows: Windows, seed: int) -> dict[str, NDArray[np.float32]]:
    """Initial parameters; without physics every band starts at its mean over the training windows."""
    parameters = initial_parameters(config, seed)
    if config.physics or config.emission != "log":
        return parameters
    mean = windows.power[windows.role == TRAIN].mean(axis=0)
    centre = np.concatenate([[0.0], np.cumsum(compute_bin_widths())])
    carriers, bias = config.carriers, parameters["alpha.bias"].copy()
    edges = carriers.time_edges()
    density = np.interp(np.sqrt(edges[1:] * edges[:-1]), 0.5 * (centre[1:] + centre[:-1]), mean)
    heads = config.alpha_heads
    share = 0.5 if carriers.arc_count else 1.0
    level = 0.5 * np.log(share * np.maximum(density, DENSITY_FLOOR) * np.diff(edges)) - np.log(heads)
    heard = windows.counted_bins[
        np.clip(np.searchsorted(centre, edges[:-1], side="right") - 1, 0, len(windows.counted_bins) - 1)
    ]
    arc = np.full(config.alpha_outputs - carriers.time_count, 0.0)
    if carriers.arc_count:
        arc += 0.5 * np.log(share * np.maximum(np.sum(mean * compute_bin_widths()), DENSITY_FLOOR) / carriers.arc_count)
    bias[:] = np.tile(np.concatenate([np.where(heard, level, SILENT_LOG_AMPLITUDE), arc]), heads)
    parameters["alpha.weight"] = 0.1 * parameters["alpha.weight"]
    parameters["alpha.bias"] = bias.astype(np.float32)
    return parameters


def _train_epochs(
    task: _TrainingTask,
    start: dict[str, NDArray[np.float32]],
    seed: int,
    checkpoint: Path | None,
    fingerprint: str,
    watch: ProgressCallback | None,
) -> tuple[FieldNetwork, Float]:
    schedule, train, validation = task.schedule, task.select_rows(TRAIN), task.select_rows(VALIDATION)
    network = FieldNetwork(task.config, start)
    optimiser = torch.optim.AdamW(network.parameters(), lr=schedule.learning_rate, weight_decay=schedule.decay)
    generator = torch.Generator().manual_seed(seed)
    passes = max(1, math.ceil(schedule.batches * schedule.batch / len(train)))
    done = load_checkpoint(checkpoint, fingerprint) if checkpoint else None
    history = np.zeros((0, 3)) if done is None else done.history
    best = network.to_numpy_parameters() if done is None else _restore_checkpoint(done, network, optimiser, generator)
    for epoch in range(len(history), schedule.epochs):
        if len(history) - _find_best_epoch(history) > schedule.patience:
            break
        order = torch.cat([train[torch.randperm(len(train), generator=generator)] for _ in range(passes)])
        parts = order.split(schedule.batch)  # type: ignore[no-untyped-call]
        total = 0.0
        for step, rows in enumerate(parts):
            place = (epoch + step / len(parts)) / schedule.epochs
            optimiser.param_groups[0]["lr"] = schedule.learning_rate * (0.505 + 0.495 * math.cos(math.pi * place))
            loss, head = task.compute_loss(network, rows)
            optimiser.zero_grad()
            (loss + schedule.smoothness * task.compute_roughness(head)).backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            total += float(loss.detach()) * len(rows)
        row = [epoch + 1.0, total / len(order), task.evaluate_loss(network, validation)]
        history = np.vstack([history, row])
        if _find_best_epoch(history) == len(history):
            best = network.to_numpy_parameters()
        if checkpoint:
            save_checkpoint(checkpoint, _make_checkpoint(network, optimiser, generator, best, history), fingerprint)
        if watch:
            watch(epoch + 1, schedule.epochs, row[2])
    if checkpoint:
        checkpoint.unlink(missing_ok=True)
    return FieldNetwork(task.config, best), history


def _find_best_epoch(history: Float) -> int:
    return int(np.argmin(history[:, 2])) + 1 if len(history) else 0


def _make_checkpoint(
    network: FieldNetwork,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    best: dict[str, NDArray[np.float32]],
    history: Float,
) -> Checkpoint:
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
    """Put everything back; returns the best weights so far."""
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


def _compute_fingerprint(task: _TrainingTask, seed: int) -> str:
    """What a checkpoint must agree in: data, architecture, schedule, seed, versions."""
    words = repr((task.config, task.schedule, seed, torch.__version__, np.__version__))
    arrays = (task.power, task.inputs.x, task.inputs.state_rows, task.likelihood.weight)
    return content_hash(words, *(array.numpy().tobytes() for array in arrays))
