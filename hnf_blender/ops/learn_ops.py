"""Operators that check the external Python and learn materials in it, from recordings or the simulator."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError

from ..jobs import manager
from ..state.addon_settings import get_settings
from ..state.labels import CHARACTER_PX, MARGIN_PX, format_job, format_time_left, wrap_text
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .material_ops import find_material_object, get_library_items
from .operator_base import TICK_S, ModalJob, fail_poll, format_error, poll_no_job

if TYPE_CHECKING:
    from hnf_core.training.learn import LearnRequest

    from ..state.job_results import ExternalPython


def get_python_path() -> str:
    """Return the path of the external Python; "" if none is set."""
    setting = get_settings().external_python
    return bpy.path.abspath(setting) if setting else ""


def format_python_status(found: "ExternalPython") -> str:
    """Format version and packages of the external Python, with the problem if it cannot learn."""
    if not found.version:
        return found.problem
    versions = ", ".join([f"Python {found.version}", *(f"{name} {version}" for name, version in found.found)])
    return f"{found.problem} ({versions})" if found.problem else versions


class HNF_OT_python_check(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.python_check"
    bl_label = "Check External Python"
    bl_description = "Run the external Python once and ask which packages it has. Nothing is installed"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if not get_python_path():
            return fail_poll(cls, "Set an external Python in the add-on's preferences first")
        return True

    def execute(self, _context: Any) -> set[str]:
        from ..jobs.learn_job import check_python

        return self._store_result(get_settings().external_python, check_python(get_python_path()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Check in a thread, since a first import of torch takes many seconds."""
        if context.window is None:
            return self.execute(context)
        from ..jobs.learn_job import check_python

        # The thread must not refer to the operator, which Blender may free first.
        results: list[ExternalPython] = []
        self._path_setting, self._found, path = get_settings().external_python, results, get_python_path()
        threading.Thread(
            target=lambda: results.append(check_python(path)), name="hnf python check", daemon=True
        ).start()
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


class HNF_OT_python_copy(bpy.types.Operator):  # type: ignore[misc]
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


EFFORTS = {"QUICK": (60.0, 10), "STANDARD": (480.0, 40)}
"""Effort → seconds of strokes for data sets of models, and largest number of epochs."""
RECORDING_ITEMS = [
    ("simulated", "Simulated", "The contact simulator on a material of the library: needs no recordings"),
    ("own", "Your Own", "A folder with a CSV table for each stroke: time, acceleration and preferably speed and force"),
    ("hatt", "HaTT", "Your copy of the Penn Haptic Texture Toolkit: models, recordings or both"),
    ("cluster", "Cluster", "Your copy of the Cluster Haptic Texture Database"),
    ("lmt", "LMT", "Your copy of an LMT haptic texture database. Speed and force were not recorded"),
]
DIALOG_PX = 420
"""Width of the dialog [px]."""
LAST_CHOICES: dict[str, str] = {}
"""Last choices of this session; the same choices resume a cancelled training."""


class LearnChoices:
    """Mixin with the settings of a training, shared by the dialog and the operator that runs it."""

    kind: bpy.props.EnumProperty(name="Recordings", description="Where the strokes come from", items=RECORDING_ITEMS)
    folder: bpy.props.StringProperty(
        name="Folder", description="Folder with the recordings", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )
    name: bpy.props.StringProperty(
        name="Material",
        description="Its name in the recordings, such as ABS Plastic; for your own, the folder with its tables",
    )
    library: bpy.props.EnumProperty(
        name="Material", description="Material of the library to simulate", items=get_library_items
    )  # fmt: skip
    effort: bpy.props.EnumProperty(
        name="Effort",
        description="How long it may take. Times are for one otherwise idle CPU core",
        items=[
            (
                "QUICK",
                "Quick",
                "Ten epochs on a minute of strokes: about 15 s, or 30 s if simulated. To see that it works",
            ),
            (
                "STANDARD",
                "Standard",
                "Up to forty epochs on eight minutes of strokes: about 30 s, or 3 min if simulated",
            ),
        ],
        default="STANDARD",
    )


def poll_can_learn(operator: Any) -> bool:
    """Return whether a material can be learned now; for poll(), with the reason if not."""
    if not poll_no_job(operator):
        return False
    if not get_python_path():
        return fail_poll(operator, "Set an external Python in the add-on's preferences first")
    external_python = STATE.external_python
    if (
        external_python is not None
        and external_python.problem
        and bpy.path.abspath(external_python.path) == get_python_path()
    ):
        return fail_poll(
            operator, "The external Python lacks a package: the add-on's preferences show the command to install it"
        )
    return True


