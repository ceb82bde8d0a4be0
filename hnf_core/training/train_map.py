"""Train D_φ on rendered pairs of photograph and touch, within a budget of steps or minutes, and write its weights.

D_φ predicts tactile maps from photographs. A killed run continues from its checkpoint. Validation compares predictions
with the true maps of views that were not trained on.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    PAIR_SENSORS,
    TRAIN,
    Pairs,
    decode_rgb,
    load_pairs,
    vary_photograph,
)
from ..errors import UsageError
from ..files import content_hash
from ..material.encoder_registry import describe_views, get_encoder
from ..material.fuse import compute_library_spread
from ..material.token import ENCODER_ID
from ..tactile.diffusion import make_tactile_map, predict_tactile_maps
from ..tactile.unet import DIFFUSION, REGRESSION, TOKEN_ERROR, MapConfig, MapWeights, load_map_weights, save_map_weights
from ..tactile.views import AppearanceView
from .fit import Checkpoint, load_checkpoint, save_checkpoint
from .map_network import (
    Batch,
    MapNetwork,
    compute_level_statistics,
    compute_losses,
    make_fixed_batch,
    make_training_batch,
    pick_sensor,
    sample_slopes,
)

Array = NDArray[np.float32]


OCTAVES = 4
"""Token bands in which slope power is compared."""
VIEWS_PER_BATCH = 32


@dataclass(frozen=True)
class Distance:
    """Errors of predicted maps on one split of the data.

    Attributes
    ----------
    pattern_loss, level_loss
        Mean squared error of the diffusion target v (regression: of the values themselves), for the slope pattern and
        for the level, the log RMS slope.
    level_db
        Median absolute error of the predicted RMS slope [dB]; None if no map was predicted.
    band_db
        Median absolute error of the slope power in an octave of wavelength [dB], over views and four octaves; None
        likewise.
    """

    pattern_loss: float
    level_loss: float
    level_db: float | None = None
    band_db: float | None = None

    def describe(self) -> str:
        """Format the errors as text."""
        words = f"loss {self.pattern_loss:.4f} + level {self.level_loss:.4f}"
        if self.level_db is None:
            return words
        return f"{words}, RMS slope {self.level_db:.2f} dB off, band power {self.band_db:.2f} dB off"


def draw_batches(pairs: Pairs, views: int, seed: int) -> list[Batch]:
    """Draw `views` random views without repetition as validation batches, which use the touch sensors in turn."""
    rows = np.random.default_rng(seed).permutation(len(pairs))[:views]
    batches = [rows[start : start + VIEWS_PER_BATCH] for start in range(0, len(rows), VIEWS_PER_BATCH)]
    return [make_fixed_batch(pairs, batch_rows, index % len(PAIR_SENSORS)) for index, batch_rows in enumerate(batches)]


def measure_distances(
    network: MapNetwork, splits: Mapping[str, Pairs], views: int, seed: int, steps: int | None
) -> dict[str, Distance]:
    """Measure the error of predicted maps on `views` views of every split.

    steps: diffusion steps for predicting maps; None predicts none.
    """
    return {
        name: _measure_distance(network, draw_batches(pairs, views, seed), seed, steps)
        for name, pairs in splits.items()
    }


def compute_band_powers(slopes: Array) -> NDArray[np.float64]:
    """Compute the power (n, OCTAVES) of slopes (n, 2, 64, 64) in octaves of wavelength, under a Hann window.

    The octaves are centred on wavelengths of 25.6, 12.8, 6.4 and 3.2 pixels.
    """
    size = slopes.shape[-1]
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(size) + 0.5) / size)
    spectrum = np.abs(np.fft.rfft2(slopes * np.outer(hann, hann))) ** 2
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    centres = 2.0 ** np.arange(OCTAVES) / 25.6
    inside = [(frequency >= centre / np.sqrt(2.0)) & (frequency < centre * np.sqrt(2.0)) for centre in centres]
    return np.stack([spectrum[..., mask].sum(axis=(1, 2)) for mask in inside], axis=1)


def _measure_distance(network: MapNetwork, batches: list[Batch], seed: int, steps: int | None) -> Distance:
    network.eval()
    pattern, level, level_db, band_db = [], [], [], []
    for index, batch in enumerate(batches):
        with torch.no_grad():
            pattern_loss, level_loss = compute_losses(network, batch, np.random.default_rng((seed, index)))
        pattern.append(float(pattern_loss) * len(batch))
        level.append(float(level_loss) * len(batch))
        if steps is not None:
            slopes, log_rms = sample_slopes(network, batch, seed + index, steps)
            level_db.append(20.0 * np.abs(log_rms - batch.log_rms))
            predicted, expected = (
                compute_band_powers(pattern_slopes * 10.0 ** rms[:, None, None, None])
                for pattern_slopes, rms in ((slopes, log_rms), (batch.slopes, batch.log_rms))
            )
            band_db.append(np.abs(10.0 * np.log10((predicted + 1e-9) / (expected + 1e-9))))
    network.train()
    count = sum(len(batch) for batch in batches)
    means = sum(pattern) / count, sum(level) / count
    if steps is None:
        return Distance(*means)
    return Distance(*means, float(np.median(np.concatenate(level_db))), float(np.median(np.concatenate(band_db))))


def measure_token_error(weights: MapWeights, pairs: Pairs, tiles: int, seed: int) -> NDArray[np.float32]:
    """Measure the standard errors (TOKEN_DIM,) of predicted tokens, by the true maps' tokens of the same views.

    Parameters
    ----------
    weights : MapWeights
        Weights of D_φ.
    pairs : Pairs
        Views that D_φ never met, of materials that it never met. Their pictures are varied as photographs are.
    tiles : int
        Number of tiles, spread over the pairs.
    seed : int
        Seed of photographs and of a diffusion's noise.

    Returns
    -------
    ndarray of float32, shape (TOKEN_DIM,)
        Root mean squares of what the tokens are off; where these surfaces differ less among each other than those of
        the library do, larger in proportion, so that the share that is explained is theirs. NaN for a value that is
        never known.
    """
    predicted, true = _predict_tokens(weights, pairs, tiles, seed)
    _, library = compute_library_spread()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a value that is never known has no mean
        error = np.sqrt(np.nanmean(np.square(predicted - true), axis=0))
        spread = np.sqrt(np.maximum(np.nanvar(true, axis=0), 1e-12))
    return np.asarray(error * np.maximum(1.0, np.sqrt(library) / spread), dtype=np.float32)


def _predict_tokens(
    weights: MapWeights, pairs: Pairs, tiles: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return predicted and true tokens (tiles, TOKEN_DIM) of tiles spread over the pairs, NaN where not known."""
    encoder = get_encoder(ENCODER_ID)
    rows_of: list[NDArray[np.float64]] = []
    for index, tile in enumerate(np.unique(np.linspace(0, pairs.tiles - 1, tiles).astype(int))):
        rows = np.flatnonzero(pairs.tile_index == tile)
        sensor = PAIR_SENSORS[which := pick_sensor(pairs, rows[0], index % pairs.slopes.shape[1])]
        rgb = decode_rgb(vary_photograph(pairs.rgb[rows], np.random.default_rng([seed, 7, tile])))
        pitch = [float(each) for each in pairs.pitch_m[rows]]
        depth = pairs.depth[rows].astype(np.float32) * np.array(pitch, dtype=np.float32)[:, None, None]
        views = [
            AppearanceView(colour, form, bool(form.any()), size)
            for colour, form, size in zip(rgb, depth, pitch, strict=True)
        ]
        slopes = pairs.slopes[rows, which].astype(np.float32)
        true_maps = [make_tactile_map(each, size, sensor) for each, size in zip(slopes, pitch, strict=True)]
        maps = predict_tactile_maps(weights, views, sensor, seed=seed)
        tokens = [describe_views(encoder, each) for each in (list(maps), true_maps)]
        known = tokens[0].known & tokens[1].known
        rows_of.append(np.stack([np.where(known, token.values, np.nan) for token in tokens]).astype(np.float64))
    predicted, true = np.moveaxis(np.stack(rows_of), 1, 0)
    return predicted, true


