"""Which bake runs now: one at a time, outliving the operator that began it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hnf_core.errors import HnfError

from ..state.session import LastJob

if TYPE_CHECKING:
    from hnf_core.cli.probe import ProbePlace

    from .running import Bake

_running: Bake | None = None


def is_running() -> bool:
    return _running is not None


def start(scene: Any, view_layer: Any, only: Sequence[str] = (), place: ProbePlace | None = None) -> Bake:
    """A bake, or a look at one place. Raises HnfError where a bake runs already, or this one cannot be begun."""
    global _running
    from .running import Bake

    if _running is not None:
        raise HnfError("a bake is running already.", remedy="Wait for it, or cancel it.")
    _running = Bake(scene, view_layer, only, place)
    return _running


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
    """Stop the bake that runs, if one does; nothing of it is left. True where there was one."""
    global _running
    if _running is None:
        return False
    bake, _running = _running, None
    bake.cancel()
    return True
