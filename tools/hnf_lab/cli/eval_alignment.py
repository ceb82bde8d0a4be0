"""`hnf eval alignment`: classification, retrieval and cross-sensor matching of trained encoders."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

from .train_alignment import PAIRS, add_data_option, prepare_torch


def add_parser(subjects: Any) -> None:
    parser = subjects.add_parser(
        "alignment",
        help="looks and touch in one space",
        description="Probe, retrieve and bridge with the encoders of one or more `hnf train alignment`, on places that "
        "none of them was trained on. Takes a minute or two for each.",
    )
    add_data_option(parser)
    parser.add_argument(
        "--models", nargs="+", type=Path, required=True, metavar="DIR", help="folders of hnf train alignment"
    )
    parser.add_argument("--items", type=int, metavar="N", help="labeled tuples of a sensor that probes are fitted to")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of torch (default 1)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of draws, lamps and intervals")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if arguments.seed < 0 or arguments.threads < 1 or (arguments.items is not None and arguments.items < 20):
        raise UsageError("--seed must be at least 0, --threads 1, --items 20.")
    prepare_torch(arguments.threads)
    from ..alignment.inputs import open_source
    from ..alignment.results import PROBE_ITEMS, compute_chance_levels, format_report, make_report, measure_encoders
    from ..alignment.train import load_encoders

    models = [load_encoders(folder) for folder in arguments.models]
    source = open_source(arguments.data or [[PAIRS]])
    training, held_out = source.load_training(), source.load_held_out()
    bar, measured = ProgressBar(), []
    try:
        for number, encoders in enumerate(models):
            bar.show(Progress(f"encoders trained on {encoders.sensor}", number, len(models)))
            measured.append(
                measure_encoders(encoders, training, held_out, arguments.seed, arguments.items or PROBE_ITEMS)
            )
    finally:
        bar.close()
    report = make_report(measured, compute_chance_levels(held_out))
    record = {
        **report.to_json(),
        "models": [dict(encoders.record) for encoders in models],
        "data": list(source.messages),
    }
    print(json.dumps(record, indent=1) if arguments.json else format_report(report))
    return 0
