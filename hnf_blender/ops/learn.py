"""Learn a material from recordings of it, or from the simulator, in the external Python."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError

from ..jobs import current
from ..state.session import STATE, JobStatus, LastJob
from ..state.texts import CHARACTER_PX, MARGIN_PX, job_text, left_text, wrapped
from ..translations import tr
from .active import one_line
from .greyed import greyed
from .materials import felt_object, listed_library
from .modal_job import ModalJob, no_job_runs
from .outside_python import python_path

if TYPE_CHECKING:
    from hnf_core.cli.learn import Lesson

EFFORTS = {"QUICK": (60.0, 10), "STANDARD": (480.0, 40)}
"""Effort → seconds of strokes where a data set holds models, and epochs at most."""
KINDS = [
    ("simulated", "Simulated", "The contact simulator on a material of the library: needs no recordings"),
    ("own", "Your Own", "A folder with a CSV table for each stroke: time, acceleration and preferably speed and force"),
    ("hatt", "HaTT", "Your copy of the Penn Haptic Texture Toolkit: models, recordings or both"),
    ("cluster", "Cluster", "Your copy of the Cluster Haptic Texture Database"),
    ("lmt", "LMT", "Your copy of an LMT haptic texture database. Speed and force were not recorded"),
]
DIALOG_PX = 420
LAST: dict[str, str] = {}
"""What was asked for last in this session: a lesson that was cancelled goes on where the same is asked for again."""


class Choices:
    """What both operators are asked."""

    kind: bpy.props.EnumProperty(name="Recordings", description="Where the strokes come from", items=KINDS)
    folder: bpy.props.StringProperty(
        name="Folder", description="Folder with the recordings", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )
    name: bpy.props.StringProperty(
        name="Material",
        description="Its name in the recordings, such as ABS Plastic; for your own, the folder with its tables",
    )
    library: bpy.props.EnumProperty(
        name="Material", description="Material of the library to simulate", items=listed_library
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


def can_learn(operator: Any) -> bool:
    """For its poll(): whether a material could be learned now; where not, says why."""
    if not no_job_runs(operator):
        return False
    if not python_path():
        return greyed(operator, "Set an external Python in the add-on's preferences first")
    found = STATE.outside
    if found is not None and found.problem and bpy.path.abspath(found.path) == python_path():
        return greyed(
            operator, "The external Python lacks a package: the add-on's preferences show the command to install it"
        )
    return True


def lesson_of(choices: Choices) -> "Lesson":
    """What is to be learned. Raises HnfError where a choice is missing."""
    from hnf_core.cli.learn import Lesson

    simulated = choices.kind == "simulated"
    if not simulated and not choices.folder:
        raise HnfError("no folder is chosen.", remedy="Choose that of the recordings.")
    folder = "" if simulated else bpy.path.abspath(choices.folder)
    name = choices.library if simulated else choices.name.strip()
    if choices.kind == "own":
        name = name or Path(folder).name
    if not name:
        raise HnfError("no material is named.", remedy="Name it as the recordings do.")
    return Lesson(choices.kind, folder, name, *EFFORTS[choices.effort])


class HNF_OT_learn(Choices, bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    """Asks, and begins hnf.learn_run: what a dialog calls cannot go on beside the window itself."""

    bl_idname = "hnf.learn"
    bl_label = "Learn a Material…"
    bl_description = (
        "Train a field on recordings of a real material, or on simulated ones, in the external Python, and give it "
        "to the active slot. You can keep working; Esc cancels"
    )

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return can_learn(cls)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        for name, value in LAST.items():
            if not self.properties.is_property_set(name):
                setattr(self, name, value)
        return set(context.window_manager.invoke_props_dialog(self, width=DIALOG_PX))

    def draw(self, _context: Any) -> None:
        from hnf_core.datasets.catalogue import LICENCES

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
        text = tr("Licence: {licence}").format(licence=licence)
        column = layout.column(align=True)
        column.scale_y = 0.8
        for place, line in enumerate(wrapped(text, int((DIALOG_PX - MARGIN_PX) / CHARACTER_PX))):
            column.label(text=line, icon="BLANK1" if place else "INFO", translate=False)

    def execute(self, _context: Any) -> set[str]:
        how = "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT"
        choices = {name: getattr(self, name) for name in Choices.__annotations__}
        LAST.update(choices)
        try:
            lesson_of(self)  # a choice that is missing is no error of a program
            done = set(bpy.ops.hnf.learn_run(how, **choices))
        except HnfError as error:
            self.report({"ERROR"}, one_line(error))
            return {"CANCELLED"}
        except RuntimeError as error:  # what the other one reported as an error
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        # This operator has done its part: as one that goes on, Blender would never free it.
        return {"FINISHED"} if done == {"RUNNING_MODAL"} else done


class HNF_OT_learn_run(Choices, ModalJob, bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    """No REGISTER: adjusting it afterwards would learn anew."""

    bl_idname = "hnf.learn_run"
    bl_label = "Learn Material"
    bl_description = "Learn a material with these choices, without asking"
    bl_options = {"UNDO", "INTERNAL"}  # noqa: RUF012  # Blender wants a set

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return can_learn(cls)

    def execute(self, context: Any) -> set[str]:
        from ..jobs.learning import learn_in_line

        return self.in_line(lambda: learn_in_line(*self._asked(context)))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        from ..jobs.learning import Learning

        if not self.begin_job(context, lambda: current.begin(lambda: Learning(*self._asked(context)))):
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _asked(self, context: Any) -> tuple[Any, ...]:
        """What Learning takes. Raises HnfError where a choice is missing."""
        from ..jobs.learning import Slot

        obj = felt_object(context)
        slot = Slot() if obj is None else Slot(obj.name, obj.active_material_index)
        return python_path(), lesson_of(self), slot

    def job_line(self, job: JobStatus) -> str:
        return f"{tr('Learning a material')}: {job_text(job)}, {left_text(job)}"

    def tell_end(self, ended: LastJob) -> set[str]:
        """An undo step where a material was given."""
        if not ended.ok:
            self.report({"ERROR"}, ended.message)
            return {"CANCELLED"}
        self.report({"INFO"}, ". ".join([ended.message, *ended.details]))
        return {"FINISHED"} if ended.written else {"CANCELLED"}


CLASSES = (HNF_OT_learn, HNF_OT_learn_run)
