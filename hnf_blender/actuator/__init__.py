"""The actuator: where strokes are felt, the process that plays there, and a hand that touches live."""

from __future__ import annotations

import atexit
import sys
import time
from typing import TYPE_CHECKING, Any

from ..registration import add_handlers, remove_handlers

if TYPE_CHECKING:
    from hnf_core.signal import Signal

REDRAW_INTERVAL_S = 0.2
"""Least time between two pictures of a level that moves."""

_redrawn_at = 0.0


def tick(context: Any, stamp: str = "", signal: Signal | None = None) -> None:
    """Called by the preview's timer: take in what the processes said, tell the panel. Some comparisons while none
    runs. signal: that the preview shows, known by its stamp; None where it shows none."""
    global _redrawn_at
    from ..props.scene_settings import PROFILE_FROM_FILE, get_actuator_profile
    from ..state.interface import redraw_tab
    from .actuator_state import ACTUATOR, VIRTUAL, get_selected_output
    from .player_client import PLAYER_CLIENT, get_phase, make_facts
    from .player_process import DEVICE_SCANNER
    from .skin_preview import SKIN_PREVIEW, describe_estimate

    profile = get_actuator_profile(context.scene)
    found = DEVICE_SCANNER.tick()
    told = PLAYER_CLIENT.tick()
    virtual = get_selected_output(context) == VIRTUAL
    worth = signal if virtual or context.scene.hnf.actuator == PROFILE_FROM_FILE else None
    if SKIN_PREVIEW.update((stamp, profile, virtual), worth, profile, virtual=virtual):
        ACTUATOR.skin_lines, found = describe_estimate(SKIN_PREVIEW.estimate), True
    if told or (ACTUATOR.facts.phase, ACTUATOR.facts.problem) != (get_phase(PLAYER_CLIENT), PLAYER_CLIENT.problem):
        facts = make_facts(PLAYER_CLIENT, profile)
        at_once = (facts.phase, facts.problem) != (ACTUATOR.facts.phase, ACTUATOR.facts.problem)
        ACTUATOR.facts = facts
        if at_once or time.monotonic() - _redrawn_at > REDRAW_INTERVAL_S:
            found = True
    if found:
        _redrawn_at = time.monotonic()
        redraw_tab()


def on_load_pre(*_: Any) -> None:
    """load_pre: what is felt belongs to the file that is left."""
    from .player_client import PLAYER_CLIENT

    PLAYER_CLIENT.release()


def _shut_down() -> None:
    """End what was begun; what was never begun is not imported for it."""
    if f"{__name__}.player_client" in sys.modules:
        from .player_client import PLAYER_CLIENT

        PLAYER_CLIENT.release()
    if f"{__name__}.player_process" in sys.modules:
        from .player_process import DEVICE_SCANNER

        DEVICE_SCANNER.stop()


HANDLERS = (("load_pre", on_load_pre),)


def register() -> None:
    import bpy

    atexit.register(_shut_down)
    if not bpy.app.background:
        add_handlers(HANDLERS)


def unregister() -> None:
    atexit.unregister(_shut_down)
    remove_handlers(HANDLERS)
    _shut_down()
