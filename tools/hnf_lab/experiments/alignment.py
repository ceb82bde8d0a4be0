"""Train and evaluate the encoders of docs/alignment.md: on GelSight tuples, on DIGIT tuples, and on both.

  Usage: python -m hnf_lab.experiments.alignment (--minutes N | --steps N) [--pixels N] [--batch N] [--rate R]
         [--data DIR] [--out DIR] [--record FILE]

Needs the extra "train" and the pairs of tools/make_tactile_pairs.py. Each single sensor gets a quarter of the steps or
minutes and both together get half, so that each training uses a sensor's tuples equally often. Finished parts are not
repeated. Weights stay in the folder; the record, with their checksums, is committed.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from hnf_core.errors import FileError
from hnf_core.files import write_text
from hnf_lab import ROOT

from ..alignment.inputs import (
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
from ..alignment.train import AlignedEncoders, Recipe, fit_encoders, load_encoders, save_encoders, set_torch_threads
from ..cli.train_alignment import CHECKPOINT

BUDGET_SHARES = {"gelsight": 0.25, "digit": 0.25, "both": 0.5}
"""Fraction of the steps or the time for each training."""


def load_or_train(folder: Path, sensor: str, training: Tuples, recipe: Recipe, threads: int) -> AlignedEncoders:
    """Load the encoders from the folder, or train them."""
    try:
        return load_encoders(folder)
    except FileError:
        pass
    tuples = training if sensor == "both" else training.select_sensor(sensor)
    version = set_torch_threads(threads)

    def watch(progress: float, loss: float) -> None:
        print(f"\r{sensor}: {100 * progress:.1f} %, loss {loss:.3f}", end="", file=sys.stderr, flush=True)

    fitted = fit_encoders(tuples, recipe, folder / CHECKPOINT, watch)
    print(file=sys.stderr)
    details = {"sensor": sensor, "tuples": len(tuples), "threads": threads, "trunk": None, "torch": version}
    save_encoders(folder, fitted, recipe, details)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return load_encoders(folder)


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
    parser.add_argument("--pixels", type=int, default=Recipe.pixels)
    parser.add_argument("--batch", type=int, default=Recipe.batch)
    parser.add_argument("--rate", type=float, default=Recipe.rate)
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
    models = []
    for sensor, fraction in BUDGET_SHARES.items():
        if arguments.only in (None, sensor):
            recipe = Recipe(
                pixels=arguments.pixels, batch=arguments.batch, chunk=arguments.batch, rate=arguments.rate,
                minutes=None if arguments.minutes is None else fraction * arguments.minutes,
                steps=None if arguments.steps is None else round(fraction * arguments.steps), seed=arguments.seed,
            )  # fmt: skip
            models.append(load_or_train(arguments.out / sensor, sensor, training, recipe, arguments.threads))
    if arguments.only is not None:
        return 0
    held_out = source.load_held_out()
    results = [
        load_or_measure(arguments.out / encoders.sensor / "measured.json", encoders, training, held_out, arguments.seed)
        for encoders in models
    ]
    report = make_report(results, compute_chance_levels(held_out))
    record = {**report.to_json(), "models": [dict(encoders.record) for encoders in models]}
    write_text(arguments.record, json.dumps(record, indent=1) + "\n")
    print(format_report(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
