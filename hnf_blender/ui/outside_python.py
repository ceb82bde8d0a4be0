"""The external Python in the preferences: its path, what it was found to be, what to type where it lacks something."""

from __future__ import annotations

from typing import Any

from ..ops.outside_python import format_python_status
from ..state.session import STATE

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
