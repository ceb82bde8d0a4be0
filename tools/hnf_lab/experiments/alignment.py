"""Train and evaluate the encoders of docs/alignment.md: on GelSight tuples, on DIGIT tuples, and on both.

  Usage: python -m hnf_lab.experiments.alignment (--minutes N | --steps N) [--encoder statistics|resnet50]
         [--pixels N] [--batch N] [--rate R] [--data DIR] [--out DIR] [--record FILE]

Needs the extra "train" and the pairs of tools/make_tactile_pairs.py. Each single sensor gets a quarter of the steps or
minutes and both together get half, so that each training uses a sensor's tuples equally often. Finished parts, and the
statistics of varied tuples, are not computed again. Weights stay in the folder; the record, with their checksums, is
committed. Probes and search are of the 31 classes of `COMPARED_CLASSES`; the encoders train on all, without labels.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS
from hnf_core.errors import FileError
from hnf_core.files import content_hash, write_bytes, write_text
from hnf_core.material.shared_space import STATISTICS_COUNT
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_lab import ROOT

from ..alignment.encoders import Batch, compute_varied_statistics
from ..alignment.inputs import (
    COMPARED_CLASSES,
    GeneratedSource,
    HeldOutTuples,
    Tuples,
)
from ..alignment.results import (
    Measurement,
    compute_chance_levels,
    format_report,
    load_measurement,
    make_report,
    measure_encoders,
    save_measurement,
)
from ..alignment.train import (
    SPACE_FILE,
    AlignedEncoders,
    Recipe,
    fit_encoders,
    load_encoders,
    save_encoders,
    save_shared_space,
    set_torch_threads,
)
from ..cli.train_alignment import CHECKPOINT, make_recipe

BUDGET_SHARES = {"gelsight": 0.25, "digit": 0.25, "both": 0.5}
"""Fraction of the steps or the time for each training."""


class StatisticsCache:
    """Statistics of the variations of all training tuples, kept as files `statistics-N.safetensors` in a folder."""

    def __init__(self, folder: Path, tuples: Tuples, seed: int) -> None:
        self.folder, self.tuples, self.seed = folder, tuples, seed
        self.key = content_hash(tuples.row.tobytes(), tuples.sensor.tobytes(), str(seed), str(STATISTICS_COUNT))

    @lru_cache  # noqa: B019
    def get_look(self, number: int) -> Batch:
        """Return one variation of all tuples."""
        path = self.folder / f"statistics-{number}.safetensors"
        if path.is_file():
            tensors, metadata = load_tensors(path.read_bytes())
            if metadata.get("key") == self.key:
                return Batch(*(torch.from_numpy(np.array(tensors[name])) for name in ("vision", "touch")))
        look = compute_varied_statistics(self.tuples, self.seed, number)
        tensors = {"vision": look.vision.numpy(), "touch": look.touch.numpy()}
        write_bytes(path, dump_tensors(tensors, {"key": self.key}))
        return look

    def select_sensor(self, sensor: str) -> Callable[[int], Batch]:
        """Return a function from a variation's number to the tuples of one sensor, or of both."""
        if sensor == "both":
            return self.get_look
        rows = torch.from_numpy(np.flatnonzero(self.tuples.sensor == PAIR_SENSORS.index(sensor)))

        def get_rows(number: int) -> Batch:
            look = self.get_look(number)
            return Batch(look.vision[rows], look.touch[rows])

        return get_rows


def load_or_train(
    folder: Path, sensor: str, training: Tuples, recipe: Recipe, threads: int, cache: StatisticsCache
) -> AlignedEncoders:
    """Load the encoders from the folder, or train them and write their space."""
    try:
        return load_encoders(folder)
    except FileError:
        pass
    tuples = training if sensor == "both" else training.select_sensor(sensor)
    version = set_torch_threads(threads)

    def watch(progress: float, loss: float) -> None:
        print(f"\r{sensor}: {100 * progress:.1f} %, loss {loss:.3f}", end="", file=sys.stderr, flush=True)

    fitted = fit_encoders(tuples, recipe, folder / CHECKPOINT, watch, get_look=cache.select_sensor(sensor))
    print(file=sys.stderr)
    details = {"sensor": sensor, "tuples": len(tuples), "threads": threads, "trunk": None, "torch": version}
    save_encoders(folder, fitted, recipe, details)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    encoders = load_encoders(folder)
    save_shared_space(folder / SPACE_FILE, encoders, training)
    return encoders


def load_or_measure(
    path: Path, models: AlignedEncoders, training: Tuples, held_out: HeldOutTuples, seed: int
) -> Measurement:
    """Load the evaluation of these weights, or measure and store it."""
    measurement = load_measurement(path, models.record["sha256"])
    if measurement is None:
        measurement = measure_encoders(models, training, held_out, seed)
        save_measurement(path, measurement, models.record["sha256"])
    return measurement


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, help="of all three trainings together")
    parser.add_argument(
        "--steps", type=int, help="of all three trainings together; equal seeds then give equal weights"
    )
    parser.add_argument("--encoder", choices=["statistics", "resnet50"])
    parser.add_argument("--pixels", type=int)
    parser.add_argument("--batch", type=int)
    parser.add_argument("--rate", type=float)
    parser.set_defaults(chunk=None)
    parser.add_argument("--only", choices=sorted(BUDGET_SHARES), help="train this one and judge nothing")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--data", type=Path, default=ROOT / "build" / "tactile-pairs")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "alignment")
    parser.add_argument("--record", type=Path, default=ROOT / "docs" / "alignment.json")
    arguments = parser.parse_args()
    set_torch_threads(arguments.threads)
    source = GeneratedSource(arguments.data)
    training = source.load_training()
    models, cache = [], StatisticsCache(arguments.out, training, arguments.seed)
    for sensor, fraction in BUDGET_SHARES.items():
        if arguments.only in (None, sensor):
            whole = make_recipe(arguments)
            recipe = replace(
                whole,
                minutes=None if whole.minutes is None else fraction * whole.minutes,
                steps=None if whole.steps is None else round(fraction * whole.steps),
            )
            folder = arguments.out / sensor
            models.append(load_or_train(folder, sensor, training, recipe, arguments.threads, cache))
    if arguments.only is not None:
        return 0
    labelled = GeneratedSource(arguments.data, COMPARED_CLASSES)
    held_out, tuples = labelled.load_held_out(), labelled.load_training()
    results = [
        load_or_measure(arguments.out / encoders.sensor / "measured.json", encoders, tuples, held_out, arguments.seed)
        for encoders in models
    ]
    report = make_report(results, compute_chance_levels(held_out))
    record = {**report.to_json(), "models": [dict(encoders.record) for encoders in models]}
    write_text(arguments.record, json.dumps(record, indent=1) + "\n")
    print(format_report(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
