"""The list of strokes and the menu of ready ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy

from hnf_core.action.primitives import PRIMITIVES

from ..props.listed import STROKES
from ..props.scene import list_cached_strokes
from ..state.session import STATE
from ..state.texts import describe_status, shorten_text
from ..translations import tr
from .layout import compute_line_width, count_line_characters

NAME_SHARE, MIN_SHARE = 0.74, 0.3
"""Of a row of the list, at the most and at the least; the rest is for solo and mute."""
SWITCHES_PX = 46.0
"""Solo and mute beside each other, at resolution scale 1; with less they are drawn over each other."""
PRIMITIVE_ICONS = {"scrape": "IPO_LINEAR", "rub": "FORCE_VORTEX"}


def format_primitive(name: str) -> str:
    """ "left-right-soft" → "Left right soft  0.5 N, 100 mm/s"."""
    primitive = PRIMITIVES[name]
    label = tr(name.replace("-", " ").capitalize())
    return f"{label}  {primitive.force:g} N, {primitive.speed * 1e3:g} mm/s"


class HNF_MT_stroke_add(bpy.types.Menu):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_label = "Add Stroke"

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        for name, primitive in PRIMITIVES.items():
            icon = PRIMITIVE_ICONS[primitive.kind]
            layout.operator("hnf.stroke_add", text=format_primitive(name), icon=icon, translate=False).primitive = name
        layout.separator()
        layout.operator("hnf.stroke_from_curve", text="From the Selected Curve", icon="OUTLINER_OB_CURVE")


class HNF_UL_strokes(bpy.types.UIList):  # type: ignore[misc]  # noqa: N801
    """Strokes with the state of their bake; a click selects the stroke in the scene too."""

    def draw_item(
        self, context: Any, layout: Any, _data: Any, obj: Any, _icon: int, _active_data: Any, _active: str, _index: int
    ) -> None:
        status = STATE.get_status(context.scene, obj)
        share = compute_name_share(compute_line_width(context))
        row = layout.split(factor=share)
        row.active = not obj.hnf_stroke.mute
        name = row.row(align=True)
        name.alignment = "LEFT"
        select = name.operator(
            "hnf.stroke_select",
            text=shorten_text(obj.name, max(4, int(share * count_line_characters(context)) - 6)),
            icon=describe_status(status)[0],
            emboss=False,
            translate=False,
        )
        select.name = obj.name_full
        switches = row.row(align=True)
        switches.alignment = "RIGHT"
        solo = "SOLO_ON" if is_solo(context.scene, obj) else "SOLO_OFF"
        switches.operator("hnf.stroke_solo", text="", icon=solo, emboss=False).name = obj.name_full
        mute = "MUTE_IPO_ON" if obj.hnf_stroke.mute else "MUTE_IPO_OFF"
        switches.prop(obj.hnf_stroke, "mute", text="", icon=mute, emboss=False)

    def filter_items(self, _context: Any, data: Any, name: str) -> tuple[list[int], list[int]]:
        """The scene's strokes, those whose name matches what is searched for, sorted by name."""
        numbered, wanted = STROKES.list_indexed(data), self.filter_name.lower()
        shown = [0] * len(getattr(data, name))
        for at, obj in numbered:
            if wanted in obj.name.lower():
                shown[at] = self.bitflag_filter_item
        return shown, compute_order([obj.name.lower() for _, obj in numbered], [at for at, _ in numbered], len(shown))


def compute_order(names: Sequence[str], indices: Sequence[int], count: int) -> list[int]:
    """For each of count places its new one: the named ones sorted in front, all others behind as they were.

    names: of those at places, which ascend. Blender's own sorts every object of the scene by its name, at each redraw.
    """
    order, begin, behind = [0] * count, 0, len(indices)
    for end in (*indices, count):
        order[begin:end] = range(behind, behind + end - begin)
        begin, behind = end + 1, behind + end - begin
    for rank, index in enumerate(sorted(range(len(indices)), key=names.__getitem__)):
        order[indices[index]] = rank
    return order


def compute_name_share(row_px: float) -> float:
    """Of a row so wide: what the name gets, so that solo and mute have their room."""
    return max(MIN_SHARE, min(NAME_SHARE, 1.0 - SWITCHES_PX / max(row_px, SWITCHES_PX)))


def is_solo(scene: Any, stroke: Any) -> bool:
    """Is it the only stroke of several that is not muted?"""
    if stroke.hnf_stroke.mute:
        return False
    others = (obj.hnf_stroke.mute for obj in list_cached_strokes(scene) if obj != stroke)
    return bool(next(others, False)) and all(others)


LIST_CLASSES = (HNF_MT_stroke_add, HNF_UL_strokes)
