"""Diagnose: versions, paths, sizes, the last error; and how to get rid of what is kept."""

from __future__ import annotations

from typing import Any

import bpy

from ..ops.diagnose import list_versions
from ..state.session import STATE, SessionState
from ..translations import tr
from .layout import TouchPanel, draw_paragraph, make_button_row


class HNF_PT_diagnose(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "Diagnose"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout = self.layout
        column = layout.column(align=True)
        for name, value in STATE.diagnosis or list_versions():
            draw_paragraph(
                column, context, f"{tr(name)}: {value}" if name else value, icon="NONE" if name else "BLANK1"
            )
        row = make_button_row(layout, context)
        row.operator("hnf.diagnose", icon="VIEWZOOM")
        row.operator("hnf.diagnose_copy", icon="COPYDOWN")
        draw_cache(layout, STATE)
        size = dict(STATE.diagnosis).get("Baked data in this file")
        if size:
            text = tr("Remove Baked Data ({size})").format(size=size)
            layout.operator("hnf.purge", text=text, icon="TRASH", translate=False)
        else:
            layout.operator("hnf.purge", text="Remove Baked Data", icon="TRASH")


def draw_cache(layout: Any, state: SessionState) -> None:
    """The button that empties the cache, with what it frees where that was looked up."""
    size = dict(state.diagnosis).get("Cache size")
    if size:
        layout.operator(
            "hnf.cache_clear", text=tr("Clear Cache ({size})").format(size=size), icon="TRASH", translate=False
        )
    else:
        layout.operator("hnf.cache_clear", icon="TRASH")


CLASSES = (HNF_PT_diagnose,)
