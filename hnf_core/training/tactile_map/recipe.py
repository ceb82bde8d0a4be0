"""How weights of D_φ come about: pairs on disk → training → a file with its own figures in it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...datasets.tactile_pairs import HELD_OUT_CLASSES, HELD_OUT_INSTANCES, TRAIN, load_pairs
from ...tactile.diffusion.config import DIFFUSION, REGRESSION, MapConfig
from ...tactile.diffusion.weights import save_map_weights
from .fit import FitResult, MapTrainingPlan, ProgressCallback, fit_map

LICENCE = "GPL-3.0-or-later"
LEARNING_RATES = {DIFFUSION: 1e-3, REGRESSION: 2e-3}
"""Of learning, by objective."""


def train_map(
    folder: Path,
    plan: MapTrainingPlan,
    config: MapConfig,
    out: Path,
    checkpoint: Path,
    watch: ProgressCallback,
    *,
    partial: bool = False,
) -> dict[str, Any]:
    """Train on the pairs in a folder (tools/make_tactile_pairs.py), write the averaged weights, return the record that
    is also in their header. A killed run goes on from its checkpoint. partial: train on what shards there are.

    Raises FileError where pairs are missing or damaged, UsageError for a plan without a budget.
    """
    pairs = load_pairs(folder, TRAIN, partial=partial)
    held_out = {name: load_pairs(folder, name, partial=partial) for name in (HELD_OUT_INSTANCES, HELD_OUT_CLASSES)}
    fitted = fit_map(pairs, held_out, plan, config, checkpoint, watch)
    record = {
        "training_data": f"{len(pairs)} paired views of {pairs.tiles} generated tiles of "
        f"{len(set(pairs.class_name) - {''})} classes and of random surfaces; no recorded data",
        "objective": config.objective,
        "seed": plan.seed,
        "steps": fitted.steps,
        "views": fitted.steps * plan.batch,
        "minutes": round(fitted.seconds / 60.0, 1),
        "metrics": {name: asdict(distance) for name, distance in fitted.distances.items()},
        "licence": LICENCE,
    }
    save_map_weights(out, fitted.config, fitted.parameters, _to_text(record))
    return {**record, "weights": str(out), "in_words": _format_distances(fitted)}


def _to_text(record: dict[str, Any]) -> dict[str, str]:
    return {
        name: value if isinstance(value, str) else json.dumps(value, sort_keys=True) for name, value in record.items()
    }


def _format_distances(fitted: FitResult) -> str:
    return "; ".join(f"{name}: {distance.describe()}" for name, distance in fitted.distances.items())
