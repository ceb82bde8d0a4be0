"""Diagnose panel: versions, paths, sizes and the last error, with buttons that remove stored data.

Also draws the external Python in the preferences: its path, its check, and the command that installs what is missing.
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
    """Draw the button that clears the cache, with the cache's size if it is known."""
    size = dict(state.diagnosis).get("Cache size")
    if size:
        layout.operator(
            "hnf.cache_clear", text=tr("Clear Cache ({size})").format(size=size), icon="TRASH", translate=False
        )
    else:
        layout.operator("hnf.cache_clear", icon="TRASH")


CLASSES = (HNF_PT_diagnose,)


CHECK_BUTTON_WIDTH = 4.5
"""Width of the Check button [interface units]."""


def draw_external_python(layout: Any, preferences: Any) -> None:
    """Draw the preferences of the external Python."""
    box = layout.box()
    row = box.row(align=True)
    row.prop(preferences, "external_python")
    button = row.row(align=True)
    button.ui_units_x = CHECK_BUTTON_WIDTH  # Half a row would be too short for a path.
    button.operator("hnf.python_check", text="Check", icon="VIEWZOOM")
    external_python = STATE.external_python
    if external_python is None or external_python.path != preferences.external_python:
        box.label(text="Set its path, then press Check. Learn a Material… appears under Materials", icon="INFO")
        return
    box.label(
        text=format_python_status(external_python),
        icon="ERROR" if external_python.problem else "CHECKMARK",
        translate=False,
    )
    if external_python.command:
        box.label(text="Type this into a terminal, then check again:", icon="BLANK1")
        row = box.row(align=True)
        row.label(text=external_python.command, icon="BLANK1", translate=False)
        row.operator("hnf.python_copy", text="Copy", icon="COPYDOWN")
