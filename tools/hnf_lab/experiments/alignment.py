"""Train the encoders of docs/alignment.md and judge them: on GelSight tuples, on DIGIT tuples, on both.

Usage: python -m hnf_lab.experiments.alignment (--minutes N | --steps N) [--pixels N] [--batch N] [--rate R]
       [--data DIR] [--out DIR] [--record FILE]
Needs the extra "train" and the pairs of tools/make_tactile_pairs.py. Of the steps or minutes each sensor's training
takes a quarter and that on both takes half, so that each sees a sensor's tuples equally often. What is finished is not
done again. Weights stay in the folder; the record, with their checksums, is committed.
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
"""Of the steps or the time."""


def load_or_train(folder: Path, sensor: str, training: Tuples, recipe: Recipe, threads: int) -> AlignedEncoders:
    """The encoders in the folder, trained now where they are not there yet."""
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
    told = {"sensor": sensor, "tuples": len(tuples), "threads": threads, "trunk": None, "torch": version}
    save_encoders(folder, fitted, recipe, told)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return load_encoders(folder)


def load_or_measure(
    path: Path, models: AlignedEncoders, training: Tuples, held_out: HeldOutTuples, seed: int
) -> Measurement:
    """What these weights are worth, measured now where it is not there yet."""
    found = load_measurement(path, models.record["sha256"])
    if found is None:
        found = measure_encoders(models, training, held_out, seed)
        save_measurement(path, found, models.record["sha256"])
    return found


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
    learn = source.load_training()
    models = []
    for sensor, part in BUDGET_SHARES.items():
        if arguments.only in (None, sensor):
            recipe = Recipe(
                pixels=arguments.pixels, batch=arguments.batch, chunk=arguments.batch, rate=arguments.rate,
                minutes=None if arguments.minutes is None else part * arguments.minutes,
                steps=None if arguments.steps is None else round(part * arguments.steps), seed=arguments.seed,
            )  # fmt: skip
            models.append(load_or_train(arguments.out / sensor, sensor, learn, recipe, arguments.threads))
    if arguments.only is not None:
        return 0
    judged = source.load_held_out()
    results = [
        load_or_measure(arguments.out / each.sensor / "measured.json", each, learn, judged, arguments.seed)
        for each in models
    ]
    told = make_report(results, compute_chance_levels(judged))
    record = {**told.to_json(), "models": [dict(each.record) for each in models]}
    write_text(arguments.record, json.dumps(record, indent=1) + "\n")
    print(format_report(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
