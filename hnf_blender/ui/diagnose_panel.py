"""Parts of the preferences: diagnosis, cache, and the external Python with the command that installs what it lacks."""

from __future__ import annotations

from typing import Any

from ..ops.learn_ops import format_python_status
from ..state.session_state import STATE, SessionState
from ..translations import tr
from .layout import draw_paragraph


def draw_diagnosis(layout: Any, context: Any) -> None:
    """Draw the diagnosis with its buttons."""
    box = layout.box()
    column = box.column(align=True)
    for name, value in STATE.diagnosis:
        draw_paragraph(column, context, f"{tr(name)}: {value}" if name else value, icon="NONE" if name else "BLANK1")
    row = box.row(align=True)
    row.operator("hnf.diagnose", icon="VIEWZOOM")
    row.operator("hnf.diagnose_copy", icon="COPYDOWN")
    size = dict(STATE.diagnosis).get("Baked data in this file")
    text = tr("Remove Baked Data ({size})").format(size=size) if size else tr("Remove Baked Data")
    row.operator("hnf.purge", text=text, icon="TRASH", translate=False)


def draw_cache(layout: Any, state: SessionState) -> None:
    """Draw the button that clears the cache, with the cache's size if it is known."""
    size = dict(state.diagnosis).get("Cache size")
    if size:
        layout.operator(
            "hnf.cache_clear", text=tr("Clear Cache ({size})").format(size=size), icon="TRASH", translate=False
        )
    else:
        layout.operator("hnf.cache_clear", icon="TRASH")


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
        box.label(text="Not Checked Yet", icon="INFO")
        return
    box.label(
        text=format_python_status(external_python),
        icon="ERROR" if external_python.problem else "CHECKMARK",
        translate=False,
    )
    if external_python.command:
        box.label(text="Run This in a Terminal", icon="BLANK1")
        row = box.row(align=True)
        row.label(text=external_python.command, icon="BLANK1", translate=False)
        row.operator("hnf.python_copy", text="Copy", icon="COPYDOWN")
