"""`hnf train tactile-map`: D_φ, which predicts tactile maps from colour and depth, from paired views."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ..tactile.diffusion.config import DIFFUSION, REGRESSION, MapConfig
from .progress import Progress, ProgressBar
from .train_needs import check_seed_and_weights, require_torch

if TYPE_CHECKING:
    from ..training.tactile_map.validate import Distance

SIMULATED_PAIRS = "simulated"
DEFAULT_MINUTES = 60.0


def _add_tactile_map(subjects: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = subjects.add_parser(
        "tactile-map",
        help="the network that predicts tactile maps from a look",
        description="Train D_φ (colour and depth → tactile map) on paired views and write its weights. A killed run "
        "resumes where it was when the same command is given again. Needs the extra [train].",
    )
    parser.add_argument(
        "--data", required=True, metavar="DIR",
        help="folder of pairs (tools/make_tactile_pairs.py), or simulated: they are made first, beside FILE",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights to write (.safetensors)")
    parser.add_argument(
        "--minutes", type=float, default=DEFAULT_MINUTES, metavar="M", help=f"to train (default {DEFAULT_MINUTES:g})"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of batches, noise and initial weights")
    parser.add_argument(
        "--objective", choices=(REGRESSION, DIFFUSION), default=REGRESSION,
        help=f"{REGRESSION} (default; shipped): least squares, one pass; {DIFFUSION}: maps sampled from noise in steps",
    )  # fmt: skip
    parser.add_argument("--fresh", action="store_true", help="start anew even where a killed run could go on")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.set_defaults(run=_run_tactile_map)
    return parser


def _run_tactile_map(arguments: argparse.Namespace) -> int:
    """Raises HnfError; returns the exit code."""
    check_seed_and_weights(arguments)
    if not arguments.minutes > 0.0:
        raise UsageError("--minutes must be more than 0.")
    checkpoint = arguments.out.with_name(f"{arguments.out.name}.checkpoint")
    if arguments.fresh:
        checkpoint.unlink(missing_ok=True)
    record = _train_tactile_map(arguments, checkpoint)
    checkpoint.unlink(missing_ok=True)
    words = record.pop("in_words")
    text = f"{record['weights']}: {record['training_data']}; {record['views']} views seen; {words}"
    print(json.dumps(record, indent=1) if arguments.json else text)
    return 0


def _train_tactile_map(arguments: argparse.Namespace, checkpoint: Path) -> dict[str, Any]:
    with require_torch("training"):
        from ..training.tactile_map.fit import MapTrainingPlan
        from ..training.tactile_map.recipe import LEARNING_RATES, train_map

    bar = ProgressBar()

    def watch(step: int, spent: float, loss: float, distances: Mapping[str, Distance]) -> None:
        bar.show(Progress(f"% loss {loss:.4f}", int(100 * spent), 100))
        for name, distance in distances.items():
            print(f"hnf: {step} steps, {name}: {distance.describe()}", file=sys.stderr)

    try:
        folder = _find_pairs(arguments, bar)
        plan = MapTrainingPlan(minutes=arguments.minutes, seed=arguments.seed, rate=LEARNING_RATES[arguments.objective])
        config = MapConfig(objective=arguments.objective)
        return train_map(folder, plan, config, arguments.out, checkpoint, watch)
    finally:
        bar.close()


def _find_pairs(arguments: argparse.Namespace, bar: ProgressBar) -> Path:
    if arguments.data != SIMULATED_PAIRS:
        return Path(arguments.data)
    from ..datasets.pair_shards import write_pairs
    from ..datasets.pair_tiles import PairSizes

    folder = arguments.out.with_name(f"{arguments.out.stem}-pairs")
    write_pairs(
        folder, PairSizes(), arguments.seed, on_progress=lambda done, total: bar.show(Progress("shards", done, total))
    )
    return Path(folder)
