"""What is shown where the add-on itself cannot be loaded: what went wrong, the versions, a text to copy.

It leans on nothing but Blender and Python: any other part may be the one that is broken.
"""

from __future__ import annotations

import platform
import sys
import textwrap
from pathlib import Path
from typing import Any

LINE_CHARACTERS = 32
"""Characters of a line in a sidebar of usual width."""

_registered: list[Any] = []


def explain_error(error: Exception) -> str:
    """What happened and what to do, for somebody who reads no tracebacks."""
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
    """Versions, place and traceback, for whoever helps."""
    import traceback

    from .compat import version_text

    rows = (
        ("Blender", version_text()),
        ("Python", platform.python_version()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Add-on folder", str(Path(__file__).resolve().parent)),
        ("numpy", str(getattr(sys.modules.get("numpy"), "__version__", "not loaded"))),
    )
    said = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    return "\n".join(f"{name:<14} {value}" for name, value in rows) + "\n\n" + said


def register(error: Exception) -> None:
    """Show the Touch tab with nothing in it but what went wrong."""
    import bpy

    words, text = explain_error(error), format_report(error)
    print(text, file=sys.stderr)

    class HNF_OT_rescue_copy(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
        bl_idname = "hnf.rescue_copy"
        bl_label = "Copy Report"
        bl_description = "Put versions and the error on the clipboard"

        def execute(self, context: Any) -> set[str]:
            context.window_manager.clipboard = text
            return {"FINISHED"}

    class HNF_PT_rescue(bpy.types.Panel):  # type: ignore[misc]
        bl_label = "Touch Could Not Start"
        bl_space_type = "VIEW_3D"
        bl_region_type = "UI"
        bl_category = "Touch"

        def draw(self, _context: Any) -> None:
            column = self.layout.column(align=True)
            for number, line in enumerate(textwrap.wrap(words, LINE_CHARACTERS)):
                column.label(text=line, icon="ERROR" if number == 0 else "BLANK1")
            column = self.layout.column(align=True)
            for line in text.split("\n\n")[0].splitlines()[:3]:
                column.label(text=" ".join(line.split()))
            self.layout.operator("hnf.rescue_copy", icon="COPYDOWN")

    for each in (HNF_OT_rescue_copy, HNF_PT_rescue):
        bpy.utils.register_class(each)
        _registered.append(each)


def unregister() -> None:
    """Take the panel away, if it is there."""
    import bpy

    while _registered:
        bpy.utils.unregister_class(_registered.pop())
