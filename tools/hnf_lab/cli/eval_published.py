"""`hnf eval published`: the paper's second table, GACM, HNF and HNF+ by touch sensor."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from hnf_core.cli.commands import require_torch
from hnf_core.errors import UsageError
from hnf_core.files import write_text
from hnf_core.progress import Progress, ProgressBar


def add_parser(subjects: Any) -> None:
    """Add `hnf eval published`."""
    parser = subjects.add_parser(
        "published",
        help="the paper's second table: GACM, HNF and HNF+ by touch sensor, with the limits beside them",
        description="Train GACM, HNF and HNF+ on 20 s of circles on simulated materials, with each touch sensor's "
        "token, and score them as published. The first material has the paper's settings by default; the others, and "
        "the rows of raw actions, smaller ones, which stand in every row.",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="writes published.md and .json here")
    parser.add_argument("--materials", nargs="+", metavar="NAME", help="default: sandstone, denim, brushed-metal")
    parser.add_argument("--epochs", type=int, default=100, metavar="N", help="on the first material (default 100)")
    parser.add_argument("--hidden", type=int, default=1024, metavar="H", help="units there (default 1024)")
    parser.add_argument("--other-epochs", type=int, default=30, metavar="N", help="on the others (default 30)")
    parser.add_argument("--other-hidden", type=int, default=256, metavar="H", help="units there (default 256)")
    parser.add_argument("--raw-epochs", type=int, default=10, metavar="N", help="on raw actions (default 10; 0: none)")
    parser.add_argument("--raw-hidden", type=int, default=128, metavar="H", help="units there (default 128)")
    parser.add_argument("--gacm-steps", type=int, default=4000, metavar="N", help="of GACM (default 4000)")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="of each test stroke (default 4)")
    parser.add_argument("--realisations", type=int, default=16, metavar="N", help="of the true process (default 16)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="materials at once (default 2)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of strokes, draws and training")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    sizes = (arguments.epochs, arguments.hidden, arguments.other_epochs, arguments.other_hidden, arguments.raw_hidden,
             arguments.gacm_steps, arguments.workers)  # fmt: skip
    if min(sizes) < 1 or arguments.raw_epochs < 0 or arguments.seed < 0 or arguments.realisations < 2:
        raise UsageError("sizes must be at least 1, --realisations 2, --raw-epochs and --seed 0.")
    if not 1.0 <= arguments.seconds <= 60.0:
        raise UsageError("--seconds must be 1 to 60.")
    with require_torch("evaluation trains its methods and"):
        from ..evaluation.published_table import Settings, TableOptions, format_tables, make_table, to_json

    options = TableOptions(
        materials=tuple(arguments.materials or TableOptions.materials),
        first=Settings(arguments.hidden, arguments.epochs),
        others=Settings(arguments.other_hidden, arguments.other_epochs),
        raw=Settings(arguments.raw_hidden, arguments.raw_epochs) if arguments.raw_epochs else None,
        gacm_steps=arguments.gacm_steps,
        seconds=arguments.seconds,
        realisations=arguments.realisations,
        seed=arguments.seed,
        workers=arguments.workers,
    )
    bar, steps, text, record = ProgressBar(), [0], "", ""

    def watch(stage: str) -> None:
        steps[0] += 1
        bar.show(Progress(stage, steps[0], max(steps[0] + 1, 12)))

    try:
        for tables in make_table(options, watch):  # what is finished stays, also of a run that is stopped
            text, record = format_tables(tables), json.dumps(to_json(tables, options), indent=1)
            write_text(arguments.out / "published.md", text)
            write_text(arguments.out / "published.json", record + "\n")
    finally:
        bar.close()
    print(record if arguments.json else text)
    return 0
