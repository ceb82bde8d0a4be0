"""`hnf eval formats [DIR]`: convert haptic files from every format to every other and tabulate what it costs."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from hnf_core.errors import FileError, UsageError
from hnf_core.progress import ProgressBar


def add_parser(subjects: Any) -> None:
    """Add `hnf eval formats`."""
    parser = subjects.add_parser(
        "formats",
        help="haptic files from every format to every other: duration, level, clicks",
        description="Convert haptic files, made-up ones or those under DIR, from every format to every other as "
        "hnf export does, and print a table of what the worst clip of each pair loses. The exit code is 1 if a clip "
        "was refused. Takes a minute.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", nargs="?", help="folder of your own haptic files")
    parser.add_argument("--clips", type=int, default=40, metavar="N", help="made-up clips without DIR (default 40)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the made-up clips")
    parser.add_argument("--json", action="store_true", help="print one JSON array, a cell for each pair")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if not 1 <= arguments.clips <= 10_000 or arguments.seed < 0:
        raise UsageError("--clips must be 1 to 10000, --seed at least 0.")
    if arguments.folder is not None and not arguments.folder.is_dir():
        raise FileError("is no folder.", where=str(arguments.folder), remedy="Give a folder of haptic files.")
    from ..evaluation.formats import find_clips, format_matrix, make_clips, measure_formats, to_json

    bar = ProgressBar()
    with tempfile.TemporaryDirectory() as name:
        clips = (
            make_clips(Path(name), arguments.clips, arguments.seed)
            if arguments.folder is None
            else find_clips(arguments.folder)
        )
        try:
            cells = measure_formats(clips, progress=bar.show)
        finally:
            bar.close()
    print(json.dumps(to_json(cells), indent=1) if arguments.json else format_matrix(cells))
    return 1 if any(cell.refused for cell in cells) else 0
