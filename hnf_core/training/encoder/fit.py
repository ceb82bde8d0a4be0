"""Fit E: regression on the band descriptor of the whole tile, every output in units of its own spread."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ...datasets.tactile_pairs import Pairs
from ...material.alexnet.network import LEVEL_INDICES, OUTPUT_COUNT, AlexNet, AlexNetConfig
from .batches import LampSets, draw_lamps, make_batch
from .network import TorchAlexNet

ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True)
class Schedule:
    """steps of `batch` views, or `minutes` where they are sooner over (None: steps alone, and then the same seed gives
    the same weights on the same machine). learning_rate: its peak; warm_up: share of the run until there, then a
    cosine down to nothing. level_weight: of the levels against the other outputs. narrow: convolutions in bfloat16.
    """

    steps: int = 12000
    minutes: float | None = None
    batch: int = 64
    learning_rate: float = 1e-3
    warm_up: float = 0.05
    decay: float = 1e-4
    level_weight: float = 3.0
    narrow: bool = True


STATISTICS_VIEWS, INITIALISATION_VIEWS = 1024, 256
"""Views that the units of the outputs, and the scale of the first weights, are taken from."""
SMALLEST_SPREAD = 0.02
HUBER_DELTA = 0.2
"""In units of spread: below it errors count as squares, above as they are: chance peaks must not lead."""


def fit_encoder(
    design: AlexNetConfig,
    pairs: Pairs,
    schedule: Schedule,
    seed: int,
    *,
    backbone: dict[str, Tensor] | None = None,
    start: AlexNet | None = None,
    refresh: Callable[[], Pairs] | None = None,
    watch: ProgressCallback | None = None,
) -> TorchAlexNet:
    """Train the whole network, or with a trunk (torchvision's names) the head alone, the trunk as it is.

    start: an encoder of the same design to go on from, with its units. refresh: asked for the pairs of every further
    epoch, for a folder that still grows. watch(step, share done, mean loss of the last steps) is called about a hundred
    times.
    """
    torch.set_num_threads(1)
    twin = TorchAlexNet(design)
    twin.initialise(seed)
    if backbone is not None:
        twin.load_state_dict(backbone, strict=False)
        twin.features.requires_grad_(False)
    lamps = draw_lamps(seed)
    if start is None:
        _initialise_outputs(twin, pairs, lamps, seed)
    else:
        twin.load_state_dict({name: torch.tensor(value) for name, value in start.tensors.items()})
    twin.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    learnt = [parameter for parameter in twin.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(learnt, lr=schedule.learning_rate, weight_decay=schedule.decay)
    rng = np.random.default_rng([seed, 1])
    rows = np.zeros(0, dtype=np.intp)
    began, step, told, losses = time.monotonic(), 0, 0.0, []
    while (done := _compute_progress(schedule, step, time.monotonic() - began)) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = schedule.learning_rate * _compute_rate_factor(done, schedule.warm_up)
        if len(rows) < schedule.batch:
            if refresh is not None and step:
                pairs, rows = refresh(), rows[:0]
            rows = np.concatenate([rows, rng.permutation(len(pairs))])
        batch = make_batch(pairs, rows[: schedule.batch], lamps, rng)
        rows = rows[schedule.batch :]
        with torch.autocast("cpu", torch.bfloat16, enabled=schedule.narrow):
            found = twin(batch.views, batch.given)
        loss = compute_loss(twin, found, batch.target, schedule.level_weight)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(learnt, 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        step += 1
        if watch is not None and done >= told:
            watch(step, done, float(np.mean(losses)))
            told, losses = done + 0.01, []
    twin.eval()
    return twin


def compute_loss(network: TorchAlexNet, found: Tensor, target: Tensor, level_weight: float) -> Tensor:
    """Mean Huber loss over outputs in units of spread, levels weighted."""
    wanted = (target - network.output_mean) / network.output_spread
    weight = torch.ones(OUTPUT_COUNT)
    weight[list(LEVEL_INDICES)] = level_weight
    each = functional.huber_loss(found, wanted, reduction="none", delta=HUBER_DELTA) / HUBER_DELTA
    return (each * weight).mean() / weight.mean()


def _initialise_outputs(network: TorchAlexNet, pairs: Pairs, lamps: LampSets, seed: int) -> None:
    """Units of the outputs, and layers that start where they can learn."""
    rng = np.random.default_rng([seed, 2])
    batch = make_batch(pairs, rng.integers(0, len(pairs), STATISTICS_VIEWS), lamps, rng)
    network.output_mean.copy_(batch.target.mean(dim=0))
    network.output_spread.copy_(batch.target.std(dim=0, correction=0).clamp(min=SMALLEST_SPREAD))
    network.standardise_layers(batch.views[:INITIALISATION_VIEWS], batch.given[:INITIALISATION_VIEWS])


def _compute_progress(schedule: Schedule, step: int, seconds: float) -> float:
    by_time = 0.0 if schedule.minutes is None else seconds / (60.0 * schedule.minutes)
    return max(step / schedule.steps, by_time)


def _compute_rate_factor(done: float, warm_up: float) -> float:
    if done < warm_up:
        return max(done / warm_up, 0.02)
    return 0.5 + 0.5 * math.cos(math.pi * (done - warm_up) / (1.0 - warm_up))
