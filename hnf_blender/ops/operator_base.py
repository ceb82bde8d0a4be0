"""Shared parts of operators: reasons for disabled buttons, the active stroke and its surface, and modal jobs.

`ModalJob` is the base of operators that run a job of `jobs.manager`: start, ticks by a timer, cancellation with Esc,
report.
"""

# No `from __future__ import annotations`: Blender reads the annotations of operators, of their bases too.

from collections.abc import Callable
from functools import wraps
from typing import Any

from hnf_core.errors import HnfError

from ..jobs import manager
from ..props.object_cache import ChangeCache
from ..props.scene_settings import find_index
from ..state.addon_settings import get_settings
from ..state.interface import redraw_tab
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr

TICK_S = 0.1
"""Interval of the timer of a modal job [s]."""


def fail_poll(operator: Any, reason: str) -> bool:
    """Return False for poll(), with a translated reason: Blender shows the text of poll_message_set() as it is."""
    operator.poll_message_set(tr(reason))
    return False


DEFAULT_PROBE = "AS_SET"
"""Value of an operator's probe that stands for the probe of the preferences."""
LAYER_MEMBERSHIP = ChangeCache()
"""Cache of whether a view layer contains an object, by scene, view layer and object."""


def make_active(context: Any, stroke: Any) -> None:
    """Select this stroke alone and make it active, in the view layer and in the list."""
    layer = context.view_layer
    layer.update()  # A new collection is not in the view layer before an update.
    for selected in tuple(layer.objects.selected):
        selected.select_set(False, view_layer=layer)
    if find_index(layer.objects, stroke) >= 0:
        stroke.select_set(True, view_layer=layer)
        layer.objects.active = stroke
    context.scene.hnf.stroke_index = max(0, find_index(context.scene.objects, stroke))


def make_active_and_visible(context: Any, stroke: Any) -> str:
    """Make a new stroke active and show its collection; return a remark if the collection was hidden."""
    from ..bridge.stroke.new_stroke import STROKE_COLLECTION, unhide_collection

    hidden = unhide_collection(stroke, context.view_layer)
    make_active(context, stroke)
    return (
        tr("; the collection '{name}' was hidden and is shown again").format(name=STROKE_COLLECTION) if hidden else ""
    )


def get_surface_in_layer(context: Any, stroke: Any) -> Any:
    """Return the surface object chosen for a stroke, or None if there is none in the view layer.

    A deleted object may survive in another scene or in the stroke's setting alone. The result is cached, since buttons
    query it at each redraw.
    """
    surface, layer = stroke.hnf_stroke.surface, context.view_layer
    if surface is None:
        return None
    key = context.scene.session_uid, layer.name, surface.session_uid
    return surface if LAYER_MEMBERSHIP.get(key, lambda: find_index(layer.objects, surface) >= 0) else None


def resolve_probe(context: Any, choice: str) -> str:
    """Return the probe (pen or finger) of a new stroke: the operator's choice, or that of the preferences."""
    return str(get_settings(context).default_probe) if choice == DEFAULT_PROBE else choice


def format_error(error: HnfError) -> str:
    """Format an error's problem, location and remedy for Blender's report."""
    text = str(error)
    return text[:1].upper() + text[1:]


Execute = Callable[[Any, Any], set[str]]


def report_errors(level: str = "ERROR", text: Callable[[HnfError], str] = format_error) -> Callable[[Execute], Execute]:
    """Decorate an operator's execute: an HnfError is reported at a level, and the operator is cancelled."""

    def decorate(execute: Execute) -> Execute:
        @wraps(execute)
        def run(self: Any, context: Any) -> set[str]:
            try:
                return execute(self, context)
            except HnfError as error:
                self.report({level}, text(error))
                return {"CANCELLED"}

        return run

    return decorate


def poll_no_job(operator: Any) -> bool:
    """Return whether no job is running; for poll(), with the reason if not."""
    if manager.is_running():
        return fail_poll(operator, "A job is running. Wait for it, or press Esc to cancel it.")
    return True


class ModalJob:
    """Mixin of modal operators that run a job (bake, touch query, learning) in a child process.

    Subclasses implement `format_status` and `report_end`, and extend `clean_up` for what they add to the window.
    """

    _timer: Any = None
    """Timer of the ticks; None without a job."""

    def format_status(self, job: JobStatus) -> str:
        """Return the translated text of the status bar."""
        raise NotImplementedError

    def report_end(self, ended: LastJob) -> set[str]:
        """Report the outcome of the job and return the operator's result."""
        raise NotImplementedError

    def run_blocking(self, run: Callable[[], LastJob]) -> set[str]:
        """Run the job to its end in this process, without a window."""
        try:
            outcome = run()
        except HnfError as error:
            self._report_error(error)
            return {"CANCELLED"}
        redraw_tab()
        return self.report_end(outcome)

    def start_job(self, context: Any, start: Callable[[], object]) -> bool:
        """Start the job and its timer; report an error and return False if it cannot be started."""
        try:
            start()
        except HnfError as error:
            self._report_error(error)
            return False
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        self.update_status(context)
        return True

    def modal(self, context: Any, event: Any) -> set[str]:
        from ..bridge.viewport_pick import find_view_under_mouse

        if not manager.is_running():  # The job was cancelled by another operator.
            return self.finish(context, STATE.last_job)
        if event.type == "ESC" and event.value == "PRESS" and find_view_under_mouse(context, event) is not None:
            manager.cancel()
            return self.finish(context, STATE.last_job)
        if event.type == "TIMER":
            try:
                outcome = manager.tick()
            except BaseException:
                self.finish(context, None)
                raise
            if outcome is not None:
                return self.finish(context, outcome)
            self.update_status(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: Any) -> None:
        """Cancel the job; called by Blender if the window is closed or another file is opened."""
        manager.cancel()
        self.finish(context, None)

    def update_status(self, context: Any) -> None:
        """Show the progress of the job in status bar and panels."""
        job = STATE.job
        if job is not None:
            context.workspace.status_text_set(f"{self.format_status(job)}.  {tr('Esc over the 3D view: cancel')}")
            redraw_tab()

    def clean_up(self, context: Any) -> None:
        """Remove the timer and the text of the status bar."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def finish(self, context: Any, ended: LastJob | None) -> set[str]:
        """Clean up and report the outcome of the job; None means there is nothing to report."""
        self.clean_up(context)
        redraw_tab()
        return {"CANCELLED"} if ended is None else self.report_end(ended)

    def _report_error(self, error: HnfError) -> None:
        self.report({"ERROR"}, format_error(error))  # type: ignore[attr-defined]  # Defined by bpy.types.Operator.
