"""Which job runs now: one at a time, outliving the operator that began it.

Loading what statuses are made with, beside the window: a third of a second of imports would be felt in it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from hnf_core.errors import HnfError

from ..state.session_state import LastJob

if TYPE_CHECKING:
    from hnf_core.touch_request import TouchQuery

    from .bake_job import BakeJob
    from .child_job import ChildJob

AnyJob = TypeVar("AnyJob", bound="ChildJob")
_current_job: ChildJob | None = None


def is_running() -> bool:
    return _current_job is not None


def start_bake(scene: Any, view_layer: Any, only: Sequence[str] = (), point: TouchQuery | None = None) -> BakeJob:
    """A bake, or a look at one place. Raises HnfError where a job runs already, or this one cannot be begun."""
    from .bake_job import BakeJob

    return start_job(lambda: BakeJob(scene, view_layer, only, point))


def start_job(create_job: Callable[[], AnyJob]) -> AnyJob:
    """What make() begins is the job that runs. Raises HnfError where one runs already, and what make() raises."""
    global _current_job
    if _current_job is not None:
        raise HnfError("a job is running already.", remedy="Wait for it, or cancel it.")
    made = create_job()
    _current_job = made
    return made


def tick() -> LastJob | None:
    """Go on for a moment. None while it runs; how it ended, once. Where none runs: None."""
    global _current_job
    if _current_job is None:
        return None
    try:
        ended = _current_job.tick()
    except BaseException:
        _current_job = None
        raise
    if ended is not None:
        _current_job = None
    return ended


def cancel() -> bool:
    """Stop the job that runs, if one does; nothing of it is left. True where there was one."""
    global _current_job
    if _current_job is None:
        return False
    work, _current_job = _current_job, None
    work.cancel()
    return True


_preload_thread: threading.Thread | None = None


def is_preloaded() -> bool:
    """Is everything loaded? The first call begins to."""
    global _preload_thread
    if _preload_thread is None:
        _preload_thread = threading.Thread(target=_preload, name="hnf loading", daemon=True)
        _preload_thread.start()
    return not _preload_thread.is_alive()


def _preload() -> None:
    from hnf_core.field.weights import load_field
    from hnf_core.material.library import load_library

    from ..touch.bake_patches import ReliefPredictor
    from . import bake_job  # noqa: F401  # all that a look or a bake imports

    load_field()
    load_library()
    _ = ReliefPredictor().weights_hash  # the file is read once for it
