"""One place: what was found where the artist clicked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from ..ops.materials import spoken
from ..state.session import STATE
from ..state.texts import factor_text, height_text, reason_text, routes_lines, stiffness_text, sure_text
from ..translations import tr
from .layout import TouchPanel, named, paragraph
from .preview_panel import picture_units

if TYPE_CHECKING:
    from ..state.probe import ProbeView

LARGEST = 9.0
"""Units of Blender's interface: the picture is looked at, not worked on."""


class HNF_PT_probe(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "One Place"
    bl_parent_id = "HNF_PT_materials"

    def draw(self, context: Any) -> None:
        layout, view = self.layout, STATE.probe
        layout.operator("hnf.probe", text="Examine a Place", icon="EYEDROPPER")
        if view is not None and view.scene in ("", context.scene.name):
            draw_found(layout, context, view)


def draw_found(layout: Any, context: Any, view: ProbeView) -> None:
    """Everything that is known of the place."""
    layout.label(text=named(context, view.object_name), icon="OBJECT_DATA", translate=False)
    if view.icon:
        size = picture_units(context.region.width, float(context.preferences.system.ui_scale))
        layout.template_icon(icon_value=view.icon, scale=min(size, LARGEST))
    column = layout.column(align=True)
    paragraph(column, context, f"{spoken(view.library_material)}, {sure_text(view.confidence)}", icon="MATERIAL")
    paragraph(column, context, tr("Why: {reason}").format(reason=reason_text(view.reason)), icon="BLANK1")
    rough = tr("Roughness: {height} RMS").format(height=height_text(view.roughness_m))
    paragraph(column, context, rough, icon="RNDCURVE")
    friction = tr("Friction: about {value} ({range})").format(
        value=f"{view.friction:.2f}", range=factor_text(view.friction, view.friction_factor, "{:.2f}")
    )
    paragraph(column, context, friction, icon="FORCE_DRAG")
    paragraph(column, context, stiffness_text(view.stiffness_n_m, view.stiffness_factor), icon="CON_FLOOR")
    paragraph(column, context, tr("Friction and stiffness are estimates from the material, not seen"), icon="INFO")
    for line in routes_lines(view.routes):
        paragraph(column, context, line, icon="BLANK1")
    draw_nearest(layout, context, view)
    for note in view.notes:
        paragraph(layout, context, note, icon="ERROR")


def draw_nearest(layout: Any, context: Any, view: ProbeView) -> None:
    """The nearest library materials, to be chosen with a click; nothing is chosen unasked."""
    if not view.nearest:
        return
    seen = view.seen_m is not None
    column = layout.column(align=True)
    said = (
        tr("Closest materials by relief (0 = identical)") if seen else tr("Most likely materials (no relief was seen)")
    )
    paragraph(column, context, said, icon="INFO")
    for near in view.nearest:
        how = f"{round(100 * near.confidence)} %" if near.distance is None else f"{near.distance:.2f}"
        text = f"{spoken(near.name)}  {how}"
        if view.material_full:
            choose = column.operator("hnf.material_choose", text=text, translate=False)
            choose.material, choose.name = view.material_full, near.name
        else:
            column.label(text=text, translate=False)


CLASSES = (HNF_PT_probe,)
