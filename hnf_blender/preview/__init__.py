"""Preview of strokes: a stroke object and its stored bake → signal, image and playback.

A timer resynthesises strokes whose inputs changed and updates the panels. This file holds the handlers and the timer;
read `controller.py` first, then `synthesis_thread.py`.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from typing import Any

from .. import compat
from ..registration import add_handlers, remove_handlers
from . import timeline_playback
from .preview_state import PREVIEW, PreviewFacts, get_preview_facts, get_preview_icon
from .strips_and_speakers import has_linked_strips

__all__ = ["PreviewFacts", "get_preview_facts", "get_preview_icon"]

INTERVAL_S = 0.04
"""Interval of the timer while nothing is being synthesized [s]."""
BUSY_INTERVAL_S = 0.01
"""Interval of the timer while a signal is being synthesized [s]."""
TICK_BUDGET_S = 0.02
"""Time per tick for checking strokes other than the active one [s]."""
BUSY_DELAY_S = 0.5
"""Time after which the panel shows that a signal is being synthesized [s].

Showing it at once would delay the signal: no results are collected while Blender draws.
"""


class SceneSnapshot:
    """State of a scene at the last tick of the timer, to notice changes.

    Attributes
    ----------
    inputs : object
        Everything that the scene's signals depend on.
    shown : object
        What the panels show of the active stroke and the actuator.
    busy_since : float
        Monotonic time since which the active stroke is being synthesized [s]; infinite if it is not.
    pending : list of str
        Names of strokes that are still to be checked.
    """

    def __init__(self) -> None:
        self.inputs: object = None
        self.shown: object = None
        self.busy_since = math.inf
        self.pending: list[str] = []


_snapshots: dict[str, SceneSnapshot] = {}
"""Snapshots by scene name."""


def on_load_post(*_: Any) -> None:
    """Discard signals and results of the previous file (handler load_post)."""
    from .controller import stop

    stop()
    timeline_playback.on_playback_post()
    _snapshots.clear()
    if PREVIEW.synthesis_thread is not None:  # The thread's cache and results belong to the previous file.
        PREVIEW.synthesis_thread.stop(wait=False)
        PREVIEW.synthesis_thread = None
    PREVIEW.clear()


def on_depsgraph_update(scene: Any, depsgraph: Any = None) -> None:
    """Request the active stroke's signal, which is synthesized while Blender draws (handler depsgraph_update_post)."""
    import bpy

    if PREVIEW.synthesis_thread is None or depsgraph is None:
        return
    window = next((candidate for candidate in bpy.context.window_manager.windows if candidate.scene == scene), None)
    if window is not None and not window.screen.is_animation_playing:
        with bpy.context.temp_override(window=window):
            _request_preview(bpy.context, depsgraph)


def _request_preview(context: Any, depsgraph: Any) -> None:
    """Request a signal for the active stroke if no evaluation by Blender is needed; the timer does all else."""
    from ..props.scene_settings import get_active_stroke
    from ..state.session_state import STATE
    from ..state.status_tracker import get_changed_names, get_stroke_data_names
    from . import controller

    if STATE.suppress_depth:
        return
    active = get_active_stroke(context)
    if (
        active is not None
        and get_stroke_data_names(active) & get_changed_names(depsgraph)
        and not _is_driven(active, context.scene)
    ):
        controller.refresh(active, context, wait=False)


def _is_driven(stroke: Any, scene: Any) -> bool:
    """Return whether the stroke's force is driven or cannot be read."""
    from hnf_core.errors import HnfError

    from ..bridge.stroke.animation import read_channel

    try:
        return read_channel(stroke, "force", scene).source == "driven"
    except HnfError:
        return True  # A broken channel is reported by the timer.


def tick() -> float:
    """Collect results, request signals for changed strokes and update the panels; return the next interval [s]."""
    import bpy

    from ..jobs.manager import is_preloaded

    windows = list(bpy.context.window_manager.windows)
    if not windows or not hasattr(bpy.types.Object, "hnf_stroke") or not is_preloaded():
        return INTERVAL_S
    update_scenes(windows)
    is_synthesising = PREVIEW.synthesis_thread is not None and PREVIEW.synthesis_thread.is_busy
    return BUSY_INTERVAL_S if is_synthesising else INTERVAL_S


def update_scenes(windows: Sequence[Any]) -> None:
    """Update every scene that the windows show, once each; an actuator plays the first window's scene."""
    import bpy

    from . import controller

    controller.PLAYER.update()
    updated = controller.collect_results()
    ended = bool(PREVIEW.sounding) and not controller.PLAYER.is_playing
    if ended:
        PREVIEW.sounding = ""
    scene_windows = {window.scene.name_full: window for window in reversed(windows)}
    first_scene = windows[0].scene.name_full
    for name in _snapshots.keys() - scene_windows.keys():
        del _snapshots[name]
    for name in (first_scene, *(scene_windows.keys() - {first_scene})):
        scene_updates = {stroke_name for stroke_name in updated if stroke_name in scene_windows[name].scene.objects}
        updated -= scene_updates  # An object may be in both scenes.
        with bpy.context.temp_override(window=scene_windows[name]):
            _update_scene(bpy.context, scene_updates, ended, is_first=name == first_scene)


