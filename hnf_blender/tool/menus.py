"""Entries in Blender's own menus: Add > Touch Stroke, the context menu of objects, overlays, File > Import."""

from __future__ import annotations

from typing import Any

import bpy

from ..state.addon_settings import get_settings


def draw_add_menu(self: Any, _context: Any) -> None:
    """Draw the entry of the Add menu."""
    self.layout.separator()
    self.layout.menu("HNF_MT_stroke_add", text="Touch Stroke", icon="CURVE_PATH")


def draw_object_menu(self: Any, context: Any) -> None:
    """Draw the entries of the context menu in Object Mode."""
    active = context.view_layer.objects.active
    if active is None or active.type not in {"CURVE", "MESH"}:
        return
    layout = self.layout
    layout.separator()
    if active.type == "MESH":
        layout.menu("HNF_MT_stroke_add", text="Touch Stroke", icon="CURVE_PATH")
    elif active.hnf_stroke.is_stroke:
        layout.operator("hnf.stroke_key_force", icon="KEY_HLT")
        layout.operator("hnf.force_graph", icon="GRAPH")
        layout.operator("hnf.stroke_move", icon="TIME")
        layout.operator("hnf.stroke_duplicate", icon="DUPLICATE")
        layout.operator("hnf.stroke_copy_force", icon="COPYDOWN")
        layout.operator("hnf.stroke_to_curve", icon="OUTLINER_OB_CURVE")
    else:
        layout.operator("hnf.stroke_from_curve", icon="CURVE_PATH")


def draw_overlay_switch(self: Any, context: Any) -> None:
    """Draw the switch in the popover of the viewport's overlays."""
    settings = get_settings(context)
    if isinstance(settings, bpy.types.AddonPreferences):
        self.layout.prop(settings, "overlay", text="Touch Strokes")


def draw_import_menu(self: Any, _context: Any) -> None:
    """Draw the entries of File > Import, which do what a drop on the 3-D view does."""
    self.layout.operator("hnf.import_material")
    self.layout.operator("hnf.import_sound")
    self.layout.operator("hnf.import_splats")


MENU_ENTRIES = (
    ("VIEW3D_MT_add", draw_add_menu),
    ("VIEW3D_MT_object_context_menu", draw_object_menu),
    ("VIEW3D_PT_overlay", draw_overlay_switch),
    ("TOPBAR_MT_file_import", draw_import_menu),
)
"""Blender's menus and panels, and the function that draws at the end of each."""


def register() -> None:
    for menu, entry in MENU_ENTRIES:
        getattr(bpy.types, menu).append(entry)


def unregister() -> None:
    for menu, entry in reversed(MENU_ENTRIES):
        getattr(bpy.types, menu).remove(entry)
