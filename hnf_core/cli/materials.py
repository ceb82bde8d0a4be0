"""`hnf materials`: what the library holds, and one of it as a file."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..material.hnf_file import from_library, write_hnf
from ..material.library import find, load_library

LICENCE = "GPL-3.0-or-later"
"""Of the library, and so of what is exported from it."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "materials", help="list the library's materials", description="List the materials that --material takes."
    )
    parser.add_argument("--json", action="store_true", help="print a list of objects")
    parser.add_argument("--export", metavar="NAME", help="write this material to a file, for --out")
    parser.add_argument("--out", type=Path, metavar="FILE.hnf", help="where --export writes")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """List the library, or with --export write one material. Raises UsageError, MaterialError and FileError."""
    if arguments.export is not None or arguments.out is not None:
        return _export(arguments.export, arguments.out)
    library = load_library()
    if arguments.json:
        print(json.dumps([_record(material) for material in library], indent=1))
        return 0
    width = max(len(material.name) for material in library)
    for material in library:
        print(f"{material.name:<{width}}  {material.category:<8}  {', '.join(material.words)}")
    return 0


def _export(name: str | None, path: Path | None) -> int:
    if name is None or path is None:
        raise UsageError("--export NAME and --out FILE.hnf belong together.", remedy="Give both.")
    material = find(name)
    write_hnf(path, from_library(material, LICENCE))
    print(f"{material.name} → {path}")
    return 0


def _record(material: Any) -> dict[str, Any]:
    mechanics = material.mechanics
    return {
        "name": material.name,
        "category": material.category,
        "words": list(material.words),
        "stiffness_n_m": mechanics.stiffness_n_m,
        "damping_ratio": mechanics.damping_ratio,
        "friction": mechanics.friction,
    }
