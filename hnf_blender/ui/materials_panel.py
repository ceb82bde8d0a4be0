"""Materials: what each slot feels like, who decided, and what else it could be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from ..ops.materials import felt_object, spoken
from ..ops.outside_python import python_path
from ..props.material import OWN_DEFINITION, OWN_NAME
from ..state.session import STATE, shown_name
from ..state.texts import reason_text, routes_lines, sure_text
from ..touch.status import StrokeStatus
from ..translations import tr
from .layout import TouchPanel, hint, named, paragraph, side_by_side

MOST_SUGGESTIONS, MOST_BAKES = 4, 5


def felt_text(material: Any) -> tuple[str, str]:
    """Icon and words of what a Blender material is taken to feel like."""
    if material.hnf_touch.library:
        return "LOCKED", spoken(material.hnf_touch.library)
    if OWN_DEFINITION in material:
        return "LOCKED", str(material.get(OWN_NAME) or tr("Own (.hnf)"))
    ranked = STATE.suggestions.get(material.name_full)
    if ranked:
        return "UNLOCKED", f"{spoken(ranked[0].name)} ({sure_text(ranked[0].confidence)})"
    baked = next((each for each in every_status() if each.shader == material.name), None)
    if baked is not None and baked.library_material:
        return "UNLOCKED", f"{spoken(baked.library_material)} ({tr('as baked')})"
    return "UNLOCKED", tr("Automatic at bake")


def every_status() -> Iterator[StrokeStatus]:
    """Of the strokes of all scenes: a material may be used in any."""
    return (status for statuses in STATE.statuses.values() for status in statuses.values())


def bakes_on(scene: Any, obj: Any) -> list[tuple[str, StrokeStatus]]:
    """A scene's strokes that are baked on an object, by name."""
    object_name = shown_name(scene, obj)
    return sorted(
        (name, status)
        for name, status in STATE.strokes_in(scene).items()
        if status.object_name == object_name and status.library_material
    )


class HNF_UL_slots(bpy.types.UIList):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    """Material slots with what each feels like."""

    def draw_item(
        self, context: Any, layout: Any, _data: Any, slot: Any, icon: int, _active_data: Any, _active: str, _index: int
    ) -> None:
        if slot.material is None:
            layout.label(text="Empty slot", icon="MATERIAL")
            return
        row = layout.row()
        row.label(text=named(context, slot.material.name, taken=18), icon_value=icon, translate=False)
        lock, felt = felt_text(slot.material)
        row.label(text=felt, icon=lock, translate=False)


class HNF_PT_materials(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "Materials"
    bl_order = 1

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, felt_object(context)
        if obj is None:
            hint(layout, context, tr("Select a mesh or a stroke to see what its materials feel like"))
            draw_learn(layout)
            return
        layout.label(text=named(context, obj.name), icon="OBJECT_DATA", translate=False)
        if len(obj.material_slots) > 1:
            layout.template_list(
                "HNF_UL_slots", "", obj, "material_slots", obj, "active_material_index", rows=3, maxrows=6
            )
        material = obj.active_material
        if material is None:
            hint(layout, context, tr("No material in this slot: its feel is guessed from names alone"))
        else:
            draw_material(layout, context, material)
        draw_learn(layout)


def draw_learn(layout: Any) -> None:
    """The button that learns a material; not for those who named no Python for it, as it would only be grey."""
    if python_path():
        layout.operator("hnf.learn", icon="REC")


def draw_material(layout: Any, context: Any, material: Any) -> None:
    """One material: its word, the artist's lock, the suggestions."""
    icon, felt = felt_text(material)
    box = layout.box()
    box.label(text=named(context, material.name), icon="MATERIAL", translate=False)
    row = box.row(align=True)
    row.label(text=felt, icon=icon, translate=False)
    if icon == "LOCKED":
        row.operator("hnf.material_auto", text="Automatic", icon="LOOP_BACK").material = material.name_full
    column = box.column(align=True)
    ranked = STATE.suggestions.get(material.name_full, ())[:MOST_SUGGESTIONS]
    for suggestion in ranked:
        text = f"{spoken(suggestion.name)}  {round(100 * suggestion.confidence)} %"
        choose = column.operator(
            "hnf.material_choose", text=text, translate=False,
            depress=material.hnf_touch.library == suggestion.name,
        )  # fmt: skip
        choose.material, choose.name = material.name_full, suggestion.name
    if ranked:
        paragraph(box, context, tr("Why: {reason}").format(reason=reason_text(ranked[0].reason)), icon="INFO")
    row = side_by_side(box, context)
    row.operator("hnf.suggest", text="Suggest", icon="LIGHT")
    row.operator("hnf.material_choose", text="Choose…", icon="VIEWZOOM").material = material.name_full
    row.operator("hnf.import_material", text="File…", icon="FILE_FOLDER")


def alike(bakes: list[tuple[str, StrokeStatus]]) -> list[tuple[list[str], StrokeStatus]]:
    """Names of the strokes on one slot that were baked with one material by the same routes, and a status of theirs, in
    the order of the first of each."""
    found: dict[tuple[str, ...], tuple[list[str], StrokeStatus]] = {}
    for name, status in bakes:  # alike is what reads alike: confidences differ from stroke to stroke
        told = status.shader, status.library_material, sure_text(status.confidence), status.routes
        found.setdefault(told, ([], status))[0].append(name)
    return list(found.values())


class HNF_PT_as_baked(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "As Baked"
    bl_parent_id = "HNF_PT_materials"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012  # Blender reads a set

    @classmethod
    def poll(cls, context: Any) -> bool:
        obj = felt_object(context)
        return obj is not None and bool(bakes_on(context.scene, obj))

    def draw(self, context: Any) -> None:
        obj = felt_object(context)
        bakes = bakes_on(context.scene, obj)
        for names, status in alike(bakes[:MOST_BAKES]):
            column = self.layout.column(align=True)
            paragraph(column, context, ", ".join(named(context, name) for name in names), icon="CURVE_DATA")
            felt = f"{spoken(status.library_material)}, {sure_text(status.confidence)}"
            shader = f"{named(context, status.shader, taken=6)}: " if status.shader else ""
            paragraph(column, context, shader + felt, icon="BLANK1")
            for line in routes_lines(status.routes):
                paragraph(column, context, line, icon="BLANK1")
        if len(bakes) > MOST_BAKES:
            more = tr("and {count} more").format(count=len(bakes) - MOST_BAKES)
            self.layout.label(text=more, icon="BLANK1", translate=False)


CLASSES = (HNF_UL_slots, HNF_PT_materials, HNF_PT_as_baked)