def write_token_error(path: Path, out: Path, data: Sequence[Pairs], tiles: int, seed: int) -> NDArray[np.float32]:
    """Measure the errors of weights on several kinds of unseen data, and write the weights with the larger of them.

    What is met in use is unlike any of them, so a network that errs more on one of them is trusted no more than there.
    """
    weights = load_map_weights(path)
    error = np.fmax.reduce([measure_token_error(weights, pairs, tiles, seed) for pairs in data])
    error = np.clip(np.nan_to_num(error, nan=LARGEST_ERROR), SMALLEST_ERROR, LARGEST_ERROR)
    header = {name: text for name, text in weights.metadata.items() if name not in ("format", "architecture")}
    words = json.dumps([round(float(value), 4) for value in error])
    save_map_weights(out, weights.config, weights.network.parameters, {**header, TOKEN_ERROR: words})
    return np.asarray(error, dtype=np.float32)


SMALLEST_ERROR, LARGEST_ERROR = 1e-3, 100.0
"""Limits of the errors in the header of weights; the largest also stands for a value that was never known."""


ProgressCallback = Callable[[int, float, float, Mapping[str, Distance]], None]
"""Called with (steps done, fraction of the budget, running loss, distances: empty between validations)."""


@dataclass(frozen=True)
class MapTrainingPlan:
    """Budget and hyperparameters of a training.

    Attributes
    ----------
    steps, minutes
        Budget, at least one of them; training ends when the first is used up. Validation does not count.
    batch
        Views per step.
    rate
        Learning rate of AdamW, after warm_up steps, with cosine annealing to 0 at the budget's end.
    warm_up
        Steps of linear warm-up.
    decay, clip
        Weight decay, and gradient norm above which gradients are scaled down.
    ema
        Decay of the averaged weights.
    level_weight
        Weight of the loss of the level (log RMS slope) relative to that of the slope pattern.
    seed
        Seed of initialisation, batches and noise.
    threads
        Threads of torch.
    half
        Use bfloat16.
    photographs
        Vary the pictures as by other cameras.
    validate_views, validate_minutes
        Views of each held-out split, and time between validations; maps are sampled only at the end.
    checkpoint_minutes
        Time between checkpoints.
    """

    steps: int | None = None
    minutes: float | None = None
    batch: int = 16
    rate: float = 1e-3
    warm_up: int = 200
    decay: float = 0.01
    clip: float = 1.0
    ema: float = 0.998
    level_weight: float = 0.5
    seed: int = 0
    threads: int = 1
    half: bool = True
    photographs: bool = True
    validate_views: int = 96
    validate_minutes: float = 3.0
    checkpoint_minutes: float = 3.0

    def compute_progress(self, step: int, seconds: float) -> float:
        """Return the fraction of the budget that is used up."""
        by_steps = 0.0 if self.steps is None else step / max(self.steps, 1)
        by_time = 0.0 if self.minutes is None else seconds / (60.0 * self.minutes)
        return max(by_steps, by_time)


