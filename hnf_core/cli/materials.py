"""`hnf materials`: what the library holds."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..material.library import load_library


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "materials", help="list the library's materials", description="List the materials that --material takes."
    )
    parser.add_argument("--json", action="store_true", help="print a list of objects")
    return parser


def run(arguments: argparse.Namespace) -> int:
    library = load_library()
    if arguments.json:
        print(json.dumps([_record(material) for material in library], indent=1))
        return 0
    width = max(len(material.name) for material in library)
    for material in library:
        print(f"{material.name:<{width}}  {material.category:<8}  {', '.join(material.words)}")
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
