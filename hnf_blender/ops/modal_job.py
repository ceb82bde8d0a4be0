"""The life of an operator whose work is the job of jobs/manager.py: begun, ticked, given up with Esc, told."""

# No `from __future__ import annotations`: Blender reads the annotations of operators, of their bases too.

from collections.abc import Callable
from typing import Any

from hnf_core.errors import HnfError

from ..jobs import manager
from ..state.interface import redraw_tab
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .context import fail_poll, format_error

TICK_S = 0.1


def poll_no_job(operator: Any) -> bool:
    """For its poll(): whether a job may begin; where not, says why."""
    if manager.is_running():
        return fail_poll(operator, "A job is running. Wait for it, or press Esc to cancel it.")
    return True


class ModalJob:
    """An operator of this kind says itself what the job does (job_line) and what its end means (tell_end); what else it
    puts up, it takes down (take_down)."""

    _timer: Any = None
    """Of the ticks; None while there is no job."""

    def format_status(self, job: JobStatus) -> str:
        """The status bar's text, translated."""
        raise NotImplementedError

    def report_end(self, ended: LastJob) -> set[str]:
        """Report how it ended; Blender's word for that."""
        raise NotImplementedError

    def run_blocking(self, run: Callable[[], LastJob]) -> set[str]:
        """Without a window: all of it, now."""
        try:
            ended = run()
        except HnfError as error:
            self._report_error(error)
            return {"CANCELLED"}
        redraw_tab()
        return self.report_end(ended)

    def start_job(self, context: Any, start: Callable[[], object]) -> bool:
        """Start it in a second Blender and tick it from now on. False, and reported, where it cannot be begun."""
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

        if not manager.is_running():  # cancelled from elsewhere
            return self.finish(context, STATE.last_job)
        if event.type == "ESC" and event.value == "PRESS" and find_view_under_mouse(context, event) is not None:
            manager.cancel()
            return self.finish(context, STATE.last_job)
        if event.type == "TIMER":
            try:
                ended = manager.tick()
            except BaseException:
                self.finish(context, None)
                raise
            if ended is not None:
                return self.finish(context, ended)
            self.update_status(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: Any) -> None:
        """Blender's own word: the window closes, or another file is opened."""
        manager.cancel()
        self.finish(context, None)

    def update_status(self, context: Any) -> None:
        """How far it is: status bar and panels."""
        job = STATE.job
        if job is not None:
            context.workspace.status_text_set(f"{self.format_status(job)}.  {tr('Esc over the 3-D view: cancel')}")
            redraw_tab()

    def clean_up(self, context: Any) -> None:
        """Everything that was put up."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def finish(self, context: Any, ended: LastJob | None) -> set[str]:
        """Leave nothing on screen, and tell; None: there is nothing to tell."""
        self.clean_up(context)
        redraw_tab()
        return {"CANCELLED"} if ended is None else self.report_end(ended)

    def _report_error(self, error: HnfError) -> None:
        self.report({"ERROR"}, format_error(error))  # type: ignore[attr-defined]  # Blender's, of the other base
