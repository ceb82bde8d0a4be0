"""Operators of the bake: plan, bake, cancel, and remove baked data."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.scene.scene_names import get_scene_name
from ..jobs import manager
from ..props.scene_settings import get_active_stroke, has_strokes
from ..state.interface import redraw_tab
from ..state.labels import format_job, format_time_left
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .operator_base import ModalJob, fail_poll, poll_no_job, report_errors


class HNF_OT_plan(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.plan"
    bl_label = "Show Plan"
    bl_description = "Show what a bake would do, what is up to date, what is skipped and why. Nothing is rendered"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return _poll_strokes(cls, context)

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from ..jobs.baked_data import make_plan

        STATE.plan = make_plan(context.scene, context.view_layer)
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_bake(ModalJob, bpy.types.Operator):  # type: ignore[misc]
    """Bake strokes in a child process. Without REGISTER, since redoing would bake again."""

    bl_idname = "hnf.bake"
    bl_label = "Bake Touch"
    bl_description = (
        "Render close-ups along the strokes and keep what is needed to hear them. You can keep working; Esc cancels"
    )
    bl_options = {"UNDO"}  # Blender wants a set

    only_active: bpy.props.BoolProperty(
        name="Only the Active Stroke", description="Leave the other strokes unchanged", default=False
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_no_job(cls) and _poll_strokes(cls, context)

    def execute(self, context: Any) -> set[str]:
        from ..jobs.bake_job import bake_blocking

        return self.run_blocking(
            lambda: bake_blocking(context.scene, context.view_layer, self._get_stroke_names(context))
        )

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        if not self.start_job(
            context, lambda: manager.start_bake(context.scene, context.view_layer, self._get_stroke_names(context))
        ):
            return {"CANCELLED"}
        context.window_manager.progress_begin(0.0, 1.0)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _get_stroke_names(self, context: Any) -> tuple[str, ...]:
        if not self.only_active:
            return ()
        stroke = get_active_stroke(context)
        if stroke is None:
            raise HnfError("no stroke is active.", remedy="Select one, in the list or in the 3D view.")
        return (get_scene_name(context.scene, stroke),)

    def format_status(self, job: JobStatus) -> str:
        return f"{tr('Touch bake')}: {format_job(job)}, {format_time_left(job)}"

    def update_status(self, context: Any) -> None:
        super().update_status(context)
        if STATE.job is not None:
            context.window_manager.progress_update(STATE.job.done / max(1, STATE.job.total))

    def clean_up(self, context: Any) -> None:
        super().clean_up(context)
        context.window_manager.progress_end()

    def report_end(self, ended: LastJob) -> set[str]:
        """Report the outcome of the bake; FINISHED makes an undo step if something was written."""
        if not (ended.ok or ended.written):
            self.report({"ERROR"}, ended.message)
            return {"CANCELLED"}
        self.report({"INFO"} if ended.ok else {"WARNING"}, ended.message)
        return {"FINISHED"} if ended.written else {"CANCELLED"}


class HNF_OT_bake_cancel(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.bake_cancel"
    bl_label = "Cancel"
    bl_description = (
        "Stop the bake. Nothing in the scene changes; close-ups that are finished are kept for the next one"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not manager.is_running():
            return fail_poll(cls, "No bake is running.")
        return True

    def execute(self, context: Any) -> set[str]:
        manager.cancel()
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_purge(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.purge"
    bl_label = "Remove Baked Data"
    bl_description = "Remove baked data from the file. Strokes and material choices stay; a new bake restores the rest"
    bl_options = {"REGISTER", "UNDO"}

    what: bpy.props.EnumProperty(
        name="Remove",
        description="What to remove",
        items=[
            ("STALE", "What Is Stale", "Bakes that no longer fit their stroke, and tokens of surfaces that changed"),
            ("ALL", "Everything Baked", "All bakes of all strokes, and the tokens and palettes of all meshes"),
        ],
        default="ALL",
    )

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return poll_no_job(cls)

    def invoke(self, context: Any, event: Any) -> set[str]:
        return set(context.window_manager.invoke_props_dialog(self))

    def execute(self, context: Any) -> set[str]:
        from ..jobs.baked_data import purge
        from .diagnose_ops import refresh_diagnosis

        result = purge(context.scene, context.view_layer, everything=self.what == "ALL")
        refresh_diagnosis()
        self.report({"INFO"}, result.message)
        redraw_tab()
        return {"FINISHED"} if result.bytes else {"CANCELLED"}


def _poll_strokes(operator: Any, context: Any) -> bool:
    if not has_strokes(context.scene):
        return fail_poll(operator, "The scene has no stroke yet. Draw one, or add one in the list of strokes.")
    return True


CLASSES = (HNF_OT_plan, HNF_OT_bake, HNF_OT_bake_cancel, HNF_OT_purge)