@dataclass(frozen=True)
class FitResult:
    """Result of `fit_map`: architecture with the levels' mean and scale, averaged weights, cost, held-out errors."""

    config: MapConfig
    parameters: dict[str, NDArray[np.float32]]
    steps: int
    seconds: float
    distances: Mapping[str, Distance]


@dataclass
class _TrainingState:
    network: MapNetwork
    optimiser: torch.optim.AdamW
    average: dict[str, Tensor]
    step: int = 0
    seconds: float = 0.0


def fit_map(
    pairs: Pairs,
    held_out: Mapping[str, Pairs],
    plan: MapTrainingPlan,
    config: MapConfig,
    checkpoint: Path | None = None,
    watch: ProgressCallback = lambda *_: None,
    start: MapWeights | None = None,
) -> FitResult:
    """Train on pairs, from `start` if given, with validation on held-out splits by the averaged weights.

    With a budget of steps alone the same seed gives the same weights on the same machine and torch, resumed or not;
    with minutes the learning rate follows the clock. Raises UsageError without a budget or without enough pairs,
    FileError if the checkpoint cannot be written.
    """
    if plan.steps is None and plan.minutes is None:
        raise UsageError("training needs a number of steps or of minutes.")
    if len(pairs) < plan.batch:
        raise UsageError(f"{len(pairs)} pairs are fewer than a batch of {plan.batch}.")
    torch.set_num_threads(plan.threads)
    if start is None:
        mean, scale = compute_level_statistics(pairs)
        config = replace(config, level_mean=mean, level_scale=scale)
    else:
        config = start.config
    state = _make_initial_state(config, plan, start)
    fingerprint = _compute_fingerprint(pairs, plan, config) + ("" if start is None else start.fingerprint)
    if checkpoint is not None:
        _restore_checkpoint(state, load_checkpoint(checkpoint, fingerprint))
    running, saved, validated = math.nan, state.seconds, state.seconds
    while plan.compute_progress(state.step, state.seconds) < 1.0:
        began = time.monotonic()
        loss = _train_step(state, pairs, plan)
        state.seconds += time.monotonic() - began
        running = loss if math.isnan(running) else 0.98 * running + 0.02 * loss
        distances: dict[str, Distance] = {}
        if state.seconds - validated >= 60.0 * plan.validate_minutes:
            validated = state.seconds
            distances = measure_distances(_make_averaged_network(state), held_out, plan.validate_views, plan.seed, None)
        watch(state.step, plan.compute_progress(state.step, state.seconds), running, distances)
        if checkpoint is not None and state.seconds - saved >= 60.0 * plan.checkpoint_minutes:
            saved = state.seconds
            save_checkpoint(checkpoint, _make_checkpoint(state), fingerprint)
    if checkpoint is not None:
        save_checkpoint(checkpoint, _make_checkpoint(state), fingerprint)
    final = measure_distances(_make_averaged_network(state), held_out, plan.validate_views, plan.seed, 20)
    parameters = {name: value.numpy().astype(np.float32) for name, value in state.average.items()}
    return FitResult(config, parameters, state.step, state.seconds, final)


