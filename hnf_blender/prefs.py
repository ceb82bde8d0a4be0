"""Preferences of the add-on; the rest of the add-on reads them through `state/addon_settings.py`."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.material.probe import PROBE_NAMES

from .ops.learn_ops import format_python_status
from .state.addon_settings import DEFAULT_SETTINGS
from .state.session_state import STATE, SessionState
from .translations import tr
from .ui.layout import draw_paragraph

CHECK_BUTTON_WIDTH = 4.5
"""Width of the Check button [interface units]."""


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


class HnfPreferences(bpy.types.AddonPreferences):  # type: ignore[misc]  # bpy has no types
    """Preferences shown under Edit > Preferences > Add-ons."""

    bl_idname = __package__

    overlay: bpy.props.BoolProperty(
        name="Show Strokes in Viewport",
        description="Paths colored by force in newtons, direction ticks and the point of contact at the playhead",
        default=DEFAULT_SETTINGS.overlay,
    )
    default_probe: bpy.props.EnumProperty(
        name="Probe of New Strokes",
        description="Default probe for new strokes",
        items=[(name, name.replace("-", " ").title(), f"Touch with the {name}") for name in PROBE_NAMES],
        default=DEFAULT_SETTINGS.default_probe,
    )
    output: bpy.props.StringProperty(
        name="Output",
        description="Address of the device that strokes are played on, on this machine; empty: Blender's own sound. "
        "Choose it in the Actuator panel",
        default=DEFAULT_SETTINGS.output,
    )
    external_python: bpy.props.StringProperty(
        name="External Python",
        description="A Python outside Blender (3.11 or newer) that has PyTorch, to learn materials from recordings. "
        "Everything else runs without it",
        subtype="FILE_PATH",
        default=DEFAULT_SETTINGS.external_python,
    )

    guide_done: bpy.props.BoolProperty(
        name="First Steps Done", description="The first steps were finished once", options={"HIDDEN"}
    )

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "overlay")
        layout.prop(self, "default_probe")
        folder = dict(STATE.diagnosis).get("Cache folder")
        if folder:
            layout.label(text=f"{tr('Cache folder')}: {folder}", translate=False)
        else:
            layout.operator("hnf.diagnose", text="Show Cache Folder and Size", icon="VIEWZOOM")
        draw_cache(layout, STATE)
        row = layout.row(align=True)
        row.label(text="Asset Library")
        row.operator("hnf.assets_add", text="Add")
        row.operator("hnf.assets_remove", text="Remove")
        layout.label(text="Learning Needs PyTorch", icon="INFO")
        draw_external_python(layout, self)
        draw_diagnosis(layout, context)


def register() -> None:
    bpy.utils.register_class(HnfPreferences)


def unregister() -> None:
    bpy.utils.unregister_class(HnfPreferences)
