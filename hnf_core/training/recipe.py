"""How the shipped weights come about: simulated strokes on library and random surfaces, fitted by likelihood."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ..action.smooth import steady_action
from ..field.field import Field, FieldConfig
from ..field.ranges import Ranges, ranges_of
from .conditions import Steady, speed_grid, steady_strokes
from .fit import DENSITY_FLOOR, Likelihood, Schedule, TrainingSet, fit, training_set
from .model import FieldNetwork
from .recordings import FINE_BINS, bin_widths, record
from .surfaces import library_surfaces, random_surfaces

Float = NDArray[np.float64]

LICENCE = "GPL-3.0-or-later"


@dataclass(frozen=True)
class Plan:
    """Sizes of the training run. random, held_out: surfaces (held out ones are never trained on). draws: tiles per
    library material. strokes: per random surface; library_strokes: per library tile, middle_share of
    them where strokes mostly are. seconds: of each stroke."""

    random: int = 210
    held_out: int = 30
    draws: int = 2
    strokes: int = 20
    library_strokes: int = 50
    middle_share: float = 0.6
    seconds: float = 0.3
    variants: int = 4
    schedule: Schedule = field(default_factory=Schedule)


@dataclass(frozen=True)
class Fit:
    """distance_db: median over strokes of the RMS distance between expected and recorded spectrum, bins 1–100.
    bias_db: median error of total power. spread_db: half the 10–90 % range of it."""

    distance_db: float
    bias_db: float
    spread_db: float


def train(library: Path, plan: Plan, config: FieldConfig, seed: int, workers: int = 2) -> Field:
    """The whole recipe. Deterministic: the same seed gives the same weights on the same machine and torch."""
    torch.set_num_threads(1)
    began = time.monotonic()
    surfaces = library_surfaces(library, plan.draws, workers)
    own = len(surfaces)
    surfaces += random_surfaces(plan.random + plan.held_out, seed, workers)
    print(f"{len(surfaces)} surfaces after {time.monotonic() - began:.0f} s", file=sys.stderr)
    strokes = steady_strokes(surfaces[:own], plan.library_strokes, seed + 1, middle_share=plan.middle_share)
    strokes += [
        replace(stroke, surface=stroke.surface + own)
        for stroke in steady_strokes(surfaces[own:], plan.strokes, seed + 2)
    ]
    power = record(surfaces, strokes, plan.seconds, workers)
    tokens = np.stack([surface.token for surface in surfaces])
    data = training_set(config, strokes, tokens, power, plan.variants, seed)
    test = np.array([stroke.surface >= own + plan.random for stroke in strokes])
    network = fit(config, select(data, ~test), plan.schedule, seed)
    fits = {
        "held-out, mechanics known": evaluate_fit(network, select(data, test), 0),
        "held-out, some unknown": evaluate_fit(network, select(data, test), 1),
        "library": evaluate_fit(network, select(data, np.array([stroke.surface < own for stroke in strokes])), 0),
    }
    metrics = "; ".join(
        f"{name}: spectrum {each.distance_db:.2f} dB, power {each.bias_db:+.2f} ± {each.spread_db:.2f} dB"
        for name, each in fits.items()
    )
    print(metrics, file=sys.stderr)
    print(f"trained in {time.monotonic() - began:.0f} s", file=sys.stderr)
    return Field(
        config, network.parameters_numpy(),
        _ranges([stroke for stroke, held in zip(strokes, test, strict=True) if not held], tokens),
        {
            "training_data": f"contact simulator of this project: {own} library tiles, {plan.random} random and fused "
            f"surfaces, {int((~test).sum())} steady strokes of {plan.seconds:g} s, pen and finger; no recorded data",
            "seed": str(seed),
            "metrics": metrics,
            "licence": LICENCE,
        },
    )  # fmt: skip


def select(data: TrainingSet, rows: NDArray[np.bool_]) -> TrainingSet:
    index = torch.tensor(np.flatnonzero(rows))
    return TrainingSet(data.x[:, index], data.prior[:, index], data.gate[index], data.speed[index], data.power[index])


def evaluate_fit(network: FieldNetwork, data: TrainingSet, variant: int) -> Fit:
    """Against single recordings of each stroke: their own scatter (some 1.5–2 dB) is inside distance_db."""
    with torch.no_grad():
        amplitude = network.steady_amplitude(data.x[variant], data.prior[variant], data.gate)
        expected = Likelihood(network.config).expected(amplitude, data.speed).numpy().astype(np.float64)
    recorded = data.power.numpy().astype(np.float64) + DENSITY_FLOOR
    width = bin_widths()
    level = 10.0 * np.log10(expected / recorded)[:, :FINE_BINS]
    total = 10.0 * np.log10((expected @ width) / (recorded @ width))
    low, high = np.percentile(total, [10, 90])
    return Fit(
        float(np.median(np.sqrt(np.mean(np.square(level), axis=1)))), float(np.median(total)), float(high - low) / 2.0
    )


def _ranges(strokes: Sequence[Steady], tokens: NDArray[np.float32]) -> Ranges:
    grid = speed_grid()
    actions = [steady_action(0.0, float(grid[each.speed]), each.force, each.angle, each.probe) for each in strokes]
    trained = tokens[sorted({each.surface for each in strokes})]
    return ranges_of(actions, trained, [each.mechanics for each in strokes], withheld=True)
