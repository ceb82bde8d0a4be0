"""Stroke tool in the toolbar of the 3D view, and the entries of the add-on in Blender's own menus.

The tool has its icon and keymap; the entries are Add > Touch Stroke, the context menu of objects, the popover of the
viewport's overlays, and File > Import.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..actuator.actuator_state import SPEAKERS, get_selected_output
from ..ops.draw_ops import draw_style
from ..state.addon_settings import get_settings

ICON = Path(__file__).resolve().parent / "data" / "hnf.stroke"
"""Icon file without its suffix .dat, as Blender expects it; made by tools/make_tool_icon.py."""

KEYMAP = "3D View Tool: Object, Touch Stroke"
"""Name that Blender gives to the tool's keymap."""


class HNF_TOOL_stroke(bpy.types.WorkSpaceTool):  # type: ignore[misc]  # bpy has no types
    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"
    bl_idname = "hnf.stroke"
    bl_label = "Touch Stroke"
    bl_description = (
        "Stroke a surface: drag over it with a pen or the mouse. Pressure becomes force in newtons, timing becomes "
        "speed in mm/s. "
        "Ctrl click selects"
    )
    bl_icon = str(ICON)
    bl_cursor = "PAINT_BRUSH"
    bl_operator = "hnf.stroke_draw"
    bl_keymap = (
        (
            "hnf.stroke_draw",
            {"type": "LEFTMOUSE", "value": "PRESS"},
            {"properties": [("wait_for_input", False)]},
        ),
        (
            "view3d.select",
            {"type": "LEFTMOUSE", "value": "PRESS", "ctrl": True},
            {"properties": [("deselect_all", True)]},
        ),
    )

    @staticmethod
    def draw_settings(context: Any, layout: Any, tool: Any) -> None:
        draw_style(layout, tool.operator_properties("hnf.stroke_draw"))
        if get_selected_output(context) != SPEAKERS:
            layout.operator("hnf.live_touch", text="Live Touch", icon="BRUSH_DATA")


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
    """Draw the entries of File > Import, which do what a drop on the 3D view does."""
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


_keymap_items: list[tuple[Any, Any]] = []
"""Keymaps with the items that were added to them."""


def _add_keys() -> None:
    """Let a press on the picture of the Touch tab scrub; its operator leaves all other presses alone."""
    config = bpy.context.window_manager.keyconfigs.addon
    if config is not None:
        keymap = config.keymaps.new("3D View Generic", space_type="VIEW_3D")
        _keymap_items.append((keymap, keymap.keymap_items.new("hnf.scrub", "LEFTMOUSE", "PRESS")))


def _remove_keys() -> None:
    for keymap, item in _keymap_items:
        keymap.keymap_items.remove(item)
    _keymap_items.clear()


def register() -> None:
    _add_keys()
    bpy.utils.register_tool(HNF_TOOL_stroke, after={"builtin.measure"}, separator=True)
    for menu, entry in MENU_ENTRIES:
        getattr(bpy.types, menu).append(entry)


def unregister() -> None:
    _remove_keys()
    for menu, entry in reversed(MENU_ENTRIES):
        getattr(bpy.types, menu).remove(entry)
    bpy.utils.unregister_tool(HNF_TOOL_stroke)
    # Blender removes the tool's keymap from its own and the add-ons' key configuration, but not from the merged one.
    merged = bpy.context.window_manager.keyconfigs.user
    for keymap in [keymap for keymap in merged.keymaps if keymap.name == KEYMAP]:
        merged.keymaps.remove(keymap)
