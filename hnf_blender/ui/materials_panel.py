"""Materials panel: what each material slot feels like, who decided it, what else it could be, and the touch query."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import bpy

from ..ops.learn_ops import get_python_path
from ..ops.material_ops import find_material_object, format_display_name
from ..props.material_settings import DEFINITION_NAME_PROPERTY, DEFINITION_PROPERTY
from ..state.labels import (
    format_confidence,
    format_factor_range,
    format_height,
    format_reason,
    format_routes,
    format_stiffness,
)
from ..state.session_state import STATE, get_shown_name
from ..touch.bake_status import StrokeStatus
from ..translations import tr
from .layout import (
    PopoverPanel,
    TouchPanel,
    draw_height_choices,
    draw_hint,
    draw_paragraph,
    make_button_row,
    shorten_name,
)
from .preview_panel import compute_image_size

if TYPE_CHECKING:
    from ..state.job_results import QueryView

MAX_SUGGESTIONS, MAX_BAKES = 4, 5
"""Number of suggestions, and of strokes listed as baked."""
MIN_CONFIDENCE = 0.05
"""Confidence below which a suggestion is not worth its row."""


def describe_material(material: Any) -> tuple[str, str]:
    """Return icon and text of the haptic library material that a Blender material is taken for."""
    if material.hnf_touch.library:
        return "LOCKED", format_display_name(material.hnf_touch.library)
    if DEFINITION_PROPERTY in material:
        return "LOCKED", str(material.get(DEFINITION_NAME_PROPERTY) or tr("Own (.hnf)"))
    ranked = STATE.suggestions.get(material.name_full)
    if ranked:
        return "UNLOCKED", f"{format_display_name(ranked[0].name)} ({format_confidence(ranked[0].confidence)})"
    baked = next((status for status in iterate_statuses() if status.shader == material.name), None)
    if baked is not None and baked.library_material:
        return "UNLOCKED", f"{format_display_name(baked.library_material)} ({tr('As Baked')})"
    return "UNLOCKED", tr("Automatic at Bake")


def iterate_statuses() -> Iterator[StrokeStatus]:
    """Iterate over the statuses of the strokes of all scenes, since a material may be used in any."""
    return (status for statuses in STATE.statuses.values() for status in statuses.values())


def is_height_doubted(material: Any) -> bool:
    """Return True if the height of a material's relief is not believed, or the user insists on it.

    A bake or a query found it too high, or its shader states more than is believed.
    """
    view = STATE.query_view
    return (
        bool(material.hnf_touch.height_as_authored)
        or (view is not None and view.is_height_doubted and view.material == material.name)
        or any(material.name in status.doubted_shaders for status in iterate_statuses())
    )


def list_bakes(scene: Any, obj: Any) -> list[tuple[str, StrokeStatus]]:
    """Return names and statuses of a scene's strokes baked on an object, sorted by name."""
    object_name = get_shown_name(scene, obj)
    return sorted(
        (name, status)
        for name, status in STATE.get_statuses(scene).items()
        if status.object_name == object_name and status.library_material
    )


class HNF_UL_slots(bpy.types.UIList):  # type: ignore[misc]  # bpy has no types, Blender's naming
    """List of an object's material slots with what each feels like."""

    def draw_item(
        self, context: Any, layout: Any, _data: Any, slot: Any, icon: int, _active_data: Any, _active: str, _index: int
    ) -> None:
        if slot.material is None:
            layout.label(text="Empty Slot", icon="MATERIAL")
            return
        row = layout.row()
        row.label(text=shorten_name(context, slot.material.name, reserved=18), icon_value=icon, translate=False)
        lock_icon, text = describe_material(slot.material)
        row.label(text=text, icon=lock_icon, translate=False)


