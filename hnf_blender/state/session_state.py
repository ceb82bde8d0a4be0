"""The one place of run-time state. Panels read it, jobs and handlers write it; everything in it can be made again from
the .blend. Blender data is named, never referenced: a reference dies with the next undo.

What the add-on changes by itself is no news to its own handlers.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from ..bridge.scene.scene_names import get_scene_name
from ..props.object_cache import ChangeCache
from ..touch.freshness import StrokeStatus

if TYPE_CHECKING:
    from hnf_core.material.ranking import Suggestion

    from .job_results import ExternalPython, QueryView, Relief


class JobStatus(NamedTuple):
    """stage, done of total, elapsed_s, left_s (None = not known yet): of the running job, for panels and status bar."""

    stage: str
    done: int
    total: int
    elapsed_s: float
    left_s: float | None


class LastJob(NamedTuple):
    """How the last job ended. ok False: message says what went wrong and what to do. written: how many strokes and
    meshes got something all the same. scene: whose strokes it was about, by name."""

    ok: bool
    message: str
    details: tuple[str, ...] = ()
    written: int = 0
    scene: str = ""


class PlanLine(NamedTuple):
    """One line of the plan as the Scene panel shows it. kind: "needed", "fresh", "skipped", "failed" or "note"."""

    kind: str
    what: str
    why: str


class PlanView(NamedTuple):
    """lines: of the plan. seconds: estimate for what is needed. bytes_after: what the bake will keep in the .blend.
    scene: of which it speaks, by name."""

    lines: tuple[PlanLine, ...]
    seconds: float
    bytes_after: int
    scene: str = ""


NAME_CACHE = ChangeCache()


def get_shown_name(scene: Any, obj: Any) -> str:
    """See name_in: for panels, which ask it of every stroke in every redraw."""
    if obj.library is None:
        return str(obj.name)
    return str(NAME_CACHE.get((scene.session_uid, obj.session_uid), lambda: get_scene_name(scene, obj)))


class SessionState:
    """statuses: by the session_uid of the scene, see strokes_in.
    dirty: names of datablocks changed since their strokes were looked at.
    suggestions: by the full name of the Blender material, the most apt first. reliefs: by that name too, as seen where
    a place of it was examined. diagnosis: (name, value) as last collected. heard: something was played since Blender
    started. probe: the last place that was looked at.
    outside: the external Python as last checked; no file's matter.
    changes: counts what people changed, undo and redo included. own: above 0 while the add-on itself changes things."""

    def __init__(self) -> None:
        self.statuses: dict[int, dict[str, StrokeStatus]] = {}
        self.dirty_names: set[str] = set()
        self.job: JobStatus | None = None
        self.last_job: LastJob | None = None
        self.plan: PlanView | None = None
        self.suggestions: dict[str, tuple[Suggestion, ...]] = {}
        self.reliefs: dict[str, Relief] = {}
        self.diagnosis: tuple[tuple[str, str], ...] = ()
        self.has_played = False
        self.query_view: QueryView | None = None
        self.external_python: ExternalPython | None = None
        self.changes = 0
        self.suppress_depth = 0

    def get_statuses(self, scene: Any) -> dict[str, StrokeStatus]:
        """Of a scene's strokes, by the names that it calls them (name_in). A stroke that stands in two scenes may be
        fresh in one and stale in the other, whose frames are shorter or whose surface moves."""
        return self.statuses.setdefault(scene.session_uid, {})

    def get_status(self, scene: Any, stroke: Any) -> StrokeStatus | None:
        """Of a stroke as it stands in a scene; None where nothing is known of it yet."""
        return self.get_statuses(scene).get(get_shown_name(scene, stroke))

    def clear(self) -> None:
        """Forget everything: another file is open."""
        self.statuses.clear()
        self.dirty_names.clear()
        self.suggestions.clear()
        self.reliefs.clear()
        self.diagnosis = ()
        self.job = self.last_job = self.plan = self.query_view = None


STATE = SessionState()


@contextmanager
def suppress_change_tracking(view_layer: Any) -> Iterator[None]:
    """Changes made in this block do not make anything dirty; those that a person made just before do."""
    view_layer.update()  # pending changes reach the handlers now, not in the block's own updates
    STATE.suppress_depth += 1
    try:
        yield
        view_layer.update()
    finally:
        STATE.suppress_depth -= 1
