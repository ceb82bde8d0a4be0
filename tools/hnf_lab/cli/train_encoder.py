"""`hnf train encoder`: train E on generated pairs, or only its head on the user's backbone."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from hnf_core.cli.commands import check_weights_name, parse_seed, require_torch
from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

PERCENT = 100


def add_parser(subjects: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = subjects.add_parser(
        "encoder",
        help="the network that turns views of a touch sensor into tokens",
        description="Train AlexNet's trunk and a head on pairs written by tools/make_tactile_pairs.py, or with --trunk "
        "the head alone on a trunk of yours (torchvision's alexnet, .safetensors). Use the result with "
        "--encoder FILE. Needs the extra [train].",
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="folder of the pairs")
    parser.add_argument("--trunk", type=Path, metavar="FILE", help="convolutions to take as they are")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights to write (.safetensors)")
    parser.add_argument("--steps", type=int, metavar="N", help="batches of 64 views (default 12000; with --trunk 3000)")
    parser.add_argument("--minutes", type=float, metavar="M", help="stop after so long, if that is sooner")
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of weights, lamps and noise")
    parser.add_argument("--partial", action="store_true", help="train while the pairs are still being made")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.set_defaults(run=run)
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    check_weights_name(arguments.out)
    if arguments.steps is not None and arguments.steps < 1:
        raise UsageError("--steps must be a whole number from 1.")
    if arguments.minutes is not None and not 0.0 < arguments.minutes < float("inf"):
        raise UsageError("--minutes must be positive.")
    with require_torch("training"):
        from ..encoder.train import Schedule, train_encoder
    from hnf_core.material.alexnet_encoder import save_encoder

    steps = arguments.steps or (Schedule().steps if arguments.trunk is None else 3000)
    bar = ProgressBar()

    def watch(step: int, share: float, loss: float) -> None:
        bar.show(Progress(f"step {step}, loss {loss:.4f}", min(int(PERCENT * share), PERCENT), PERCENT))

    try:
        trained = train_encoder(
            arguments.data,
            Schedule(steps=steps, minutes=arguments.minutes),
            arguments.seed,
            backbone=arguments.trunk,
            partial=arguments.partial,
            watch=watch,
        )
    finally:
        bar.close()
    save_encoder(arguments.out, trained.network)
    record = {"weights": str(arguments.out), **trained.network.metadata}
    print(json.dumps(record, indent=1) if arguments.json else "\n".join(f"{k}: {v}" for k, v in record.items()))
    return 0
