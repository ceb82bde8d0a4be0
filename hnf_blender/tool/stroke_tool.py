"""Stroke tool in the toolbar of the 3-D view, with its icon and keymap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..actuator.actuator_state import SPEAKERS, get_selected_output
from ..ops.draw_ops import draw_style

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


def register() -> None:
    bpy.utils.register_tool(HNF_TOOL_stroke, after={"builtin.measure"}, separator=True)


def unregister() -> None:
    bpy.utils.unregister_tool(HNF_TOOL_stroke)
    # Blender removes the tool's keymap from its own and the add-ons' key configuration, but not from the merged one.
    merged = bpy.context.window_manager.keyconfigs.user
    for keymap in [keymap for keymap in merged.keymaps if keymap.name == KEYMAP]:
        merged.keymaps.remove(keymap)
