"""Preferences of the add-on; the rest of the add-on reads them through `state/addon_settings.py`."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.material.probe import PROBE_NAMES

from .state.addon_settings import DEFAULT_SETTINGS
from .state.session_state import STATE
from .translations import tr


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
        from .ui.diagnose_panel import draw_cache, draw_diagnosis, draw_external_python

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
