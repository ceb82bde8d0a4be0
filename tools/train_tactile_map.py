"""Train weights of D_φ on generated pairs; those shipped are hnf_core/data/tactile-map.safetensors.

Usage: python tools/train_tactile_map.py [--objective O] [--minutes M | --steps N] [--data DIR] [--out FILE] [--seed N]
Needs the extra "train" and the pairs of tools/make_tactile_pairs.py. One core; a killed run goes on where it was.
Objectives: regression (default; shipped), least squares in one pass, and diffusion, the same network sampled in steps.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from hnf_core.datasets.recorded_pairs import load_recorded_pairs
from hnf_core.datasets.tactile_pairs import HELD_OUT_CLASSES, concatenate_pairs, load_pairs
from hnf_core.material.fuse import compute_library_spread
from hnf_core.material.token import TOKEN_NAMES
from hnf_core.tactile.unet import DIFFUSION, REGRESSION, MapConfig
from hnf_core.training.train_map import LEARNING_RATES, Distance, MapTrainingPlan, train_map, write_token_error

BUILD = ROOT / "build"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=BUILD / "tactile-pairs", help="folder of the pairs")
    parser.add_argument("--out", type=Path, help="default: build/tactile-map/OBJECTIVE.safetensors")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--steps", type=int, help="at most so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rate", type=float, help=f"of learning; default by objective: {LEARNING_RATES}")
    parser.add_argument("--batch", type=int, default=MapTrainingPlan().batch)
    parser.add_argument("--objective", choices=(REGRESSION, DIFFUSION), default=REGRESSION)
    parser.add_argument("--start", type=Path, metavar="FILE", help="weights to go on from; they keep their objective")
    parser.add_argument("--partial", action="store_true", help="train on what shards are there")
    parser.add_argument(
        "--measure", type=Path, metavar="FILE",
        help="train nothing: measure how far off these weights are on held-out classes of --data and on --recorded, "
        "and write them with these errors to --out",
    )  # fmt: skip
    parser.add_argument("--recorded", nargs=2, metavar=("KIND", "DIR"), help="recorded pairs that they never met")
    parser.add_argument("--tiles", type=int, default=72, help="tiles to measure on (default 72)")
    arguments = parser.parse_args()
    if arguments.measure is not None:
        return measure(arguments)
    objective = arguments.objective
    out = arguments.out or BUILD / "tactile-map" / f"{objective}.safetensors"
    rate = LEARNING_RATES[objective] if arguments.rate is None else arguments.rate
    plan = MapTrainingPlan(steps=arguments.steps, minutes=arguments.minutes, seed=arguments.seed,
    threads=arguments.threads,
                rate=rate, batch=arguments.batch)  # fmt: skip
    started = time.monotonic()

    def report_progress(step: int, spent: float, loss: float, distances: Mapping[str, Distance]) -> None:
        if step % 100 == 0 or distances:
            words = "; ".join(f"{name} {distance.describe()}" for name, distance in distances.items())
            seconds = time.monotonic() - started
            print(f"{seconds:6.0f} s  step {step}, {spent:.1%}, loss {loss:.4f}  {words}", file=sys.stderr, flush=True)

    checkpoint = out.with_name(f"{out.name}.checkpoint")
    record = train_map(
        arguments.data,
        plan,
        MapConfig(objective=objective),
        out,
        checkpoint,
        report_progress,
        partial=arguments.partial,
        start=arguments.start,
    )
    print(json.dumps(record, indent=1))
    return 0


def measure(arguments: argparse.Namespace) -> int:
    """Write weights with the errors that they have on data they never met."""
    data = [load_pairs(arguments.data, HELD_OUT_CLASSES, partial=arguments.partial)]
    if arguments.recorded is not None:
        data.append(
            concatenate_pairs(list(load_recorded_pairs(arguments.recorded[0], Path(arguments.recorded[1]))[:2]))
        )
    error = write_token_error(
        arguments.measure, arguments.out or arguments.measure, data, arguments.tiles, arguments.seed
    )
    share = np.maximum(0.0, 1.0 - np.square(error) / compute_library_spread()[1])
    rows = zip(TOKEN_NAMES, error, share, strict=True)
    print(json.dumps({name: [round(float(off), 3), round(float(told), 2)] for name, off, told in rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
