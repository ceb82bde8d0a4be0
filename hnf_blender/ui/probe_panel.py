"""One place: what was found where the artist clicked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from ..ops.materials import format_display_name
from ..state.session import STATE
from ..state.texts import (
    format_confidence,
    format_factor_range,
    format_height,
    format_reason,
    format_routes,
    format_stiffness,
)
from ..translations import tr
from .layout import TouchPanel, draw_paragraph, shorten_name
from .preview_panel import compute_image_size

if TYPE_CHECKING:
    from ..state.probe import QueryView

MAX_IMAGE_UNITS = 9.0
"""Units of Blender's interface: the picture is looked at, not worked on."""


class HNF_PT_probe(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "One Place"
    bl_parent_id = "HNF_PT_materials"

    def draw(self, context: Any) -> None:
        layout, view = self.layout, STATE.query_view
        layout.operator("hnf.probe", text="Examine a Place", icon="EYEDROPPER")
        if view is not None and view.scene in ("", context.scene.name):
            draw_query_result(layout, context, view)


def draw_query_result(layout: Any, context: Any, view: QueryView) -> None:
    """Everything that is known of the place."""
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
    draw_paragraph(column, context, tr("Why: {reason}").format(reason=format_reason(view.reason)), icon="BLANK1")
    rough = tr("Roughness: {height} RMS").format(height=format_height(view.roughness_m))
    draw_paragraph(column, context, rough, icon="RNDCURVE")
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


def draw_nearest(layout: Any, context: Any, view: QueryView) -> None:
    """The nearest library materials, to be chosen with a click; nothing is chosen unasked."""
    if not view.nearest:
        return
    seen = view.seen_m is not None
    column = layout.column(align=True)
    said = (
        tr("Closest materials by relief (0 = identical)") if seen else tr("Most likely materials (no relief was seen)")
    )
    draw_paragraph(column, context, said, icon="INFO")
    for near in view.nearest:
        how = f"{round(100 * near.confidence)} %" if near.distance is None else f"{near.distance:.2f}"
        text = f"{format_display_name(near.name)}  {how}"
        if view.material_full:
            choose = column.operator("hnf.material_choose", text=text, translate=False)
            choose.material, choose.name = view.material_full, near.name
        else:
            column.label(text=text, translate=False)


QUERY_CLASSES = (HNF_PT_probe,)
