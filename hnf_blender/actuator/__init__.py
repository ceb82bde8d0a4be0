"""The actuator: where strokes are felt, the process that plays there, and a hand that touches live."""

from __future__ import annotations

import atexit
import sys
import time
from typing import TYPE_CHECKING, Any

from ..rooms import ignore, listen

if TYPE_CHECKING:
    from hnf_core.signal import Signal

REDRAW_S = 0.2
"""Least time between two pictures of a level that moves."""

_shown_at = 0.0


def tick(context: Any, stamp: str = "", signal: Signal | None = None) -> None:
    """Called by the preview's timer: take in what the processes said, tell the panel. Some comparisons while none
    runs. signal: that the preview shows, known by its stamp; None where it shows none."""
    global _shown_at
    from ..props.profile_file import FILE
    from ..props.scene import actuator_of
    from ..state.redraw import redraw_tab
    from .choice import chosen_output
    from .facts import facts_of, phase_of
    from .finding import FINDER
    from .link import LINK
    from .skin import SKIN, words
    from .state import ACTUATOR, VIRTUAL

    profile = actuator_of(context.scene)
    found = FINDER.tick()
    told = LINK.tick()
    virtual = chosen_output(context) == VIRTUAL
    worth = signal if virtual or context.scene.hnf.actuator == FILE else None
    if SKIN.look((stamp, profile, virtual), worth, profile, virtual=virtual):
        ACTUATOR.skin, found = words(SKIN.shown), True
    if told or (ACTUATOR.facts.phase, ACTUATOR.facts.problem) != (phase_of(LINK), LINK.problem):
        facts = facts_of(LINK, profile)
        at_once = (facts.phase, facts.problem) != (ACTUATOR.facts.phase, ACTUATOR.facts.problem)
        ACTUATOR.facts = facts
        if at_once or time.monotonic() - _shown_at > REDRAW_S:
            found = True
    if found:
        _shown_at = time.monotonic()
        redraw_tab()


def leave_file(*_: Any) -> None:
    """load_pre: what is felt belongs to the file that is left."""
    from .link import LINK

    LINK.release()


def _stop() -> None:
    """End what was begun; what was never begun is not imported for it."""
    if f"{__name__}.link" in sys.modules:
        from .link import LINK

        LINK.release()
    if f"{__name__}.finding" in sys.modules:
        from .finding import FINDER

        FINDER.end()


HANDLERS = (("load_pre", leave_file),)


def register() -> None:
    import bpy

    atexit.register(_stop)
    if not bpy.app.background:
        listen(HANDLERS)


def unregister() -> None:
    atexit.unregister(_stop)
    ignore(HANDLERS)
    _stop()
