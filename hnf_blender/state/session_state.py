"""Run-time state of the add-on: jobs and handlers write it, panels read it.

All of it can be computed again from the .blend. Blender data is stored by name, never by reference, since an undo
invalidates references.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from ..bridge.scene.scene_names import get_scene_name
from ..props.object_cache import ChangeCache
from ..touch.bake_status import StrokeStatus

if TYPE_CHECKING:
    from hnf_core.material.ranking import Suggestion

    from .job_results import ExternalPython, QueryView, Relief


class JobStatus(NamedTuple):
    """Progress of the running job.

    Attributes
    ----------
    stage : str
        Name of the current step.
    done, total : int
        Number of finished and of all strokes.
    elapsed_s : float
        Time since the start [s].
    left_s : float or None
        Estimated remaining time [s]; None if unknown.
    """

    stage: str
    done: int
    total: int
    elapsed_s: float
    left_s: float | None


class LastJob(NamedTuple):
    """Outcome of the last job.

    Attributes
    ----------
    ok : bool
        Whether it succeeded; if not, `message` is the problem and its remedy.
    message : str
        One sentence for the artist.
    details : tuple of str
        Further lines.
    written : int
        Number of strokes and meshes that got a result, even if the job failed.
    scene : str
        Name of the scene.
    is_cancelled : bool
        Whether the user cancelled it.
    """

    ok: bool
    message: str
    details: tuple[str, ...] = ()
    written: int = 0
    scene: str = ""
    is_cancelled: bool = False


class PlanLine(NamedTuple):
    """Line of the plan of a bake in its popover; `kind` is "needed", "fresh", "skipped", "failed" or "note"."""

    kind: str
    what: str
    why: str


class PlanView(NamedTuple):
    """Plan of a bake: what it would do, for its popover.

    Attributes
    ----------
    lines : tuple of PlanLine
        Lines of the plan.
    seconds : float
        Estimated time for what is needed [s].
    bytes_after : int
        Size of the baked data in the .blend [bytes].
    scene : str
        Name of the scene.
    """

    lines: tuple[PlanLine, ...]
    seconds: float
    bytes_after: int
    scene: str = ""


NAME_CACHE = ChangeCache()


def get_shown_name(scene: Any, obj: Any) -> str:
    """Return the cached name of a stroke in a scene, for panels; see `bridge.scene.scene_names.get_scene_name`."""
    if obj.library is None:
        return str(obj.name)
    return str(NAME_CACHE.get((scene.session_uid, obj.session_uid), lambda: get_scene_name(scene, obj)))


class SessionState:
    """State of the session: statuses of strokes, the running job and the last results.

    Attributes
    ----------
    statuses : dict
        Statuses of strokes by the scene's session_uid; see `get_statuses`.
    dirty_names : set of str
        Datablocks that changed since their strokes were checked.
    job, last_job, plan : JobStatus, LastJob, PlanView or None
        Running job, last job and last plan.
    suggestions : dict
        Ranked library materials by the full name of the Blender material, best first.
    reliefs : dict
        Relief found by a touch query, by the full name of the Blender material.
    diagnosis : tuple of (str, str)
        Last diagnosis, as names and values.
    query_view : QueryView or None
        Last touch query.
    external_python : ExternalPython or None
        Last check of the external Python; independent of the file.
    changes : int
        Counts changes by people, including undo and redo.
    suppress_depth : int
        Above 0 while the add-on itself changes data.
    """

    def __init__(self) -> None:
        self.statuses: dict[int, dict[str, StrokeStatus]] = {}
        self.dirty_names: set[str] = set()
        self.job: JobStatus | None = None
        self.last_job: LastJob | None = None
        self.plan: PlanView | None = None
        self.suggestions: dict[str, tuple[Suggestion, ...]] = {}
        self.reliefs: dict[str, Relief] = {}
        self.diagnosis: tuple[tuple[str, str], ...] = ()
        self.query_view: QueryView | None = None
        self.external_python: ExternalPython | None = None
        self.changes = 0
        self.suppress_depth = 0

    def get_statuses(self, scene: Any) -> dict[str, StrokeStatus]:
        """Return the statuses of a scene's strokes, by their names in that scene.

        A stroke in two scenes may be fresh in one and stale in the other, which may have another frame rate or a moving
        surface.
        """
        return self.statuses.setdefault(scene.session_uid, {})

    def get_status(self, scene: Any, stroke: Any) -> StrokeStatus | None:
        """Return the status of a stroke in a scene; None if it is not known yet."""
        return self.get_statuses(scene).get(get_shown_name(scene, stroke))

    def clear(self) -> None:
        """Discard all that belongs to a file, since another one was opened."""
        self.statuses.clear()
        self.dirty_names.clear()
        self.suggestions.clear()
        self.reliefs.clear()
        self.diagnosis = ()
        self.job = self.last_job = self.plan = self.query_view = None


STATE = SessionState()


@contextmanager
def suppress_change_tracking(view_layer: Any) -> Iterator[None]:
    """Ignore changes made in the with block, which are the add-on's own; earlier changes by people still count."""
    # Pending changes must reach the handlers now, not with the block's own updates.
    view_layer.update()
    STATE.suppress_depth += 1
    try:
        yield
        view_layer.update()
    finally:
        STATE.suppress_depth -= 1
