"""Which job runs now: one at a time, outliving the operator that began it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from hnf_core.errors import HnfError

from ..state.session import LastJob

if TYPE_CHECKING:
    from hnf_core.cli.probe import ProbePlace

    from .child_job import ChildJob
    from .running import Bake


AnyJob = TypeVar("AnyJob", bound="ChildJob")
_running: ChildJob | None = None


def is_running() -> bool:
    return _running is not None


def start(scene: Any, view_layer: Any, only: Sequence[str] = (), place: ProbePlace | None = None) -> Bake:
    """A bake, or a look at one place. Raises HnfError where a job runs already, or this one cannot be begun."""
    from .running import Bake

    return begin(lambda: Bake(scene, view_layer, only, place))


def begin(make: Callable[[], AnyJob]) -> AnyJob:
    """What make() begins is the job that runs. Raises HnfError where one runs already, and what make() raises."""
    global _running
    if _running is not None:
        raise HnfError("a job is running already.", remedy="Wait for it, or cancel it.")
    made = make()
    _running = made
    return made


def tick() -> LastJob | None:
    """Go on for a moment. None while it runs; how it ended, once. Where none runs: None."""
    global _running
    if _running is None:
        return None
    try:
        ended = _running.tick()
    except BaseException:
        _running = None
        raise
    if ended is not None:
        _running = None
    return ended


def cancel() -> bool:
    """Stop the job that runs, if one does; nothing of it is left. True where there was one."""
    global _running
    if _running is None:
        return False
    work, _running = _running, None
    work.cancel()
    return True
