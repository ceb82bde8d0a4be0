"""`hnf materials`: list the material library, rank it by likeness to a name, or write one material to a file."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..material.hnf_file import from_library, write_hnf
from ..material.library import Appearance, get_material, load_library
from ..material.name_matching import is_image_name
from ..material.ranking import NO_EVIDENCE, Suggestion, rank
from .commands import HELP

LIBRARY_LICENCE = "GPL-3.0-or-later"
"""Licence of the library, and therefore of what is exported from it."""
MAX_SUGGESTIONS = 8
"""Most suggestions printed for a person; --json prints all."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf materials`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "materials", help=HELP["materials"], description="List the materials that --material takes."
    )
    parser.add_argument("--json", action="store_true", help="print a list of objects")
    parser.add_argument(
        "--suggest", metavar="WORDS", help="rank the library by a name: of an object, a material or a texture's file"
    )
    parser.add_argument("--export", metavar="NAME", help="write this material to a file, for --out")
    parser.add_argument("--out", type=Path, metavar="FILE.hnf", help="where --export writes")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """List the library, rank it for a name (--suggest), or write one material (--export); return the exit code.

    Raises UsageError, MaterialError or FileError.
    """
    if arguments.suggest is not None:
        if arguments.export is not None or arguments.out is not None:
            raise UsageError("--suggest writes nothing.", remedy="Leave out --export and --out.")
        return _print_suggestions(arguments.suggest, arguments.json)
    if arguments.export is not None or arguments.out is not None:
        return _export(arguments.export, arguments.out)
    library = load_library()
    if arguments.json:
        print(json.dumps([_to_json(material) for material in library], indent=1))
        return 0
    width = max(len(material.name) for material in library)
    for material in library:
        print(f"{material.name:<{width}}  {material.category:<8}  {', '.join(material.words)}")
    return 0


def rank_suggestions(words: str) -> tuple[Suggestion, ...]:
    """Rank the library's materials by how well they fit the words of a name, best first.

    A name that ends like an image file ("….png") is ranked as a texture, any other as a material. Raises UsageError if
    the name holds no letter.
    """
    if not any(letter.isalpha() for letter in words):
        raise UsageError(f"--suggest {words!r} holds no word.", remedy="Example: --suggest 'old oak table'")
    if is_image_name(words):
        return rank(load_library(), Appearance(), [""], image_names=[words])
    return rank(load_library(), Appearance(), [words])


def _print_suggestions(words: str, as_json: bool) -> int:
    ranked = rank_suggestions(words)
    if as_json:
        category = {material.name: material.category for material in load_library()}
        records = [
            {
                "name": suggestion.name,
                "category": category[suggestion.name],
                "confidence": round(suggestion.confidence, 4),
                "probability": round(suggestion.probability, 4),
                "reason": suggestion.reason,
            }
            for suggestion in ranked
        ]
        print(json.dumps(records, indent=1, ensure_ascii=False))
        return 0
    shown = [suggestion for suggestion in ranked if suggestion.reason != NO_EVIDENCE][:MAX_SUGGESTIONS]
    if not shown:
        print(f"no word of {words!r} names a material that the library knows; hnf materials lists them.")
    width = max((len(suggestion.name) for suggestion in shown), default=0)
    for suggestion in shown:
        print(f"{suggestion.name:<{width}}  {suggestion.confidence:4.0%}  {suggestion.reason}")
    return 0


def _export(name: str | None, path: Path | None) -> int:
    if name is None or path is None:
        raise UsageError("--export NAME and --out FILE.hnf belong together.", remedy="Give both.")
    material = get_material(name)
    write_hnf(path, from_library(material, LIBRARY_LICENCE))
    print(f"{material.name} → {path}")
    return 0


def _to_json(material: Any) -> dict[str, Any]:
    mechanics = material.mechanics
    return {
        "name": material.name,
        "category": material.category,
        "words": list(material.words),
        "stiffness_n_m": mechanics.stiffness_n_m,
        "damping_ratio": mechanics.damping_ratio,
        "friction": mechanics.friction,
    }
