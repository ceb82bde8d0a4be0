"""The life of an operator whose work is the job of jobs/current.py: begun, ticked, given up with Esc, told."""

# No `from __future__ import annotations`: Blender reads the annotations of operators, of their bases too.

from collections.abc import Callable
from typing import Any

from hnf_core.errors import HnfError

from ..jobs import current
from ..state.redraw import redraw_tab
from ..state.session import STATE, JobStatus, LastJob
from ..translations import tr
from .active import one_line
from .greyed import greyed

TICK_S = 0.1


def no_job_runs(operator: Any) -> bool:
    """For its poll(): whether a job may begin; where not, says why."""
    if current.is_running():
        return greyed(operator, "A job is running. Wait for it, or press Esc to cancel it.")
    return True


class ModalJob:
    """An operator of this kind says itself what the job does (job_line) and what its end means (tell_end); what else it
    puts up, it takes down (take_down)."""

    _timer: Any = None
    """Of the ticks; None while there is no job."""

    def job_line(self, job: JobStatus) -> str:
        """The status bar's text, translated."""
        raise NotImplementedError

    def tell_end(self, ended: LastJob) -> set[str]:
        """Report how it ended; Blender's word for that."""
        raise NotImplementedError

    def in_line(self, run: Callable[[], LastJob]) -> set[str]:
        """Without a window: all of it, now."""
        try:
            ended = run()
        except HnfError as error:
            self._refuse(error)
            return {"CANCELLED"}
        redraw_tab()
        return self.tell_end(ended)

    def begin_job(self, context: Any, start: Callable[[], object]) -> bool:
        """Start it in a second Blender and tick it from now on. False, and reported, where it cannot be begun."""
        try:
            start()
        except HnfError as error:
            self._refuse(error)
            return False
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        self.show(context)
        return True

    def modal(self, context: Any, event: Any) -> set[str]:
        from ..bridge.under_cursor import view_under

        if not current.is_running():  # cancelled from elsewhere
            return self.end(context, STATE.last_job)
        if event.type == "ESC" and event.value == "PRESS" and view_under(context, event) is not None:
            current.cancel()
            return self.end(context, STATE.last_job)
        if event.type == "TIMER":
            try:
                ended = current.tick()
            except BaseException:
                self.end(context, None)
                raise
            if ended is not None:
                return self.end(context, ended)
            self.show(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: Any) -> None:
        """Blender's own word: the window closes, or another file is opened."""
        current.cancel()
        self.end(context, None)

    def show(self, context: Any) -> None:
        """How far it is: status bar and panels."""
        job = STATE.job
        if job is not None:
            context.workspace.status_text_set(f"{self.job_line(job)}.  {tr('Esc over the 3-D view: cancel')}")
            redraw_tab()

    def take_down(self, context: Any) -> None:
        """Everything that was put up."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def end(self, context: Any, ended: LastJob | None) -> set[str]:
        """Leave nothing on screen, and tell; None: there is nothing to tell."""
        self.take_down(context)
        redraw_tab()
        return {"CANCELLED"} if ended is None else self.tell_end(ended)

    def _refuse(self, error: HnfError) -> None:
        self.report({"ERROR"}, one_line(error))  # type: ignore[attr-defined]  # Blender's, of the other base
