"""Play strokes on an actuator: from Blender's window to a child process that streams samples to the device.

This file holds the timer's tick, the handlers and the registration; read `player_client.py` first.
"""

from __future__ import annotations

import atexit
import sys
import time
from typing import TYPE_CHECKING, Any

from ..registration import add_handlers, remove_handlers

if TYPE_CHECKING:
    from hnf_core.signal import Signal

REDRAW_INTERVAL_S = 0.2
"""Shortest time between two redraws of the panel while only the level changes [s]."""

_redrawn_at = 0.0


def tick(context: Any, stamp: str = "", signal: Signal | None = None) -> None:
    """Read the messages of the child processes and redraw the panel if they changed something.

    The preview's timer calls it; without a child process it makes a few comparisons only.

    Parameters
    ----------
    context : bpy.types.Context
        Its scene gives the actuator profile.
    stamp : str
        Identifies `signal`; equal stamps mean equal signals.
    signal : Signal or None
        The signal that the preview shows; None if it shows none.
    """
    global _redrawn_at
    from ..props.scene_settings import PROFILE_FROM_FILE, get_actuator_profile
    from ..state.interface import redraw_tab
    from .actuator_state import ACTUATOR, VIRTUAL, get_selected_output
    from .player_client import PLAYER_CLIENT, get_phase, make_facts
    from .player_process import DEVICE_SCANNER
    from .skin_preview import SKIN_PREVIEW, describe_estimate

    profile = get_actuator_profile(context.scene)
    redraw = DEVICE_SCANNER.tick()
    has_reports = PLAYER_CLIENT.tick()
    is_virtual = get_selected_output(context) == VIRTUAL
    estimated_signal = signal if is_virtual or context.scene.hnf.actuator == PROFILE_FROM_FILE else None
    if SKIN_PREVIEW.update((stamp, profile, is_virtual), estimated_signal, profile, virtual=is_virtual):
        ACTUATOR.skin_lines, redraw = describe_estimate(SKIN_PREVIEW.estimate), True
    if has_reports or (ACTUATOR.facts.phase, ACTUATOR.facts.problem) != (
        get_phase(PLAYER_CLIENT),
        PLAYER_CLIENT.problem,
    ):
        facts = make_facts(PLAYER_CLIENT, profile)
        is_urgent = (facts.phase, facts.problem) != (ACTUATOR.facts.phase, ACTUATOR.facts.problem)
        ACTUATOR.facts = facts
        if is_urgent or time.monotonic() - _redrawn_at > REDRAW_INTERVAL_S:
            redraw = True
    if redraw:
        _redrawn_at = time.monotonic()
        redraw_tab()


def on_load_pre(*_: Any) -> None:
    """Stop the player before another file is loaded (handler load_pre)."""
    from .player_client import PLAYER_CLIENT

    PLAYER_CLIENT.release()


def _shut_down() -> None:
    """Stop the child processes that were started, without importing modules that were never used."""
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
