"""Every English text of the interface: of registered classes, and of the sources that draw."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import bpy

ADDON = Path(__file__).resolve().parents[2] / "hnf_blender"
LOOKED_UP = {"tr": 0, "fail_poll": 1}
"""Functions whose text is translated, and which argument it is."""
LAYOUT_CALLS = {"label", "operator", "prop", "menu", "popover", "operator_menu_enum", "progress"}
"""Functions of a layout that show a text."""
LABEL_MAKERS = {
    *("describe_state", "describe_material", "format_counts", "find_first_step", "list_outputs"),
    *("draw_remark", "draw_missing_scale"),
}
"""Functions whose translated texts are all labels, which another function draws."""


def strings_of_classes(classes: Iterable[Any]) -> set[str]:
    """Labels and tooltips of classes, their properties and enum items."""
    found = labels_of_classes(classes)
    for each in classes:
        found.add(getattr(each, "bl_description", ""))
        for prop in _own_properties(each):
            found.add(prop.description)
            found |= {item.description for item in prop.enum_items} if prop.type == "ENUM" else set()
    return found - {""}


def _own_properties(each: Any) -> Iterator[Any]:
    """Properties that a class declares and shows."""
    rna = each.bl_rna
    if issubclass(each, bpy.types.Operator):
        module, name = each.bl_idname.split(".")
        rna = getattr(getattr(bpy.ops, module), name).get_rna_type()
    own = {name for base in each.__mro__ for name in vars(base).get("__annotations__", {})}
    return (prop for prop in rna.properties if prop.identifier in own and not prop.is_hidden)


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
            if name in LAYOUT_CALLS:
                shown = {word.arg: word.value for word in node.keywords}
                translated = shown.get("translate")
                if "text" in shown and not (isinstance(translated, ast.Constant) and translated.value is False):
                    found |= _literals(shown["text"])
    return {text for text in found if any(letter.isalpha() for letter in text)}


def labels_of_classes(classes: Iterable[Any]) -> set[str]:
    """Names of classes, of their shown properties and of enum items: all of it Title Case, without tooltips."""
    found = {label for each in classes if isinstance(label := getattr(each, "bl_label", ""), str)}
    for each in classes:
        for prop in _own_properties(each):
            found.add(prop.name)
            found |= {item.name for item in prop.enum_items} if prop.type == "ENUM" else set()
    return found - {""}


def labels_of_sources() -> set[str]:
    """Literals on buttons, properties, menus, popovers and labels, given as they are or through tr()."""
    found: set[str] = set()
    for path in sorted(ADDON.rglob("*.py")):
        for scope in _functions(ast.parse(path.read_text(encoding="utf-8"))):
            assigned = {
                node.targets[0].id: node.value
                for node in ast.walk(scope)
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
            }
            for node in ast.walk(scope):
                if scope.name in LABEL_MAKERS and isinstance(node, ast.Call):
                    found |= _shown_literals(node)
                if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in LAYOUT_CALLS:
                    text = next((word.value for word in node.keywords if word.arg == "text"), None)
                    text = assigned.get(getattr(text, "id", ""), text)
                    found |= _shown_literals(text) if text is not None else set()
    return {text for text in found if any(letter.isalpha() for letter in text)}


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def _shown_literals(node: ast.expr) -> set[str]:
    """Literals of an expression; those given to tr() and to format() of it, too."""
    if isinstance(node, ast.Call):
        inner = node.func.value if getattr(node.func, "attr", "") == "format" else next(iter(node.args), node.func)
        is_text = getattr(node.func, "attr", "") == "format" or getattr(node.func, "id", "") == "tr"
        return _shown_literals(inner) if is_text else set()
    if isinstance(node, ast.IfExp):
        return _shown_literals(node.body) | _shown_literals(node.orelse)
    return _literals(node)


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
