"""Base of modal operators that run a job of `jobs.manager`: start, ticks by a timer, cancellation with Esc, report."""

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
"""Interval of the timer [s]."""


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
