"""Diagnose: versions, paths, sizes, the last error; and how to get rid of what is kept.

The external Python in the preferences: its path, what it was found to be, what to type where it lacks something.
"""

from __future__ import annotations

from typing import Any

import bpy

from ..ops.diagnose_ops import list_versions
from ..ops.learn_ops import format_python_status
from ..state.session_state import STATE, SessionState
from ..translations import tr
from .layout import TouchPanel, draw_paragraph, make_button_row


class HNF_PT_diagnose(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Diagnose"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

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


CHECK_BUTTON_WIDTH = 4.5
"""Of the button [interface units]."""


def draw_external_python(layout: Any, preferences: Any) -> None:
    box = layout.box()
    row = box.row(align=True)
    row.prop(preferences, "external_python")
    button = row.row(align=True)
    button.ui_units_x = CHECK_BUTTON_WIDTH  # the rest is the path's: half a row is too short for one
    button.operator("hnf.python_check", text="Check", icon="VIEWZOOM")
    found = STATE.external_python
    if found is None or found.path != preferences.external_python:
        box.label(text="Set its path, then press Check. Learn a Material… appears under Materials", icon="INFO")
        return
    box.label(text=format_python_status(found), icon="ERROR" if found.problem else "CHECKMARK", translate=False)
    if found.command:
        box.label(text="Type this into a terminal, then check again:", icon="BLANK1")
        row = box.row(align=True)
        row.label(text=found.command, icon="BLANK1", translate=False)
        row.operator("hnf.python_copy", text="Copy", icon="COPYDOWN")