def make_lesson(choices: LearnChoices) -> "LearnRequest":
    """Return the request for a training of a material. Raises HnfError if a setting is missing."""
    from hnf_core.training.learn import LearnRequest

    simulated = choices.kind == "simulated"
    if not simulated and not choices.folder:
        raise HnfError("no folder is chosen.", remedy="Choose that of the recordings.")
    folder = "" if simulated else bpy.path.abspath(choices.folder)
    name = choices.library if simulated else choices.name.strip()
    if choices.kind == "own":
        name = name or Path(folder).name
    if not name:
        raise HnfError("no material is named.", remedy="Name it as the recordings do.")
    return LearnRequest(choices.kind, folder, name, *EFFORTS[choices.effort])


class HNF_OT_learn(LearnChoices, bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    """Dialog that starts the operator hnf.learn_run, since an operator called from a dialog cannot continue modally."""

    bl_idname = "hnf.learn"
    bl_label = "Learn a Material…"
    bl_description = (
        "Train a field on recordings of a real material, or on simulated ones, in the external Python, and give it "
        "to the active slot. You can keep working; Esc cancels"
    )

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return poll_can_learn(cls)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        for name, value in LAST_CHOICES.items():
            if not self.properties.is_property_set(name):
                setattr(self, name, value)
        return set(context.window_manager.invoke_props_dialog(self, width=DIALOG_PX))

    def draw(self, _context: Any) -> None:
        from hnf_core.datasets.registry import LICENCES

        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "kind")
        if self.kind == "simulated":
            layout.prop(self, "library")
        else:
            layout.prop(self, "folder")
            layout.prop(self, "name")
        layout.prop(self, "effort")
        licence = tr("yours (your own recordings)") if self.kind == "own" else LICENCES[self.kind]
        text = tr("License: {licence}").format(licence=licence)
        column = layout.column(align=True)
        column.scale_y = 0.8
        for index, line in enumerate(wrap_text(text, int((DIALOG_PX - MARGIN_PX) / CHARACTER_PX))):
            column.label(text=line, icon="BLANK1" if index else "INFO", translate=False)

    def execute(self, _context: Any) -> set[str]:
        execution_context = "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT"
        choices = {name: getattr(self, name) for name in LearnChoices.__annotations__}
        LAST_CHOICES.update(choices)
        try:
            make_lesson(self)  # Reports a missing choice before the job starts.
            status = set(bpy.ops.hnf.learn_run(execution_context, **choices))
        except HnfError as error:
            self.report({"ERROR"}, format_error(error))
            return {"CANCELLED"}
        except RuntimeError as error:  # hnf.learn_run reported an error.
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        # With RUNNING_MODAL Blender would never free this operator.
        return {"FINISHED"} if status == {"RUNNING_MODAL"} else status


class HNF_OT_learn_run(LearnChoices, ModalJob, bpy.types.Operator):  # type: ignore[misc]
    """Learn a haptic material. Without REGISTER, since redoing would learn again."""

    bl_idname = "hnf.learn_run"
    bl_label = "Learn Material"
    bl_description = "Learn a material with these choices, without asking"
    bl_options = {"UNDO", "INTERNAL"}  # Blender wants a set

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return poll_can_learn(cls)

    def execute(self, context: Any) -> set[str]:
        from ..jobs.learn_job import learn_blocking

        return self.run_blocking(lambda: learn_blocking(*self._get_job_arguments(context)))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        from ..jobs.learn_job import LearnJob

        if not self.start_job(context, lambda: manager.start_job(lambda: LearnJob(*self._get_job_arguments(context)))):
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _get_job_arguments(self, context: Any) -> tuple[Any, ...]:
        """Return the arguments of LearnJob (Python, request, slot). Raises HnfError if a setting is missing."""
        from ..jobs.learn_job import MaterialSlot

        obj = find_material_object(context)
        slot = MaterialSlot() if obj is None else MaterialSlot(obj.name, obj.active_material_index)
        return get_python_path(), make_lesson(self), slot

    def format_status(self, job: JobStatus) -> str:
        return f"{tr('Learning a material')}: {format_job(job)}, {format_time_left(job)}"

    def report_end(self, ended: LastJob) -> set[str]:
        """Report the outcome of the training; FINISHED makes an undo step if a material was assigned."""
        if not ended.ok:
            self.report({"ERROR"}, ended.message)
            return {"CANCELLED"}
        self.report({"INFO"}, ". ".join([ended.message, *ended.details]))
        return {"FINISHED"} if ended.written else {"CANCELLED"}


CLASSES = (HNF_OT_python_check, HNF_OT_python_copy, HNF_OT_learn, HNF_OT_learn_run)