def _train_step(state: _TrainingState, pairs: Pairs, plan: MapTrainingPlan) -> float:
    """Run one step and return its loss."""
    per_epoch = len(pairs) // plan.batch
    epoch, index = divmod(state.step, per_epoch)
    order = np.random.default_rng((plan.seed, 1, epoch)).permutation(len(pairs))
    rng = np.random.default_rng((plan.seed, 2, state.step))
    batch = make_training_batch(
        pairs, order[index * plan.batch : (index + 1) * plan.batch], rng, photographs=plan.photographs
    )
    for group in state.optimiser.param_groups:
        group["lr"] = _compute_learning_rate(plan, state)
    with torch.autocast("cpu", torch.bfloat16, enabled=plan.half):
        pattern, level = compute_losses(state.network, batch, rng)
    loss = pattern + plan.level_weight * level
    state.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), plan.clip)
    state.optimiser.step()
    state.step += 1
    decay = min(plan.ema, (1.0 + state.step) / (10.0 + state.step))
    with torch.no_grad():
        for name, value in state.network.state_dict().items():
            state.average[name].lerp_(value, 1.0 - decay)
    return float(loss.detach())


def _compute_learning_rate(plan: MapTrainingPlan, state: _TrainingState) -> float:
    """Return the learning rate of the current step."""
    spent = min(plan.compute_progress(state.step, state.seconds), 1.0)
    return plan.rate * min(1.0, (state.step + 1) / plan.warm_up) * (0.5 + 0.5 * math.cos(math.pi * spent))


def _make_initial_state(config: MapConfig, plan: MapTrainingPlan, start: MapWeights | None) -> _TrainingState:
    torch.manual_seed(plan.seed)
    network = _make_network(config)
    if start is not None:
        network.load_state_dict({name: torch.from_numpy(value) for name, value in start.network.parameters.items()})
    optimiser = torch.optim.AdamW(network.parameters(), plan.rate, betas=(0.9, 0.99), weight_decay=plan.decay)
    return _TrainingState(network, optimiser, {name: value.clone() for name, value in network.state_dict().items()})


def _make_network(config: MapConfig) -> MapNetwork:
    network = MapNetwork(config)
    # oneDNN's half-precision convolutions want the channels last.
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network


def _make_averaged_network(state: _TrainingState) -> MapNetwork:
    """Return a network with the averaged weights."""
    network = _make_network(state.network.config)
    network.load_state_dict(state.average)
    return network


def _make_checkpoint(state: _TrainingState) -> Checkpoint:
    tensors: dict[str, NDArray[np.generic]] = {"seconds": np.array([state.seconds])}
    for name, parameter in state.network.named_parameters():
        moments = state.optimiser.state[parameter]
        tensors[f"network.{name}"] = parameter.detach().numpy()
        tensors[f"average.{name}"] = state.average[name].numpy()
        tensors[f"first.{name}"], tensors[f"second.{name}"] = (moments[key].numpy() for key in _MOMENTS)
    return Checkpoint(state.step, tensors, np.zeros((0, 3)))


_MOMENTS = ("exp_avg", "exp_avg_sq")


