"""`hnf train alignment`: train two encoders that embed appearance and touch in one space."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hnf_core.cli.commands import require_torch
from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

if TYPE_CHECKING:
    from ..alignment.train import Recipe

PAIRS = "build/tactile-pairs"
CHECKPOINT = "checkpoint"


def add_parser(subjects: Any) -> None:
    parser = subjects.add_parser(
        "alignment",
        help="one space for looks and the touch of two sensors",
        description="Train two encoders, of looks and of touch, by contrast (docs/alignment.md), and write "
        "vision.safetensors, touch.safetensors and alignment.json, and space.safetensors for `hnf describe --space`. "
        "A killed run resumes where it was when the same "
        "command is given again.",
    )
    add_data_option(parser)
    parser.add_argument("--sensor", choices=["gelsight", "digit", "both"], default="both", help="whose tuples")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into")
    parser.add_argument(
        "--encoder", choices=["statistics", "resnet50"],
        help="small heads on texture statistics (default), or the paper's networks, which take hours (with --trunk)",
    )  # fmt: skip
    parser.add_argument("--minutes", type=float, metavar="N", help="of training; the learning rate follows the clock")
    parser.add_argument("--steps", type=int, metavar="N", help="of training; equal seeds then give equal weights")
    parser.add_argument("--pixels", type=int, metavar="N", help="side of what is cut out of a view (32 to 64)")
    parser.add_argument("--batch", type=int, metavar="N", help="tuples that are told apart")
    parser.add_argument("--chunk", type=int, metavar="N", help="of them in memory at once, by cached gradients")
    parser.add_argument("--rate", type=float, metavar="R", help="highest learning rate")
    parser.add_argument("--trunk", type=Path, metavar="FILE", help="resnet50 to start from (.safetensors)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of weights, batches, lamps and cuts")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of torch (default 1)")
    parser.add_argument("--fresh", action="store_true", help="start anew even where a killed run could go on")
    parser.add_argument("--json", action="store_true", help="print the record as one JSON object")
    parser.set_defaults(run=run)


def add_data_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the data to train and test on."""
    parser.add_argument(
        "--data", nargs="+", action="append", metavar="WORD",
        help=f"folder of generated pairs (default {PAIRS}); or tarf DIR, touch-and-go DIR, hatt PHOTOGRAPHS TOUCH: "
        "your copies, several with one --data each",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if arguments.seed < 0 or arguments.threads < 1 or not (arguments.minutes is None or arguments.minutes > 0.0):
        raise UsageError("--seed must be at least 0, --threads 1, and --minutes more than none.")
    version = prepare_torch(arguments.threads)
    from ..alignment.inputs import open_source
    from ..alignment.train import SPACE_FILE, fit_encoders, load_encoders, save_encoders, save_shared_space
    from ..encoder.network import read_state_dict

    if arguments.trunk is not None:
        if arguments.encoder == "statistics":
            raise UsageError("--trunk is a ResNet-50's.", remedy="Give --encoder resnet50.")
        arguments.encoder = "resnet50"
    recipe = make_recipe(arguments)
    start = None
    if arguments.trunk is not None:
        start, _ = read_state_dict(arguments.trunk, "resnet50")
    source = open_source(arguments.data or [[PAIRS]])
    tuples = source.load_training()
    if arguments.sensor != "both":
        tuples = tuples.select_sensor(arguments.sensor)
    checkpoint = arguments.out / CHECKPOINT
    if arguments.fresh:
        checkpoint.unlink(missing_ok=True)
    bar = ProgressBar()

    def watch(progress: float, loss: float) -> None:
        bar.show(Progress(f"% of training, loss {loss:.3f}", round(100 * progress), 100))

    try:
        fitted = fit_encoders(tuples, recipe, checkpoint, watch, start)
    finally:
        bar.close()
    details = {
        "sensor": arguments.sensor, "tuples": len(tuples), "data": list(source.messages), "threads": arguments.threads,
        "trunk": None if arguments.trunk is None else arguments.trunk.name, "torch": version,
    }  # fmt: skip
    record = save_encoders(arguments.out, fitted, recipe, details)
    checkpoint.unlink(missing_ok=True)
    save_shared_space(arguments.out / SPACE_FILE, load_encoders(arguments.out), tuples, arguments.seed)
    print(json.dumps(record, indent=1) if arguments.json else _format_record(arguments.out, record))
    return 0


def prepare_torch(threads: int) -> str:
    """Set torch's number of threads and return its version. Raises HnfError if torch is missing."""
    with require_torch("alignment"):
        from ..alignment.train import set_torch_threads
    return set_torch_threads(threads)


def make_recipe(arguments: argparse.Namespace) -> Recipe:
    """Return the recipe that the command's options describe."""
    from ..alignment.train import STATISTICS_RECIPE, Recipe

    given = {name: getattr(arguments, name) for name in ("pixels", "batch", "chunk", "rate", "minutes", "steps")}
    if given["batch"] is not None and given["chunk"] is None:
        given["chunk"] = given["batch"]
    usual = {} if arguments.encoder == "resnet50" else STATISTICS_RECIPE
    if usual and (arguments.pixels, arguments.chunk) != (None, None):
        raise UsageError(
            "--pixels and --chunk are a ResNet-50's.", remedy="Give --encoder resnet50, or leave them out."
        )
    chosen = {name: value for name, value in given.items() if value is not None}
    return Recipe(seed=arguments.seed, **{**usual, **chosen})


def _format_record(folder: Path, record: Any) -> str:
    loss = record["curve"][-1][2] if record["curve"] else float("nan")
    return (
        f"{folder}: {record['sensor']}, {record['tuples']} tuples, {record['steps']} steps in {record['seconds']:.0f} "
        f"s, loss {loss:.3f}. Judge it: hnf eval alignment --models {folder}"
    )
