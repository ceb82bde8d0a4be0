"""`hnf eval`: evaluate methods by all metrics, with the bounds of the data."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hnf_core.cli.commands import LABORATORY_HELP, require_torch
from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

from .eval_alignment import add_parser as _add_alignment
from .eval_corpus import add_parser as _add_corpus
from .eval_formats import add_parser as _add_formats
from .eval_fuzz import add_parser as _add_fuzz
from .eval_photographs import add_parser as _add_photographs
from .eval_published import add_parser as _add_published
from .eval_recordings import add_parser as _add_recordings
from .eval_tactile_map import add_parser as _add_tactile_map

SUBJECTS: tuple[Callable[[Any], object], ...] = (
    _add_alignment,
    _add_corpus,
    _add_formats,
    _add_fuzz,
    _add_photographs,
    _add_published,
    _add_recordings,
    _add_tactile_map,
)
"""Further subjects: each adds a parser with its own runner as the default of `run`."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "eval",
        help=LABORATORY_HELP["eval"],
        description="Train every method on simulated materials (and on your copy of HaTT), render strokes that none of "
        "them learned from, and write eval.md, eval.json and pictures. Takes minutes for each material; --quick "
        "proves that it runs and nothing else. Needs the extra [train].",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write into (needed)")
    parser.add_argument("--quick", action="store_true", help="few materials, short strokes, a few steps of training")
    parser.add_argument("--hatt", type=Path, metavar="DIR", help="your copy of the Penn Haptic Texture Toolkit")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="the shared field (default: the shipped one)")
    parser.add_argument("--space", type=Path, metavar="FILE", help="space.safetensors, for the row of bridged tokens")
    parser.add_argument("--methods", nargs="+", metavar="KEY", help="only these (an unknown one lists them)")
    parser.add_argument("--materials", nargs="+", metavar="NAME", help="library materials for columns a and b")
    parser.add_argument("--textures", type=int, default=3, metavar="N", help="of HaTT, to train on (default 3)")
    parser.add_argument(
        "--seconds", type=float, default=120.0, metavar="S", help="of each material to learn from (default 120)"
    )
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="materials at once (default 2)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of strokes, draws and training")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    if SUBJECTS:
        subjects = parser.add_subparsers(dest="what", metavar="WHAT", help="instead of fields and rivals")
        for add_subject in SUBJECTS:
            add_subject(subjects)
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if arguments.out is None:
        raise UsageError("hnf eval writes a report and pictures.", remedy="Say where: --out DIR.")
    if arguments.workers < 1 or arguments.seed < 0 or arguments.textures < 0 or not 5.0 <= arguments.seconds <= 1e4:
        raise UsageError("--workers must be at least 1, --seed and --textures 0, --seconds 5.")
    with require_torch("evaluation trains its methods and"):
        from hnf_core.training import train_material  # noqa: F401
    from ..evaluation.methods import Budget
    from ..evaluation.report import format_report
    from ..evaluation.run import QUICK_SIZES, SIMULATED_MATERIALS, EvaluationOptions, run_evaluation

    options = EvaluationOptions(
        out=arguments.out,
        budget=Budget(weights=arguments.weights),
        keys=None if arguments.methods is None else tuple(arguments.methods),
        hatt=arguments.hatt,
        seed=arguments.seed,
        workers=arguments.workers,
        space=arguments.space,
        simulated=SIMULATED_MATERIALS if arguments.materials is None else tuple(arguments.materials),
    )
    sizes = replace(
        options.sizes, simulated=len(options.simulated), hatt=arguments.textures, training_s=arguments.seconds
    )
    options = replace(options, sizes=sizes)
    if arguments.quick:
        options = replace(options, sizes=QUICK_SIZES, budget=replace(options.budget, epochs=2, steps=50))
    bar, stages = ProgressBar(), [0]

    def watch(stage: str) -> None:
        stages[0] += 1
        bar.show(Progress(stage, stages[0], max(stages[0] + 1, 12)))

    try:
        report = run_evaluation(options, watch)
    finally:
        bar.close()
    print(json.dumps(report.to_json(), indent=1, default=str) if arguments.json else format_report(report))
    return 0