def _update_scene(context: Any, updated: set[str], ended: bool, *, is_first: bool) -> None:
    """Update the scene of the context's window.

    Parameters
    ----------
    context : bpy.types.Context
        Overridden with the window.
    updated : set of str
        Names of the scene's strokes with a new signal.
    ended : bool
        Whether playback has just ended.
    is_first : bool
        Whether the scene is the first window's, which the actuator follows.
    """
    import bpy

    from .. import actuator
    from ..props.scene_settings import get_active_stroke, get_actuator_profile, list_cached_strokes
    from ..state.interface import redraw_tab
    from ..state.session_state import STATE
    from . import controller

    scene, active = context.scene, get_active_stroke(context)
    snapshot = _snapshots.setdefault(scene.name_full, SceneSnapshot())
    shown_now = None if active is None else PREVIEW.get_shown(active.name)
    if is_first and shown_now is None:
        actuator.tick(context)
    elif is_first and shown_now is not None:
        actuator.tick(context, shown_now.stamp, shown_now.signal)
    settings = scene.hnf
    inputs = (
        STATE.changes, active and active.name, active and controller.get_image_style(context, active.name),
        get_actuator_profile(scene),
        settings.monitor_gain_db,
        tuple((name, status.freshness, status.why) for name, status in STATE.get_statuses(scene).items()),
    )  # fmt: skip
    if inputs != snapshot.inputs:
        snapshot.inputs = inputs
        cached_strokes = list_cached_strokes(scene) if settings.follow_timeline else []
        PREVIEW.discard_except({obj.name for obj in bpy.data.objects})
        snapshot.pending[:] = [obj.name for obj in cached_strokes if obj != active]
        if active is not None:
            controller.refresh(active, context, wait=False)
            controller.update_outdated_strips(active, scene)
    deadline = time.monotonic() + TICK_BUDGET_S
    while snapshot.pending and time.monotonic() < deadline:
        stroke = scene.objects.get(snapshot.pending.pop(0))
        if stroke is not None:
            controller.refresh(stroke, context, wait=False, first=False)
    shown = active.name if active is not None else ""
    for name in updated | {shown} - {""}:
        controller.update_facts(name, scene)
    if scene.sequence_editor is not None and has_linked_strips(scene):
        compat.show_in_sequencer(context.window.workspace, scene)  # A workspace that was added since shows no scene.
    panel_state = shown, _delay_busy(PREVIEW.facts.get(shown), snapshot), get_actuator_profile(scene)
    has_moved = active is not None and controller.update_playhead(active, scene)
    if updated or ended or has_moved or panel_state != snapshot.shown:
        snapshot.shown = panel_state
        redraw_tab()
    _update_playback(context, updated, context.window.screen.is_animation_playing)


def _delay_busy(facts: PreviewFacts | None, snapshot: SceneSnapshot) -> PreviewFacts | None:
    """Return the facts that the panel shows, in which a synthesis counts as running only after BUSY_DELAY_S."""
    if facts is None or not facts.busy:
        snapshot.busy_since = math.inf
        return facts
    snapshot.busy_since = min(snapshot.busy_since, time.monotonic())
    return facts if time.monotonic() - snapshot.busy_since >= BUSY_DELAY_S else facts._replace(busy=False)


def _update_playback(context: Any, updated: set[str], timeline_plays: bool) -> None:
    """Play the stroke that waited for its signal, and continue playing strokes with their new signals."""
    from hnf_core.errors import HnfError

    from . import controller

    is_ready = PREVIEW.play_when_ready in updated
    if is_ready or PREVIEW.sounding in updated:
        name, start = PREVIEW.sounding, controller.continue_playback
        if is_ready:
            name, start, PREVIEW.play_when_ready = PREVIEW.play_when_ready, controller.play, ""
        with contextlib.suppress(HnfError):  # It is in PREVIEW.sound_problem; the signal itself holds.
            start(name, context.scene)
        controller.update_facts(name, context.scene)
    elif updated and timeline_plays and timeline_playback.FOLLOWER.is_playing(context.scene):
        timeline_playback.FOLLOWER.wait(context.scene)


HANDLERS = (
    ("depsgraph_update_post", on_depsgraph_update),
    ("animation_playback_pre", timeline_playback.on_playback_pre),
    ("animation_playback_post", timeline_playback.on_playback_post),
    ("frame_change_post", timeline_playback.on_frame_change),
    ("load_post", on_load_post),
)


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    add_handlers(HANDLERS, tick, INTERVAL_S)


def unregister() -> None:
    from ..state import interface
    from . import controller

    remove_handlers(HANDLERS, tick)
    if PREVIEW.synthesis_thread is not None:
        PREVIEW.synthesis_thread.stop()
        PREVIEW.synthesis_thread = None
    controller.PLAYER.release()
    interface.release_icons()
    PREVIEW.clear()
