"""`hnf eval fuzz`: mutated files of every kind that is read; each is read, or refused in one clear line."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from hnf_core.errors import UsageError
from hnf_core.progress import ProgressBar


def add_parser(subjects: Any) -> None:
    """Add `hnf eval fuzz`."""
    parser = subjects.add_parser(
        "fuzz",
        help="mutated files of every kind that is read",
        description="Flip bits of small files, cut them, repeat parts, and put other numbers and values into them; "
        "then read them. Each must be read or refused in one line within 10 s; the exit code is 1 if one is not. Its "
        "kind and number, with the seed, make it again. With --scenes Blender opens them, in processes of their own "
        "(needs bpy).",
    )
    parser.add_argument("--count", type=int, default=1000, metavar="N", help="mutations of each kind (default 1000)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the mutations")
    parser.add_argument("--only", nargs="+", metavar="KIND", help="only these kinds (an unknown one lists them)")
    parser.add_argument("--scenes", action="store_true", help="scene files, which Blender opens")
    parser.add_argument("--json", action="store_true", help="print one JSON array")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if not 1 <= arguments.count <= 10**7 or arguments.seed < 0:
        raise UsageError("--count must be 1 to 10000000, --seed at least 0.")
    from ..evaluation.fuzz import OLD_SCENE_KINDS, READERS, SCENE_KINDS, format_tallies, fuzz_readers, fuzz_scenes

    kinds = SCENE_KINDS if arguments.scenes else tuple(READERS)
    chosen = tuple(arguments.only or kinds)
    known = (*SCENE_KINDS, *OLD_SCENE_KINDS) if arguments.scenes else kinds
    for kind in chosen:
        if kind not in known:
            raise UsageError(f"there is no kind '{kind}'.", remedy=f"There are: {', '.join(known)}.")
    bar = ProgressBar()
    try:
        tallies = (fuzz_scenes if arguments.scenes else fuzz_readers)(chosen, arguments.count, arguments.seed, bar.show)
    finally:
        bar.close()
    if arguments.json:
        print(json.dumps([asdict(each) for each in tallies], indent=1))
    else:
        print(format_tallies(tallies, arguments.seed))
    return 1 if any(each.faults for each in tallies) else 0
