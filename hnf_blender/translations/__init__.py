"""The words of the interface in other languages.

data/LOCALE.json holds English → translation; placeholders in braces stay. Blender looks labels and tooltips up by
itself, texts with figures in them are looked up by tr() before the figures go in.
"""

from __future__ import annotations

import json
from pathlib import Path

MODULE_NAME = __name__
DATA_FOLDER = Path(__file__).resolve().parent / "data"
CONTEXTS = ("*", "Operator")
"""Blender asks for the names of operators in a context of their own."""


def read_translations(locale: str) -> dict[str, str]:
    """English → translation of one language, as its file has it."""
    found: dict[str, str] = json.loads((DATA_FOLDER / f"{locale}.json").read_text(encoding="utf-8"))
    return found


def build_dictionary() -> dict[str, dict[tuple[str, str], str]]:
    """What Blender is given: {locale: {(context, English): translation}}, of every file there is."""
    return {
        path.stem: {
            (context, text): said for text, said in read_translations(path.stem).items() for context in CONTEXTS
        }
        for path in sorted(DATA_FOLDER.glob("*.json"))
    }


def tr(text: str) -> str:
    """text in the language of Blender's interface, or as it is."""
    import bpy

    return str(bpy.app.translations.pgettext_iface(text))


def register() -> None:
    import bpy

    bpy.app.translations.register(MODULE_NAME, build_dictionary())


def unregister() -> None:
    import bpy

    bpy.app.translations.unregister(MODULE_NAME)
