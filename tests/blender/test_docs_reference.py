"""docs/blender.md names every panel, button and property of the add-on; docs/troubleshooting.md what greys a button."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

from hnf_blender import ops, ui
from hnf_blender.prefs import HnfPreferences
from hnf_blender.props.material_settings import HnfMaterial
from hnf_blender.props.scene_settings import HnfScene
from hnf_blender.props.stroke_settings import HnfStroke
from hnf_blender.registration import collect_classes
from hnf_blender.state.labels import PLAN_LABELS, ROUTE_LABELS, STATUS_LABELS
from hnf_blender.touch.session import CHANGE_DESCRIPTIONS as CHANGES
from hnf_blender.touch.session import TOUCH_FIELD

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = (ROOT / "docs" / "blender.md").read_text(encoding="utf-8")
HELP = " ".join((ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8").split())
CODE = set(re.findall(r"`([^`\n]+)`", REFERENCE))
WORDS = {word.rpartition(".")[2] for word in CODE}
"""Last parts of what is set in code: "force" of `object.hnf_stroke.force`."""


def shown_properties(owner: Any) -> list[str]:
    """Names of the properties of a class that are not hidden."""
    return [
        name
        for base in owner.__mro__
        for name, made in vars(base).get("__annotations__", {}).items()
        if hasattr(made, "keywords") and not {"HIDDEN"} & set(made.keywords.get("options", ()))
    ]


def test_every_operator_and_its_properties() -> None:
    operators = [
        each for each in collect_classes("hnf_blender.ops", ops.MODULES) if issubclass(each, bpy.types.Operator)
    ]
    assert len(operators) > 25
    assert [each.bl_idname for each in operators if each.bl_idname not in CODE] == []
    told = [(each.bl_idname, name) for each in operators for name in shown_properties(each)]
    assert [pair for pair in told if pair[1] not in WORDS] == []


@pytest.mark.parametrize("group", [HnfStroke, HnfScene, HnfMaterial, HnfPreferences], ids=lambda each: each.__name__)
def test_every_property(group: Any) -> None:
    index = {"stroke_index"}  # of the list, as every list has one
    assert [name for name in group.__annotations__ if name not in WORDS | index] == []


def test_every_panel_has_its_heading_or_its_name_in_bold() -> None:
    panels = [each for each in collect_classes("hnf_blender.ui", ui.MODULES) if issubclass(each, bpy.types.Panel)]
    assert len(panels) > 10
    titles = set(re.findall(r"^#+ (.+)$", REFERENCE, re.MULTILINE)) | set(re.findall(r"\*\*([^*\n]+)\*\*", REFERENCE))
    assert [each.bl_label for each in panels if each.bl_label not in titles] == []


def test_every_word_for_a_state() -> None:
    both = REFERENCE + HELP
    said = (
        [text for _, text in STATUS_LABELS.values()]
        + [text for _, text in PLAN_LABELS.values()]
        + list(ROUTE_LABELS.values())
    )
    assert [text for text in said if text not in both] == []
    assert [text for part, text in CHANGES.items() if part != TOUCH_FIELD and text not in HELP] == []


def reasons() -> Iterator[str]:
    """Every literal sentence that poll() gives for a greyed button."""
    for path in sorted((ROOT / "hnf_blender").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        named = {
            target.id: node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "fail_poll":
                given = named.get(getattr(node.args[1], "id", ""), node.args[1])
                yield from (
                    part.value
                    for part in ast.walk(given)
                    if isinstance(part, ast.Constant) and isinstance(part.value, str)
                )


def test_every_reason_for_a_greyed_button() -> None:
    found = set(reasons())
    assert len(found) > 20
    assert sorted(reason for reason in found if reason not in HELP) == []