def _restore_checkpoint(state: _TrainingState, checkpoint: Checkpoint | None) -> None:
    if checkpoint is None:
        return
    state.step, state.seconds = checkpoint.epoch, float(checkpoint.tensors["seconds"][0])
    tensors = {
        name: torch.from_numpy(np.array(value)) for name, value in checkpoint.tensors.items() if name != "seconds"
    }
    with torch.no_grad():
        for name, parameter in state.network.named_parameters():
            parameter.copy_(tensors[f"network.{name}"])
            state.average[name].copy_(tensors[f"average.{name}"])
            moments = {key: torch.empty_like(parameter).copy_(tensors[f"{part}.{name}"])
                       for key, part in zip(_MOMENTS, ("first", "second"), strict=True)}  # fmt: skip
            state.optimiser.state[parameter] = {"step": torch.tensor(float(state.step)), **moments}


def _compute_fingerprint(pairs: Pairs, plan: MapTrainingPlan, config: MapConfig) -> str:
    """Hash data, network and hyperparameters, but not the budget, which a resumed run may change."""
    budget_free = replace(plan, steps=None, minutes=None, threads=1, validate_minutes=0.0, checkpoint_minutes=0.0)
    data = (pairs.tile_seed.tobytes(), pairs.slopes[0].tobytes(), pairs.slopes[-1].tobytes())
    return content_hash(repr((budget_free, config)), *data)


LICENCE = "GPL-3.0-or-later"
LEARNING_RATES = {DIFFUSION: 1e-3, REGRESSION: 2e-3}
"""Default learning rate of each objective."""


def train_map(
    folder: Path,
    plan: MapTrainingPlan,
    config: MapConfig,
    out: Path,
    checkpoint: Path,
    watch: ProgressCallback,
    *,
    partial: bool = False,
    start: Path | None = None,
) -> dict[str, Any]:
    """Train on the pairs in a folder (tools/make_tactile_pairs.py) and write the averaged weights.

    Parameters
    ----------
    folder
        Folder of the pairs.
    plan
        Budget and hyperparameters.
    config
        Architecture.
    out
        Path of the weights.
    checkpoint
        File from which a killed run continues.
    watch
        Called after every step.
    partial
        Train on the shards that are present.
    start
        Weights to go on from; their architecture is kept.

    Returns
    -------
    dict
        The record that is also in the weights' header.

    Raises
    ------
    FileError
        If pairs are missing or damaged.
    UsageError
        If the plan has no budget.
    """
    pairs = load_pairs(folder, TRAIN, partial=partial)
    held_out = {name: load_pairs(folder, name, partial=partial) for name in (HELD_OUT_INSTANCES, HELD_OUT_CLASSES)}
    data = (
        f"{len(pairs)} paired views of {pairs.tiles} generated tiles of {len(set(pairs.class_name) - {''})} classes "
        "and of random surfaces; no recorded data"
    )
    return train_on_pairs(
        pairs, held_out, plan, config, out, checkpoint, watch, data=data, licence=LICENCE, start=start
    )


def train_on_pairs(
    pairs: Pairs,
    held_out: Mapping[str, Pairs],
    plan: MapTrainingPlan,
    config: MapConfig,
    out: Path,
    checkpoint: Path,
    watch: ProgressCallback,
    *,
    data: str,
    licence: str,
    start: Path | None = None,
) -> dict[str, Any]:
    """Train on pairs in memory and write the averaged weights with their errors on the last held-out split.

    `data` and `licence` are said of the pairs in the header; for the rest, and what is raised, see `train_map`.
    """
    begun = None if start is None else load_map_weights(start)
    fitted = fit_map(pairs, held_out, plan, config, checkpoint, watch, begun)
    record = {
        "training_data": data if begun is None else f"{data}; begun from {begun.metadata.get('training_data', start)}",
        "objective": fitted.config.objective,
        "seed": plan.seed,
        "steps": fitted.steps,
        "views": fitted.steps * plan.batch,
        "minutes": round(fitted.seconds / 60.0, 1),
        "metrics": {name: asdict(distance) for name, distance in fitted.distances.items()},
        "licence": licence,
    }
    save_map_weights(out, fitted.config, fitted.parameters, _to_text(record))
    unseen = list(held_out.values())[-1]
    error = write_token_error(out, out, [unseen], plan.validate_views // 4, plan.seed)
    record[TOKEN_ERROR] = [float(value) for value in error]
    return {**record, "weights": str(out), "in_words": _format_distances(fitted)}


def _to_text(record: dict[str, Any]) -> dict[str, str]:
    return {
        name: value if isinstance(value, str) else json.dumps(value, sort_keys=True) for name, value in record.items()
    }


def _format_distances(fitted: FitResult) -> str:
    return "; ".join(f"{name}: {distance.describe()}" for name, distance in fitted.distances.items())
