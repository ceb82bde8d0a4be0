"""A panel shown if the add-on itself cannot be loaded: the error, the versions, and a report to copy.

It imports nothing but Blender and Python, since any other part of the add-on may be the broken one.
"""

from __future__ import annotations

import platform
import sys
import textwrap
from pathlib import Path
from typing import Any

LINE_CHARACTERS = 32
"""Line length in a sidebar of usual width [characters]."""

_registered: list[Any] = []


def explain_error(error: Exception) -> str:
    """Explain an error and its remedy in plain words."""
    if isinstance(error, ImportError):
        missing = error.name or str(error)
        return (
            f"A part of the add-on could not be loaded ({missing}). Most often the zip was made for another Python "
            f"than this Blender's {platform.python_version()}, or an update was stopped half-way. Remove the add-on, "
            "restart Blender, and install the zip for this Blender."
        )
    if isinstance(error, OSError):
        return f"A file of the add-on could not be read ({error}). Remove the add-on and install it again."
    return (
        f"The add-on stopped while it was switched on ({type(error).__name__}: {error}). Restart Blender; if it stays, "
        "copy the report and send it to the authors."
    )


def format_report(error: Exception) -> str:
    """Format versions, folder and traceback of an error as a report for support."""
    import traceback

    from .compat import version_text

    rows = (
        ("Blender", version_text()),
        ("Python", platform.python_version()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Add-on folder", str(Path(__file__).resolve().parent)),
        ("numpy", str(getattr(sys.modules.get("numpy"), "__version__", "not loaded"))),
    )
    traceback_text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    return "\n".join(f"{name:<14} {value}" for name, value in rows) + "\n\n" + traceback_text


def register(error: Exception) -> None:
    """Register a panel in the Touch tab that shows only the error."""
    import bpy

    explanation, report = explain_error(error), format_report(error)
    print(report, file=sys.stderr)

    class HNF_OT_rescue_copy(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
        bl_idname = "hnf.rescue_copy"
        bl_label = "Copy Report"
        bl_description = "Put versions and the error on the clipboard"

        def execute(self, context: Any) -> set[str]:
            context.window_manager.clipboard = report
            return {"FINISHED"}

    class HNF_PT_rescue(bpy.types.Panel):  # type: ignore[misc]
        bl_label = "Touch Could Not Start"
        bl_space_type = "VIEW_3D"
        bl_region_type = "UI"
        bl_category = "Touch"

        def draw(self, _context: Any) -> None:
            column = self.layout.column(align=True)
            for number, line in enumerate(textwrap.wrap(explanation, LINE_CHARACTERS)):
                column.label(text=line, icon="ERROR" if number == 0 else "BLANK1")
            column = self.layout.column(align=True)
            for line in report.split("\n\n")[0].splitlines()[:3]:
                column.label(text=" ".join(line.split()))
            self.layout.operator("hnf.rescue_copy", icon="COPYDOWN")

    for cls in (HNF_OT_rescue_copy, HNF_PT_rescue):
        bpy.utils.register_class(cls)
        _registered.append(cls)


def unregister() -> None:
    """Unregister the panel, if it is registered."""
    import bpy

    while _registered:
        bpy.utils.unregister_class(_registered.pop())
