"""Every English text of the interface: of registered classes, and of the sources that draw."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

ADDON = Path(__file__).resolve().parents[2] / "hnf_blender"
LOOKED_UP = {"tr": 0, "fail_poll": 1}
"""Functions whose text is translated, and which argument it is."""
TEXT_ARGUMENTS = {"text", "message"}


def strings_of_classes(classes: Iterator[Any]) -> set[str]:
    """Labels and tooltips of classes, their properties and enum items."""
    found: set[str] = set()
    for each in classes:
        found |= {getattr(each, "bl_label", ""), getattr(each, "bl_description", "")}
        rna = each.bl_rna
        if issubclass(each, bpy.types.Operator):
            module, name = each.bl_idname.split(".")
            rna = getattr(getattr(bpy.ops, module), name).get_rna_type()
        for prop in rna.properties:
            own = {name for base in each.__mro__ for name in vars(base).get("__annotations__", {})}
            if prop.identifier in own and not prop.is_hidden:
                found |= {prop.name, prop.description}
                if prop.type == "ENUM":
                    found |= {text for item in prop.enum_items for text in (item.name, item.description)}
    return {text for text in found if text}


def strings_of_sources() -> set[str]:
    """Literals given to tr(), to greyed() and to layouts as text=, in the whole add-on."""
    found: set[str] = set()
    for path in sorted(ADDON.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        named = dict(_constants(tree))
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if len(node.args) > LOOKED_UP.get(name, len(node.args)):
                given = node.args[LOOKED_UP[name]]
                found |= _literals(named.get(getattr(given, "id", ""), given))
            if name in {"label", "operator", "prop", "menu", "operator_menu_enum"}:
                shown = {word.arg: word.value for word in node.keywords}
                translated = shown.get("translate")
                if "text" in shown and not (isinstance(translated, ast.Constant) and translated.value is False):
                    found |= _literals(shown["text"])
    return {text for text in found if any(letter.isalpha() for letter in text)}


def untranslated_reports() -> set[str]:
    """Literals and constants that operators report as they are: in English, whatever the interface speaks."""
    found: set[str] = set()
    for path in sorted(ADDON.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        named = dict(_constants(tree))
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "report" and len(node.args) == 2:
                found |= _literals(named.get(getattr(node.args[1], "id", ""), node.args[1]))
    return found


def _constants(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Names of the module's constants, and what they are."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            yield from ((target.id, node.value) for target in node.targets if isinstance(target, ast.Name))


def _literals(node: ast.expr) -> set[str]:
    """A text, or those of both sides of a conditional expression or of an `or`."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return {node.value}
    if isinstance(node, ast.IfExp):
        return _literals(node.body) | _literals(node.orelse)
    if isinstance(node, ast.BoolOp):
        return {text for value in node.values for text in _literals(value)}
    return set()
