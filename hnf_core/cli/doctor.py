"""`hnf doctor`: what is installed, what is at work, and what a missing part costs."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..diagnostics import (
    OPTIONAL_PACKAGES,
    Fact,
    describe_field,
    describe_kernel,
    get_base_versions,
    get_version,
    hash_data_files,
)
from .commands import HELP

CACHE_LOCATION = "in the folder 'cache' of each --out"


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "doctor",
        help=HELP["doctor"],
        description="Say what is installed and at work, and what a missing part costs; for whoever helps you.",
    )
    parser.add_argument("--json", action="store_true", help="print it as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Prints; returns the exit code, 0 whatever is missing."""
    facts = (
        *get_base_versions(),
        Fact("compiled_kernel", "Compiled kernel", describe_kernel()),
        Fact("field", "Field", describe_field()),
        *hash_data_files(),
        Fact("touch_cache", "Cache of touch", CACHE_LOCATION),
    )
    packages = [(each, get_version(each.name)) for each in OPTIONAL_PACKAGES]
    if arguments.json:
        found = {
            each.name: {"version": version or None, "without": "" if version else each.without}
            for each, version in packages
        }
        print(json.dumps({**{each.key: each.value for each in facts}, "packages": found}, indent=1, ensure_ascii=False))
        return 0
    rows = [(each.label, each.value) for each in facts]
    rows += [(each.name, version or f"not installed: {each.without}") for each, version in packages]
    width = max(len(name) for name, _ in rows)
    print("\n".join(f"{name:<{width}}  {value}" for name, value in rows))
    return 0
