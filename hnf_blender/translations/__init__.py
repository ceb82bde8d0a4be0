"""Translations of the user interface.

`data/LOCALE.json` maps English texts to translations; placeholders in braces stay as they are. Blender translates
labels and tooltips itself. Texts with numbers in them are translated by `tr` before the numbers are filled in.
"""

from __future__ import annotations

import json
from pathlib import Path

MODULE_NAME = __name__
DATA_FOLDER = Path(__file__).resolve().parent / "data"
CONTEXTS = ("*", "Operator")
"""Translation contexts; Blender looks up operator names in a context of their own."""


def read_translations(locale: str) -> dict[str, str]:
    """Read one language's translations: English text → translation."""
    translations: dict[str, str] = json.loads((DATA_FOLDER / f"{locale}.json").read_text(encoding="utf-8"))
    return translations


def build_dictionary() -> dict[str, dict[tuple[str, str], str]]:
    """Build Blender's translation dictionary {locale: {(context, English): translation}} from all files."""
    return {
        path.stem: {
            (context, text): translation
            for text, translation in read_translations(path.stem).items()
            for context in CONTEXTS
        }
        for path in sorted(DATA_FOLDER.glob("*.json"))
    }


def tr(text: str) -> str:
    """Translate a text into the interface language; untranslated texts are returned unchanged."""
    import bpy

    return str(bpy.app.translations.pgettext_iface(text))


def register() -> None:
    """Register the translations with Blender."""
    import bpy

    bpy.app.translations.register(MODULE_NAME, build_dictionary())


def unregister() -> None:
    """Unregister the translations."""
    import bpy

    bpy.app.translations.unregister(MODULE_NAME)
