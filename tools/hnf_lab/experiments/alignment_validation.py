"""Compare recipes of the alignment on pieces held out of its training data; the test pieces are not read.

  Usage: python -m hnf_lab.experiments.alignment_validation --steps N [N …] [--seeds N] [--hidden N] [--dropout P]
         [--batch N] [--tiles N] [--data DIR] [--out DIR]

Of each compared class two in eight pieces are held out, one of each sensor. Probes and search are those of
`hnf eval alignment`. The statistics of varied tuples are kept, and shared with `hnf_lab.experiments.alignment`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, TRAIN, load_pairs
from hnf_core.errors import UsageError
from hnf_lab import ROOT

from ..alignment.encoders import Batch, HeadArchitecture
from ..alignment.inputs import COMPARED_CLASSES, HeldOutTuples, Tuples, make_training_tuples
from ..alignment.linear_probes import IMAGES, TOUCH, VISION
from ..alignment.results import Measurement, measure_encoders
from ..alignment.train import STATISTICS_RECIPE, AlignedEncoders, Recipe, fit_encoders, set_torch_threads
from .alignment import StatisticsCache

HELD_OUT_PERIOD = 8
"""Number of consecutive pieces of a class of which the first two are held out."""


@dataclass(frozen=True)
class Split:
    """Tuples to train on, their rows among all, and held-out tuples."""

    training: Tuples
    rows: NDArray[np.int64]
    held_out: HeldOutTuples


def split_tuples(tuples: Tuples) -> Split:
    """Hold out the labelled tuples of two pieces in eight of every class, under both sensors."""
    _, first, piece = np.unique(tuples.group, return_index=True, return_inverse=True)
    is_held_out = np.zeros(len(first), dtype=bool)
    for label in range(len(tuples.classes)):
        pieces = np.flatnonzero(tuples.label[first] == label)
        is_held_out[pieces[np.arange(len(pieces)) % HELD_OUT_PERIOD < len(PAIR_SENSORS)]] = True
    held_out = tuples.select(is_held_out[piece])
    if not len(held_out):
        raise UsageError("no piece has a label.", remedy="Take pairs of the compared classes.")
    rows = np.flatnonzero(~is_held_out[piece])
    known = {name: replace(held_out, sensor=np.full(len(held_out), index)) for index, name in enumerate(PAIR_SENSORS)}
    disjoint = {name: held_out.sensor == index for index, name in enumerate(PAIR_SENSORS)}
    return Split(tuples.select(rows), rows, HeldOutTuples(known, {}, disjoint))


def validate_recipe(split: Split, recipe: Recipe, cache: StatisticsCache) -> Measurement:
    """Train on the training tuples of a split and measure on those held out."""
    rows = torch.from_numpy(split.rows)

    def get_look(number: int) -> Batch:
        look = cache.get_look(number)
        return Batch(look.vision[rows], look.touch[rows])

    fitted = fit_encoders(split.training, recipe, get_look=get_look)
    models = AlignedEncoders(fitted.vision, fitted.touch, recipe.pixels, {"sensor": "both"})
    return measure_encoders(models, split.training, split.held_out)


def summarise(measured: Measurement) -> list[float]:
    """Return in % the accuracy of looks and of both touches, mean recall among ten by sensor, and bridging."""
    probes = [(VISION, IMAGES), *((TOUCH, name) for name in PAIR_SENSORS)]
    accuracies = [float(measured.known[cell].correct.mean()) for cell in probes]
    recalls = [float(np.mean([way[10] for way in measured.recall[name].values()])) for name in PAIR_SENSORS]
    bridged = float("nan") if measured.bridged is None else measured.bridged.of_class
    return [100.0 * value for value in (*accuracies, *recalls, bridged)]


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, nargs="+", required=True)
    parser.add_argument("--seeds", type=int, default=2, help="trainings of each, of seeds 0, 1, …")
    parser.add_argument("--hidden", type=int, default=HeadArchitecture.hidden)
    parser.add_argument("--dropout", type=float, default=HeadArchitecture.dropout)
    parser.add_argument("--batch", type=int, default=STATISTICS_RECIPE["batch"])
    parser.add_argument("--tiles", type=int, help="take the first N training tiles")
    parser.add_argument("--data", type=Path, default=ROOT / "build" / "tactile-pairs")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "alignment", help="folder of the statistics")
    arguments = parser.parse_args(words)
    set_torch_threads(1)
    pairs = load_pairs(arguments.data, TRAIN, partial=arguments.tiles is not None)
    tuples = make_training_tuples(pairs, COMPARED_CLASSES)
    folder = arguments.out
    if arguments.tiles is not None:
        tuples = tuples.select(pairs.tile_index[tuples.row] < arguments.tiles)
        folder = folder / f"tiles-{arguments.tiles}"
    split, cache = split_tuples(tuples), StatisticsCache(folder, tuples, 0)
    gallery = len(split.held_out.known[PAIR_SENSORS[0]])
    print(f"{len(split.training)} tuples to train on, {gallery} views held out\n")
    print("| steps | seed | looks % | GelSight % | DIGIT % | found GelSight % | found DIGIT % | bridged % |")
    print("|---|---|---|---|---|---|---|---|")
    architecture = HeadArchitecture(arguments.hidden, arguments.dropout)
    for steps in arguments.steps:
        for seed in range(arguments.seeds):
            settings = {"batch": arguments.batch, "chunk": arguments.batch, "architecture": architecture}
            recipe = Recipe(steps=steps, seed=seed, **{**STATISTICS_RECIPE, **settings})
            values = summarise(validate_recipe(split, recipe, cache))
            print(f"| {steps} | {seed} | {' | '.join(f'{value:.1f}' for value in values)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
