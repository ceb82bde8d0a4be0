"""`hnf eval photographs`: touch photographs of recorded textures and compare with the recordings."""

from __future__ import annotations

import argparse
import json
from typing import Any

from hnf_core.progress import ProgressBar

from .eval_recordings import add_judge_options, check_seconds, show_results


def add_parser(subjects: Any) -> None:
    """Add `hnf eval photographs`."""
    parser = subjects.add_parser(
        "photographs",
        help="photographs of recorded textures, touched as hnf touch does",
        description="Show the photograph of every texture of your copy of HaTT on a plane in Blender, with and without "
        "its name, touch it as hnf touch does, and compare with the recording; beside it the mean of the other "
        "textures, of its category and of its name, and how often the confidence is right. Needs bpy; takes some "
        "fifteen minutes for 50 textures.",
    )
    add_judge_options(parser, "photographs", "texture models and photographs")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    check_seconds(arguments)
    from ..evaluation.photographs.measure import measure_photographs
    from ..evaluation.photographs.report import format_photographs, to_json, write_picture

    bar = ProgressBar()
    try:
        results = measure_photographs(arguments.hatt, seconds=arguments.seconds, progress=bar.show)
    finally:
        bar.close()
    report, record = format_photographs(results), json.dumps(to_json(results), indent=1)
    show_results(arguments, "photographs", report, record, lambda path: write_picture(path, results))
    return 0