class HNF_PT_materials(TouchPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Materials"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, find_material_object(context)
        if obj is None:
            draw_hint(layout, context, tr("Select a mesh or a stroke to see what its materials feel like"))
            draw_popovers(layout, context, obj)
            return
        layout.label(text=shorten_name(context, obj.name), icon="OBJECT_DATA", translate=False)
        if len(obj.material_slots) > 1:
            layout.template_list(
                "HNF_UL_slots", "", obj, "material_slots", obj, "active_material_index", rows=3, maxrows=6
            )
        material = obj.active_material
        if material is None:
            draw_hint(layout, context, tr("No material in this slot: its feel is guessed from names alone"))
        else:
            draw_material(layout, context, material)
        draw_popovers(layout, context, obj)


def draw_popovers(layout: Any, context: Any, obj: Any) -> None:
    """Draw the buttons that open what is seldom needed."""
    row = make_button_row(layout, context)
    row.popover("HNF_PT_probe", text="One Place")  # Icons would cut them in a usual sidebar.
    if obj is not None and list_bakes(context.scene, obj):
        row.popover("HNF_PT_as_baked", text="As Baked")
    row.popover("HNF_PT_scale", text="Units")
    draw_learn(layout)


def draw_learn(layout: Any) -> None:
    """Draw the button that learns a material; left out if no external Python is set."""
    if get_python_path():
        layout.operator("hnf.learn", icon="REC")


def draw_material(layout: Any, context: Any, material: Any) -> None:
    """Draw a Blender material with its library material, the user's choice and the suggestions."""
    icon, text_label = describe_material(material)
    box = layout.box()
    box.label(text=shorten_name(context, material.name), icon="MATERIAL", translate=False)
    row = box.row(align=True)
    row.label(text=text_label, icon=icon, translate=False)
    if icon == "LOCKED":
        row.operator("hnf.material_auto", text="Automatic", icon="LOOP_BACK").material = material.name_full
    if is_height_doubted(material):
        box.prop(material.hnf_touch, "height_as_authored")
    column = box.column(align=True)
    ranked = STATE.suggestions.get(material.name_full, ())[:MAX_SUGGESTIONS]
    ranked = tuple(each for each in ranked if each.confidence >= MIN_CONFIDENCE)
    for suggestion in ranked:
        text = f"{format_display_name(suggestion.name)}  {round(100 * suggestion.confidence)} %"
        choose = column.operator(
            "hnf.material_choose", text=text, translate=False,
            depress=material.hnf_touch.library == suggestion.name,
        )  # fmt: skip
        choose.material, choose.name = material.name_full, suggestion.name
    if ranked:
        draw_paragraph(box, context, tr("Why: {reason}").format(reason=format_reason(ranked[0].reason)), icon="INFO")
    row = make_button_row(box, context)
    row.operator("hnf.suggest", text="Suggest", icon="LIGHT")
    row.operator("hnf.material_choose", text="Choose…", icon="VIEWZOOM").material = material.name_full
    row.operator("hnf.import_material", text="File…", icon="FILE_FOLDER")


def group_equal_bakes(bakes: list[tuple[str, StrokeStatus]]) -> list[tuple[list[str], StrokeStatus]]:
    """Group strokes whose bakes read alike: the same slot, material, confidence and routes (how the relief is known).

    Returns the names of each group and one of its statuses, in the order of first appearance.
    """
    groups: dict[tuple[str, ...], tuple[list[str], StrokeStatus]] = {}
    for name, status in bakes:  # Confidences are compared as shown, since they differ slightly.
        confidence = format_confidence(status.confidence)
        shown_facts = status.shader, status.library_material, confidence, status.likely, status.routes
        groups.setdefault(shown_facts, ([], status))[0].append(name)
    return list(groups.values())


class HNF_PT_as_baked(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "As Baked"
    bl_description = "What each stroke on this object was baked as, and how that is known"

    @classmethod
    def poll(cls, context: Any) -> bool:
        obj = find_material_object(context)
        return obj is not None and bool(list_bakes(context.scene, obj))

    def draw(self, context: Any) -> None:
        obj = find_material_object(context)
        bakes = list_bakes(context.scene, obj)
        for names, status in group_equal_bakes(bakes[:MAX_BAKES]):
            column = self.layout.column(align=True)
            draw_paragraph(column, context, ", ".join(shorten_name(context, name) for name in names), icon="CURVE_DATA")
            description = f"{format_display_name(status.library_material)}, {format_confidence(status.confidence)}"
            shader = f"{shorten_name(context, status.shader, reserved=6)}: " if status.shader else ""
            draw_paragraph(column, context, shader + description, icon="BLANK1")
            draw_likely(column, context, status.likely)
            for line in format_routes(status.routes):
                draw_paragraph(column, context, line, icon="BLANK1")
        if len(bakes) > MAX_BAKES:
            more_text = tr("{count} More").format(count=len(bakes) - MAX_BAKES)
            self.layout.label(text=more_text, icon="BLANK1", translate=False)


MAX_IMAGE_UNITS = 9.0
"""Largest size of the image of a touch query [interface units]."""


class HNF_PT_probe(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "One Place"
    bl_description = "What is felt at one spot, without a stroke"

    def draw(self, context: Any) -> None:
        layout, view = self.layout, STATE.query_view
        layout.operator("hnf.probe", text="Examine a Place", icon="EYEDROPPER")
        if view is not None and view.scene in ("", context.scene.name):
            draw_query_result(layout, context, view)


def draw_query_result(layout: Any, context: Any, view: QueryView) -> None:
    """Draw the result of a touch query."""
    layout.label(text=shorten_name(context, view.object_name), icon="OBJECT_DATA", translate=False)
    if view.icon:
        size = compute_image_size(context.region.width, float(context.preferences.system.ui_scale))
        layout.template_icon(icon_value=view.icon, scale=min(size, MAX_IMAGE_UNITS))
    column = layout.column(align=True)
    draw_paragraph(
        column,
        context,
        f"{format_display_name(view.library_material)}, {format_confidence(view.confidence)}",
        icon="MATERIAL",
    )
    draw_likely(column, context, view.likely)
    draw_paragraph(column, context, tr("Why: {reason}").format(reason=format_reason(view.reason)), icon="BLANK1")
    roughness = tr("Roughness: {height} RMS").format(height=format_height(view.roughness_m))
    draw_paragraph(column, context, roughness, icon="RNDCURVE")
    friction = tr("Friction: about {value} ({range})").format(
        value=f"{view.friction:.2f}", range=format_factor_range(view.friction, view.friction_factor, "{:.2f}")
    )
    draw_paragraph(column, context, friction, icon="FORCE_DRAG")
    draw_paragraph(column, context, format_stiffness(view.stiffness_n_m, view.stiffness_factor), icon="CON_FLOOR")
    draw_paragraph(column, context, tr("Friction and stiffness are estimates from the material, not seen"), icon="INFO")
    for line in format_routes(view.routes):
        draw_paragraph(column, context, line, icon="BLANK1")
    draw_nearest(layout, context, view)
    for note in view.notes:
        draw_paragraph(layout, context, note, icon="ERROR")
    draw_height_choices(layout, context, [view.material] if view.is_height_doubted else [])


def draw_likely(layout: Any, context: Any, likely: str) -> None:
    """Draw what a surface could be; nothing if it is felt as one material."""
    if likely:
        draw_paragraph(layout, context, tr("Could be: {materials}").format(materials=likely), icon="BLANK1")


def draw_nearest(layout: Any, context: Any, view: QueryView) -> None:
    """Draw the library materials nearest to a touch query's result as buttons that choose them."""
    if not view.nearest:
        return
    has_relief = view.seen_m is not None
    column = layout.column(align=True)
    title = (
        tr("Closest materials by relief (0 = identical)")
        if has_relief
        else tr("Most likely materials (no relief was seen)")
    )
    draw_paragraph(column, context, title, icon="INFO")
    for candidate in view.nearest:
        measure = (
            f"{round(100 * candidate.confidence)} %" if candidate.distance is None else f"{candidate.distance:.2f}"
        )
        text = f"{format_display_name(candidate.name)}  {measure}"
        if view.material_full:
            choose = column.operator("hnf.material_choose", text=text, translate=False)
            choose.material, choose.name = view.material_full, candidate.name
        else:
            column.label(text=text, translate=False)


CLASSES = (HNF_UL_slots, HNF_PT_materials, HNF_PT_as_baked, HNF_PT_probe)
