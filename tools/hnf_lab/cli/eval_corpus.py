"""`hnf eval corpus DIR`: touch every model under a folder as `hnf touch` does, and tabulate what became of each."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

from hnf_core.errors import FileError, UsageError
from hnf_core.files import write_text
from hnf_core.progress import ProgressBar


def add_parser(subjects: Any) -> None:
    """Add `hnf eval corpus`."""
    parser = subjects.add_parser(
        "corpus",
        help="every model under a folder, touched as hnf touch does",
        description="Run hnf touch on every scene file under DIR, each in a process of its own, and write what was "
        "touched, skipped or refused and why, how long strokes are silent and how strong they are. The exit code is 1 "
        "if any model is at fault: a traceback, a killed process, a stroke silent for more than 5 % of its time or of "
        "more than 100 m/s² RMS without a line. Needs bpy; takes seconds to minutes a model.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of models, with all its folders")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", required=True, help="folder for corpus.md, .json and results"
    )
    parser.add_argument("--limit", type=float, default=600.0, metavar="S", help="longest time of a model (default 600)")
    parser.add_argument("--options", default="", metavar="TEXT", help="further options of hnf touch, as one text")
    parser.add_argument("--json", action="store_true", help="print one JSON array")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if not 1.0 <= arguments.limit <= 86_400.0:
        raise UsageError(f"--limit {arguments.limit:g}.", remedy="Give 1 to 86400 seconds.")
    if not arguments.folder.is_dir():
        raise FileError("is no folder.", where=str(arguments.folder), remedy="Give a folder of models.")
    try:
        words = shlex.split(arguments.options)
    except ValueError as error:
        raise UsageError(f"--options: {error}.", remedy="Close its quotation marks.") from error
    from ..evaluation.corpus import format_corpus, measure_corpus, to_json

    bar = ProgressBar()
    try:
        outcomes = measure_corpus(
            arguments.folder, arguments.out, limit_s=arguments.limit, words=words, progress=bar.show
        )
    finally:
        bar.close()
    report, record = format_corpus(outcomes), json.dumps(to_json(outcomes), indent=1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_text(arguments.out / "corpus.md", report + "\n")
    write_text(arguments.out / "corpus.json", record + "\n")
    print(record if arguments.json else report)
    return 1 if any(each.kind == "at fault" for each in outcomes) else 0
