"""Check the external Python that the preferences name, and copy the command that installs what it lacks."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import bpy

from ..state.session import STATE
from ..state.settings import settings
from ..translations import tr
from .greyed import greyed
from .modal_job import TICK_S

if TYPE_CHECKING:
    from ..state.outside_python import OutsidePython


def python_path() -> str:
    """Of the external Python, as a file's path; "" where none is named."""
    named = settings().external_python
    return bpy.path.abspath(named) if named else ""


def found_text(found: "OutsidePython") -> str:
    """One line: what it is, or why it cannot learn."""
    if not found.version:
        return found.problem
    parts = ", ".join([f"Python {found.version}", *(f"{name} {version}" for name, version in found.found)])
    return f"{found.problem} ({parts})" if found.problem else parts


class HNF_OT_python_check(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_idname = "hnf.python_check"
    bl_label = "Check External Python"
    bl_description = "Run the external Python once and ask which packages it has. Nothing is installed"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if not python_path():
            return greyed(cls, "Set an external Python in the add-on's preferences first")
        return True

    def execute(self, _context: Any) -> set[str]:
        from ..jobs.outside_python import look

        return self._told(settings().external_python, look(python_path()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """In a thread: a first import of torch takes many seconds."""
        if context.window is None:
            return self.execute(context)
        from ..jobs.outside_python import look

        found: list[OutsidePython] = []  # all that the thread holds: Blender may free the operator before it ends
        self._named, self._found, path = settings().external_python, found, python_path()
        threading.Thread(target=lambda: found.append(look(path)), name="hnf python check", daemon=True).start()
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.workspace.status_text_set(tr("Asking the external Python…"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type != "TIMER" or not self._found:
            return {"PASS_THROUGH"}
        self.cancel(context)
        return self._told(self._named, self._found[0])

    def cancel(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _told(self, named: str, found: "OutsidePython") -> set[str]:
        STATE.outside = replace(found, path=named)
        for area in (area for window in bpy.context.window_manager.windows for area in window.screen.areas):
            if area.type == "PREFERENCES":
                area.tag_redraw()
        self.report({"WARNING"} if found.problem else {"INFO"}, found_text(found))
        return {"FINISHED"}


class HNF_OT_python_copy(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.python_copy"
    bl_label = "Copy Command"
    bl_description = "Copy the command that installs what the external Python lacks. The add-on does not run it"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if STATE.outside is None or not STATE.outside.command:
            return greyed(cls, "There is nothing to install, or the external Python was not checked yet")
        return True

    def execute(self, context: Any) -> set[str]:
        if STATE.outside is not None:
            context.window_manager.clipboard = STATE.outside.command
        self.report({"INFO"}, tr("Command copied: paste it into a terminal"))
        return {"FINISHED"}


CLASSES = (HNF_OT_python_check, HNF_OT_python_copy)
