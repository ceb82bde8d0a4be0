"""`hnf bench`: measure time, memory and error of each method."""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hnf_core.cli.commands import LABORATORY_HELP
from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

if TYPE_CHECKING:
    from ..bench.harness import Bench


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "bench",
        help=LABORATORY_HELP["bench"],
        description="Measure, and print a table in Markdown: medians and spread of repeated runs, ratios of runs in "
        "pairs, the error beside each faster way, and the machine. A busy machine gives other times and the same "
        "ratios.",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="one of them (default: all; an unknown one lists them)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="of each measurement (default 5)")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: proves that it runs, and nothing else")
    parser.add_argument("--scene", type=Path, metavar="FILE", help="a splat .ply that `splats` also measures on")
    parser.add_argument("--json", action="store_true", help="print a list of objects instead")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="also draw time over error, or over size, as FILE.png or FILE.svg"
    )
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the named benches, without Blender only the core ones. Raises HnfError; returns the exit code."""
    from .bench_catalogue import BENCHES, CORE_BENCHES

    return run_benches(arguments, CORE_BENCHES if importlib.util.find_spec("bpy") is None else BENCHES)


def run_benches(arguments: argparse.Namespace, benches: Sequence[Bench]) -> int:
    """Run the selected benches and print their rows. Raises UsageError, and what a bench raises."""
    from ..bench.harness import BenchOptions, describe_machine, format_rows

    chosen = [bench for bench in benches if arguments.name in (None, bench.name)]
    if not chosen:
        listed = "\n".join(f"  {bench.name:<16} {bench.description}" for bench in benches)
        raise UsageError(f"there is no bench '{arguments.name}'.", remedy=f"There are:\n{listed}")
    if arguments.repeats < 1:
        raise UsageError("--repeats must be at least 1.")
    if arguments.plot is not None:
        from ..bench.plots import check_suffix

        check_suffix(arguments.plot)
    before, bar, rows = describe_machine(), ProgressBar(), []
    try:
        for index, bench in enumerate(chosen):
            options = BenchOptions(
                arguments.repeats,
                arguments.quick,
                lambda what, index=index: bar.show(Progress(what, index, len(chosen))),  # type: ignore[misc]
                arguments.scene,
            )
            rows += bench.measure(options)
    finally:
        bar.close()
    facts = describe_machine() | {
        name: before[name] for name in ("load",) if name in before
    }  # the load before the benches added to it
    if arguments.json:
        print(json.dumps([row.to_json() | {"machine": facts} for row in rows], indent=1, ensure_ascii=False))
    else:
        print(format_rows(rows, facts))
    if arguments.plot is not None:
        from ..bench.plots import write_plot

        write_plot(arguments.plot, rows)
    return 0
