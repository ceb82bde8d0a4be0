"""`hnf eval recordings`: compare the library with recorded textures."""

from __future__ import annotations

import argparse
import json
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
    parser.add_argument("--hatt", type=Path, metavar="DIR", required=True, help="your copy of HaTT's texture models")
    parser.add_argument("--out", type=Path, metavar="DIR", help="also write recordings.md, .json and .png here")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="of each rendered stroke (default 4)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if not 0.5 <= arguments.seconds <= 600.0:
        raise UsageError("--seconds must be 0.5 to 600.")
    from ..evaluation.recordings.measure import measure_recordings
    from ..evaluation.recordings.report import format_recordings, to_json, write_picture

    bar = ProgressBar()
    try:
        results, statistics = measure_recordings(arguments.hatt, seconds=arguments.seconds, progress=bar.show)
    finally:
        bar.close()
    report, record = format_recordings(results, statistics), json.dumps(to_json(results, statistics), indent=1)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_text(arguments.out / "recordings.md", report + "\n")
        write_text(arguments.out / "recordings.json", record + "\n")
        write_picture(arguments.out / "recordings.png", results)
    print(record if arguments.json else report)
    return 0
