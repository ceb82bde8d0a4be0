"""Strokes panel: list of strokes, menu of primitives, and the settings of the active stroke.

The selection in the list follows the active object of the 3D view.
"""

# No `from __future__ import annotations`: Blender reads the annotations of the list as values.

from collections.abc import Sequence
from typing import Any

import bpy

from hnf_core.action.primitives import PRIMITIVES

from .. import compat
from ..ops.material_ops import format_display_name
from ..props.object_cache import STROKES
from ..props.scene_settings import find_index, find_namesake, get_active_stroke, list_cached_strokes
from ..registration import add_handlers, remove_handlers
from ..state.labels import describe_freshness, put_surface_first
from ..state.session_state import STATE
from ..touch.bake_status import StrokeStatus
from ..translations import tr
from .layout import (
    TouchPanel,
    compute_line_width,
    draw_hint,
    draw_paragraph,
    make_button_row,
)
from .scene_panel import shows_first_step_tools

MIN_ROWS, MAX_ROWS = 3, 8
"""Smallest and largest number of rows in the list."""


class HNF_PT_strokes(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Strokes"
    bl_order = 1

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        strokes = list_cached_strokes(scene)
        if not shows_first_step_tools(context):
            row = make_button_row(layout, context)
            row.operator("hnf.stroke_tool", icon="GREASEPENCIL")
            row.menu("HNF_MT_stroke_add", text="Ready Strokes")  # An icon would cut it in a usual sidebar.
            row.operator("hnf.live_touch", text="", icon="BRUSH_DATA")
        if not strokes:
            draw_hint(
                layout,
                context,
                tr(
                    "Take the Stroke Tool and drag over a surface: pen pressure becomes force. Or lay one of the Ready "
                    "Strokes on the selected mesh"
                ),
            )
            return
        row = layout.row()
        rows = min(max(len(strokes), MIN_ROWS), MAX_ROWS)
        row.template_list("HNF_UL_strokes", "", scene, "objects", scene.hnf, "stroke_index", rows=rows)
        buttons = row.column(align=True)
        buttons.operator("hnf.stroke_duplicate", text="", icon="DUPLICATE")
        buttons.operator("hnf.stroke_to_curve", text="", icon="OUTLINER_OB_CURVE")
        buttons.operator("hnf.stroke_delete", text="", icon="REMOVE")
        stroke = get_active_stroke(context)
        if stroke is None:
            draw_hint(layout, context, tr("Click a stroke to see what it is made of"))


class ActiveStrokePanel(TouchPanel):
    """Base of panels about the active stroke."""

    bl_parent_id = "HNF_PT_strokes"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return get_active_stroke(context) is not None


class HNF_PT_stroke(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Active Stroke"

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        group = stroke.hnf_stroke
        if find_namesake(context.scene, stroke) is not None:
            draw_paragraph(
                layout,
                context,
                tr("A linked stroke has the same name, and the other one may be shown instead. Rename yours"),
                icon="ERROR",
            )
        layout.use_property_split = True
        column = layout.column()
        column.use_property_decorate = False
        column.prop(group, "surface")
        if group.surface is None:
            make_labelled_row(column, "").label(text="Each Object Under It")
        column.prop(group, "rides")
        column.prop(group, "probe")
        row = make_labelled_row(column, "Feels")
        material_label = format_display_name(group.material) if group.material else tr("Surface Material")
        row.operator("hnf.stroke_material", text=material_label, icon="MATERIAL", translate=False)
        if group.material:
            row.operator("hnf.stroke_material_auto", text="", icon="X")
        row = layout.row(align=True)
        row.prop(group, "force", text="Force (N)")
        row.operator("hnf.force_graph", text="", icon="GRAPH")
        row.operator("hnf.stroke_copy_force", text="", icon="COPYDOWN")


class HNF_PT_stroke_time(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Time and Seed"
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        group, keyed = stroke.hnf_stroke, is_keyed(stroke, "progress")
        layout.use_property_split = True
        column = layout.column()
        column.use_property_decorate = False
        if keyed or is_keyed(stroke, "force"):  # Editing the number alone would not move the keys.
            row = make_labelled_row(column, "Start")
            row.operator("hnf.stroke_move", text=tr("Frame {frame}…").format(frame=f"{group.start:g}"), translate=False)
        else:
            column.prop(group, "start")
        make_labelled_row(column, "").operator("hnf.stroke_after_last")
        if keyed:
            draw_paragraph(column, context, tr("Progress keys control the timing"), icon="KEY_HLT")
        else:
            column.prop(group, "law")
            if group.law == "SPEED":
                column.prop(group, "speed_mm_s", text="Speed (mm/s)")
            elif group.law == "DURATION":
                column.prop(group, "duration_s", text="Duration (s)")
            else:
                draw_paragraph(column, context, tr("Key progress at two frames at least"), icon="INFO")
        if keyed or group.law == "PROGRESS":
            layout.prop(group, "progress")
        column = layout.column()
        column.use_property_decorate = False
        column.prop(group, "seed")


def make_labelled_row(layout: Any, text: str) -> Any:
    """Return a row for buttons behind a label aligned with those of properties."""
    split = layout.split(factor=0.4)
    label = split.row()
    label.alignment = "RIGHT"
    label.label(text=text)
    return split.row(align=True)


def is_keyed(obj: Any, name: str) -> bool:
    """Return whether a property of hnf_stroke has keyframes."""
    path = f"hnf_stroke.{name}"
    return any(fcurve.data_path == path and not fcurve.is_empty for fcurve in compat.fcurves_of(obj))


NAME_SHARE, MIN_SHARE = 0.74, 0.3
"""Largest and smallest fraction of a list row for the name; the rest is for solo and mute."""
SWITCHES_PX = 46.0
"""Width of the solo and mute buttons at resolution scale 1; below it they overlap [px]."""
PRIMITIVE_ICONS = {"scrape": "IPO_LINEAR", "rub": "FORCE_VORTEX"}
"""Icons of the kinds of primitives."""


def format_primitive(name: str) -> str:
    """Format a primitive (predefined stroke) for the menu: "left-right-soft" → "Left right soft 0.5 N, 100 mm/s"."""
    primitive = PRIMITIVES[name]
    label = tr(name.replace("-", " ").title())
    return f"{label}  {primitive.force:g} N, {primitive.speed * 1e3:g} mm/s"


class HNF_MT_stroke_add(bpy.types.Menu):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_label = "Add Stroke"

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        for name, primitive in PRIMITIVES.items():
            icon = PRIMITIVE_ICONS[primitive.kind]
            layout.operator("hnf.stroke_add", text=format_primitive(name), icon=icon, translate=False).primitive = name
        layout.separator()
        layout.operator("hnf.stroke_add", text="In Words…", icon="OUTLINER_OB_FONT").dialog = True
        layout.operator("hnf.stroke_from_curve", text="From the Selected Curve", icon="OUTLINER_OB_CURVE")


ORDER_ITEMS = (
    ("SURFACE", "Surface", "By surface, then by name", "OBJECT_DATA", 0),
    ("START", "Start", "By the frame at which each begins", "TIME", 1),
)


class HNF_UL_strokes(bpy.types.UIList):  # type: ignore[misc]
    """List of strokes with the state of their bake; a click selects the stroke in the scene too."""

    order: bpy.props.EnumProperty(name="Order", description="What the list is sorted by", items=ORDER_ITEMS)

    def draw_filter(self, _context: Any, layout: Any) -> None:
        row = layout.row(align=True)
        row.prop(self, "filter_name", text="", icon="VIEWZOOM")
        row.prop(self, "order", text="", icon_only=True)
        row.prop(self, "use_filter_sort_reverse", text="", icon="SORT_DESC")

    def draw_item(
        self, context: Any, layout: Any, _data: Any, obj: Any, _icon: int, _active_data: Any, _active: str, _index: int
    ) -> None:
        status = STATE.get_status(context.scene, obj)
        name_fraction = compute_name_share(compute_line_width(context))
        row = layout.split(factor=name_fraction)
        row.active = not obj.hnf_stroke.mute
        name = row.row(align=True)
        name.alignment = "LEFT"
        select = name.operator(
            "hnf.stroke_select",
            text=format_listed_name(obj, status),  # Blender cuts what is too long, at its end
            icon=describe_freshness(status)[0],
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
        """Return the flags and the order of the scene's strokes.

        Shown are those whose name or surface matches, sorted by what is listed, which begins with the surface, or by
        their start.
        """
        numbered, query = STROKES.list_indexed(data), self.filter_name.lower()
        shown = [0] * len(getattr(data, name))
        keys: list[Any] = []
        for index, obj in numbered:
            listed, surface = format_listed_name(obj, None).lower(), obj.hnf_stroke.surface
            if query in f"{obj.name}\n{listed}\n{'' if surface is None else surface.name}".lower():
                shown[index] = self.bitflag_filter_item
            keys.append((float(obj.hnf_stroke.start), listed) if self.order == "START" else listed)
        return shown, compute_order(keys, [index for index, _ in numbered], len(shown))


def format_listed_name(obj: Any, status: StrokeStatus | None) -> str:
    """Return a stroke's name for the list, which begins with its surface."""
    surface = obj.hnf_stroke.surface
    return put_surface_first(obj.name, surface.name if surface is not None else status.object_name if status else "")


def compute_order(keys: Sequence[Any], indices: Sequence[int], count: int) -> list[int]:
    """Return the new index of each of `count` objects: those with keys sorted first, all others after them.

    The others keep their order. The list of strokes uses it, since Blender's own sort would sort all objects of the
    scene at each redraw.

    Parameters
    ----------
    keys : sequence
        What the objects at `indices` are sorted by.
    indices : sequence of int
        Ascending indices of the sorted objects.
    count : int
        Number of all objects.
    """
    order, begin, next_index = [0] * count, 0, len(indices)
    for end in (*indices, count):
        order[begin:end] = range(next_index, next_index + end - begin)
        begin, next_index = end + 1, next_index + end - begin
    for rank, index in enumerate(sorted(range(len(indices)), key=keys.__getitem__)):
        order[indices[index]] = rank
    return order


def compute_name_share(row_px: float) -> float:
    """Return the fraction of a list row of `row_px` pixels that the stroke's name gets."""
    return max(MIN_SHARE, min(NAME_SHARE, 1.0 - SWITCHES_PX / max(row_px, SWITCHES_PX)))


def is_solo(scene: Any, stroke: Any) -> bool:
    """Return whether a stroke is the only one of several that is not muted."""
    if stroke.hnf_stroke.mute:
        return False
    other_mutes = (obj.hnf_stroke.mute for obj in list_cached_strokes(scene) if obj != stroke)
    return bool(next(other_mutes, False)) and all(other_mutes)


_MSGBUS_OWNER = object()


def sync_list_with_selection() -> None:
    """Select the active object in the list of strokes; called by Blender when the active object changes."""
    import bpy

    scene, active = bpy.context.scene, bpy.context.view_layer.objects.active
    if active is None or not active.hnf_stroke.is_stroke:
        return
    index = find_index(scene.objects, active)
    if index >= 0 and scene.hnf.stroke_index != index:
        scene.hnf.stroke_index = index


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    add_handlers(HANDLERS)
    _subscribe()


def unregister() -> None:
    import bpy

    remove_handlers(HANDLERS)
    bpy.msgbus.clear_by_owner(_MSGBUS_OWNER)


def _subscribe(*_: Any) -> None:
    """Subscribe to changes of the active object; needed again after load_post, since Blender forgets subscriptions."""
    import bpy

    bpy.msgbus.clear_by_owner(_MSGBUS_OWNER)
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"),
        owner=_MSGBUS_OWNER,
        args=(),
        notify=sync_list_with_selection,
        options={"PERSISTENT"},
    )


HANDLERS = (("load_post", _subscribe),)


CLASSES = (
    HNF_MT_stroke_add,
    HNF_UL_strokes,
    HNF_PT_strokes,
    HNF_PT_stroke,
    HNF_PT_stroke_time,
)
