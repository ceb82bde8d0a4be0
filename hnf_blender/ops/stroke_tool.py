"""Take the stroke tool from the tab."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from .greyed import fail_poll

TOOL_ID = "hnf.stroke"
"""bl_idname of the tool (tool/stroke_tool.py)."""


class HNF_OT_stroke_tool(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_idname = "hnf.stroke_tool"
    bl_label = "Stroke Tool"
    bl_description = "Switch to the tool that draws strokes: drag over a surface with a pen or the mouse"
    bl_options = frozenset[str]()  # taking a tool is nothing to undo

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Strokes are drawn in Object Mode: press Tab")
        if context.area is None or context.area.type != "VIEW_3D":
            return fail_poll(cls, "Strokes are drawn in a 3-D view")
        return True

    def execute(self, _context: Any) -> set[str]:
        return set(bpy.ops.wm.tool_set_by_id(name=TOOL_ID))


TOOL_CLASSES = (HNF_OT_stroke_tool,)
