"""The words of the interface in other languages. English is the key; Blender looks labels and tooltips up by itself,
texts with figures in them are looked up by tr() before the figures go in."""

from __future__ import annotations

from .german import GERMAN

OWNER = __name__
CONTEXTS = ("*", "Operator")
"""Blender asks for the names of operators in a context of their own."""


def dictionary() -> dict[str, dict[tuple[str, str], str]]:
    """What Blender is given: {locale: {(context, English): translation}}."""
    return {"de_DE": {(context, text): said for text, said in GERMAN.items() for context in CONTEXTS}}


def tr(text: str) -> str:
    """text in the language of Blender's interface, or as it is."""
    import bpy

    return str(bpy.app.translations.pgettext_iface(text))


def register() -> None:
    import bpy

    bpy.app.translations.register(OWNER, dictionary())


def unregister() -> None:
    import bpy

    bpy.app.translations.unregister(OWNER)
