"""Manager of the running job: one at a time, independent of the operator that started it.

It also loads, in a thread, the modules that jobs and the panels' stroke statuses need: importing them takes a third of
a second.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from hnf_core.errors import HnfError

from ..compat import WORK_LOCK
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
    """Start a bake, or a touch query at `point` (what is felt there).

    Parameters
    ----------
    scene, view_layer : bpy.types.Scene, bpy.types.ViewLayer
        Scene to be baked.
    only : sequence of str
        Names of strokes; empty for all that are not muted.
    point : TouchQuery or None
        Point to be examined instead of a bake.

    Raises
    ------
    HnfError
        If a job is running already or this one cannot be started.
    """
    from .bake_job import BakeJob

    return start_job(lambda: BakeJob(scene, view_layer, only, point))


def start_job(create_job: Callable[[], AnyJob]) -> AnyJob:
    """Start the job that `create_job` returns. Raises HnfError if a job is running already."""
    global _current_job
    if _current_job is not None:
        raise HnfError("a job is running already.", remedy="Wait for it, or cancel it.")
    job = create_job()
    _current_job = job
    return job


def tick() -> LastJob | None:
    """Advance the running job; return its outcome once, when it ends, else None."""
    global _current_job
    if _current_job is None:
        return None
    try:
        outcome = _current_job.tick()
    except BaseException:
        _current_job = None
        raise
    if outcome is not None:
        _current_job = None
    return outcome


def cancel() -> bool:
    """Cancel the running job; return False if there is none."""
    global _current_job
    if _current_job is None:
        return False
    job, _current_job = _current_job, None
    job.cancel()
    return True


def close() -> None:
    """Cancel the running job, and end the process that waits for the next one."""
    cancel()
    bake_process = sys.modules.get(f"{__package__}.bake_process")  # Not imported for it, since nothing was baked then.
    if bake_process is not None:
        bake_process.end_process()


_preload_thread: threading.Thread | None = None


def is_preloaded() -> bool:
    """Return True if all modules that jobs need are imported; the first call starts importing them in a thread."""
    global _preload_thread
    if _preload_thread is None:
        _preload_thread = threading.Thread(target=_preload, name="hnf loading", daemon=True)
        _preload_thread.start()
    return not _preload_thread.is_alive()


def _preload() -> None:
    with WORK_LOCK:
        from hnf_core.field.weights import load_field
    with WORK_LOCK:
        from hnf_core.material.library import load_library
    with WORK_LOCK:
        from ..touch.bake_patches import ReliefPredictor
    with WORK_LOCK:
        from . import bake_job  # noqa: F401  # Imports all that a query or a bake needs.
    with WORK_LOCK:
        load_field()
    with WORK_LOCK:
        load_library()
    with WORK_LOCK:
        _ = ReliefPredictor().weights_hash  # Reads the weights once.
