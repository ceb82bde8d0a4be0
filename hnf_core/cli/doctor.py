"""`hnf doctor`: report what is installed and active, and what is unavailable without missing packages."""

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
    """Add `hnf doctor`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "doctor",
        help=HELP["doctor"],
        description="Say what is installed and at work, and what a missing part costs; for whoever helps you.",
    )
    parser.add_argument("--json", action="store_true", help="print it as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Print the report; return the exit code, which is always 0."""
    facts = (
        *get_base_versions(),
        Fact("compiled_kernel", "Compiled kernel", describe_kernel()),
        Fact("field", "Field", describe_field()),
        *hash_data_files(),
        Fact("touch_cache", "Cache of touch", CACHE_LOCATION),
    )
    packages = [(entry, get_version(entry.name)) for entry in OPTIONAL_PACKAGES]
    if arguments.json:
        installed = {
            entry.name: {"version": version or None, "without": "" if version else entry.without}
            for entry, version in packages
        }
        print(
            json.dumps(
                {**{entry.key: entry.value for entry in facts}, "packages": installed}, indent=1, ensure_ascii=False
            )
        )
        return 0
    rows = [(entry.label, entry.value) for entry in facts]
    rows += [(entry.name, version or f"not installed: {entry.without}") for entry, version in packages]
    width = max(len(name) for name, _ in rows)
    print("\n".join(f"{name:<{width}}  {value}" for name, value in rows))
    return 0
