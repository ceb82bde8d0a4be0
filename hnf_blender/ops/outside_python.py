"""Check the external Python that the preferences name, and copy the command that installs what it lacks."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import bpy

from ..state.session import STATE
from ..state.settings import get_settings
from ..translations import tr
from .greyed import fail_poll
from .modal_job import TICK_S

if TYPE_CHECKING:
    from ..state.outside_python import ExternalPython


def get_python_path() -> str:
    """Of the external Python, as a file's path; "" where none is named."""
    named = get_settings().external_python
    return bpy.path.abspath(named) if named else ""


def format_python_status(found: "ExternalPython") -> str:
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
        if not get_python_path():
            return fail_poll(cls, "Set an external Python in the add-on's preferences first")
        return True

    def execute(self, _context: Any) -> set[str]:
        from ..jobs.outside_python import check_python

        return self._store_result(get_settings().external_python, check_python(get_python_path()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """In a thread: a first import of torch takes many seconds."""
        if context.window is None:
            return self.execute(context)
        from ..jobs.outside_python import check_python

        found: list[ExternalPython] = []  # all that the thread holds: Blender may free the operator before it ends
        self._path_setting, self._found, path = get_settings().external_python, found, get_python_path()
        threading.Thread(target=lambda: found.append(check_python(path)), name="hnf python check", daemon=True).start()
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.workspace.status_text_set(tr("Asking the external Python…"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type != "TIMER" or not self._found:
            return {"PASS_THROUGH"}
        self.cancel(context)
        return self._store_result(self._path_setting, self._found[0])

    def cancel(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _store_result(self, named: str, found: "ExternalPython") -> set[str]:
        STATE.external_python = replace(found, path=named)
        for area in (area for window in bpy.context.window_manager.windows for area in window.screen.areas):
            if area.type == "PREFERENCES":
                area.tag_redraw()
        self.report({"WARNING"} if found.problem else {"INFO"}, format_python_status(found))
        return {"FINISHED"}


class HNF_OT_python_copy(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.python_copy"
    bl_label = "Copy Command"
    bl_description = "Copy the command that installs what the external Python lacks. The add-on does not run it"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if STATE.external_python is None or not STATE.external_python.command:
            return fail_poll(cls, "There is nothing to install, or the external Python was not checked yet")
        return True

    def execute(self, context: Any) -> set[str]:
        if STATE.external_python is not None:
            context.window_manager.clipboard = STATE.external_python.command
        self.report({"INFO"}, tr("Command copied: paste it into a terminal"))
        return {"FINISHED"}


PYTHON_CLASSES = (HNF_OT_python_check, HNF_OT_python_copy)
