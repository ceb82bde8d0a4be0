"""`hnf eval recordings`: compare the library with recorded textures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hnf_core.errors import UsageError
from hnf_core.files import write_text
from hnf_core.progress import ProgressBar


def add_parser(subjects: Any) -> None:
    """Add `hnf eval recordings`."""
    parser = subjects.add_parser(
        "recordings",
        help="the library beside recorded textures, with what a constant answer gives",
        description="Ask for every texture of your copy of HaTT by its name, as hnf synth --material would, and "
        "compare spectra at nine speeds and forces; beside it the mean of the other textures, of its category and of "
        "its name. Takes some three minutes.",
    )
    add_judge_options(parser, "recordings", "texture models")
    parser.set_defaults(run=run)


def add_judge_options(parser: argparse.ArgumentParser, name: str, needed: str) -> None:
    """Add the options of a judge by HaTT; needed: what of the data set it reads."""
    parser.add_argument("--hatt", type=Path, metavar="DIR", required=True, help=f"your copy of HaTT's {needed}")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"also write {name}.md, .json and .png here")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="of each rendered stroke (default 4)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def check_seconds(arguments: argparse.Namespace) -> None:
    """Raise UsageError for an impossible duration of strokes."""
    if not 0.5 <= arguments.seconds <= 600.0:
        raise UsageError("--seconds must be 0.5 to 600.")


def show_results(
    arguments: argparse.Namespace, name: str, report: str, record: str, draw: Callable[[Path], None]
) -> None:
    """Print a report or its JSON, and write both and the picture where --out says."""
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_text(arguments.out / f"{name}.md", report + "\n")
        write_text(arguments.out / f"{name}.json", record + "\n")
        draw(arguments.out / f"{name}.png")
    print(record if arguments.json else report)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    check_seconds(arguments)
    from ..evaluation.recordings.measure import measure_recordings
    from ..evaluation.recordings.report import format_recordings, to_json, write_picture

    bar = ProgressBar()
    try:
        results, statistics = measure_recordings(arguments.hatt, seconds=arguments.seconds, progress=bar.show)
    finally:
        bar.close()
    report, record = format_recordings(results, statistics), json.dumps(to_json(results, statistics), indent=1)
    show_results(arguments, "recordings", report, record, lambda path: write_picture(path, results))
    return 0
