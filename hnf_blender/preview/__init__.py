"""Hear and see a baked stroke: its stored bake, re-synthesis, playback, pictures."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from ..registration import add_handlers, remove_handlers
from . import timeline_playback
from .preview_state import PREVIEW, PreviewFacts, get_preview_facts, get_preview_icon

__all__ = ["PreviewFacts", "get_preview_facts", "get_preview_icon"]

INTERVAL_S = 0.04
BUSY_INTERVAL_S = 0.01
"""While a signal is on its way."""
TICK_BUDGET_S = 0.02
"""Of looking at strokes that are not the active one, in one tick."""
BUSY_DELAY_S = 0.5
"""From then on the panel says that a signal is on its way. To draw that at once would only keep it waiting: while
Blender draws, nothing is collected."""


class SceneSnapshot:
    """What is known of one scene that a window shows. seen: of which signals follow; drawn: what the panels show of the
    active stroke and the actuator, busy_since when. waiting: names of strokes to be looked at yet."""

    def __init__(self) -> None:
        self.inputs: object = None
        self.shown: object = None
        self.busy_since = math.inf
        self.pending: list[str] = []


_snapshots: dict[str, SceneSnapshot] = {}
"""By scene."""


def on_load_post(*_: Any) -> None:
    """load_post: nothing that was heard belongs to this file."""
    from .controller import stop

    stop()
    timeline_playback.on_playback_post()
    _snapshots.clear()
    if PREVIEW.synthesis_thread is not None:  # with what it kept and is still making of the other file's strokes
        PREVIEW.synthesis_thread.stop(wait=False)
        PREVIEW.synthesis_thread = None
    PREVIEW.clear()


def on_depsgraph_update(scene: Any, depsgraph: Any = None) -> None:
    """depsgraph_update_post: Blender draws after it, and what is asked for now is heard meanwhile."""
    import bpy

    if PREVIEW.synthesis_thread is None or depsgraph is None:
        return
    window = next((each for each in bpy.context.window_manager.windows if each.scene == scene), None)
    if window is not None and not window.screen.is_animation_playing:
        with bpy.context.temp_override(window=window):
            _request_preview(bpy.context, depsgraph)


def _request_preview(context: Any, depsgraph: Any) -> None:
    """Only for the stroke that the panels speak of, and where that takes no evaluation of Blender's: the timer does
    all else."""
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
    from hnf_core.errors import HnfError

    from ..bridge.stroke.animation import read_channel

    try:
        return read_channel(stroke, "force", scene).source == "driven"
    except HnfError:
        return True  # or broken, which the timer says


def tick() -> float:
    """Timer: take what was heard, ask for what changed, tell the panels. Looks at a counter while nothing happens."""
    import bpy

    from ..jobs.manager import is_preloaded

    windows = list(bpy.context.window_manager.windows)
    if not windows or not hasattr(bpy.types.Object, "hnf_stroke") or not is_preloaded():
        return INTERVAL_S
    update_scenes(windows)
    listening = PREVIEW.synthesis_thread is not None and PREVIEW.synthesis_thread.is_busy
    return BUSY_INTERVAL_S if listening else INTERVAL_S


def update_scenes(windows: Sequence[Any]) -> None:
    """Every scene that one of them shows, once; the first one's is what an actuator plays."""
    import bpy

    from . import controller

    controller.PLAYER.update()
    heard = controller.collect_results()
    ended = bool(PREVIEW.sounding) and not controller.PLAYER.is_playing
    if ended:
        PREVIEW.sounding = ""
    shown = {window.scene.name_full: window for window in reversed(windows)}
    first = windows[0].scene.name_full
    for name in _snapshots.keys() - shown.keys():
        del _snapshots[name]
    for name in (first, *(shown.keys() - {first})):
        own = {each for each in heard if each in shown[name].scene.objects}
        heard -= own  # an object may stand in both
        with bpy.context.temp_override(window=shown[name]):
            _update_scene(bpy.context, own, ended, is_first=name == first)


def _update_scene(context: Any, updated: set[str], ended: bool, *, is_first: bool) -> None:
    """The scene of context's window. heard: whose signals came, of its objects; ended: what sounded is over."""
    import bpy

    from .. import actuator
    from ..props.scene_settings import get_active_stroke, get_actuator_profile, list_cached_strokes
    from ..state.interface import redraw_tab
    from ..state.session_state import STATE
    from . import controller

    scene, active = context.scene, get_active_stroke(context)
    looked = _snapshots.setdefault(scene.name_full, SceneSnapshot())
    shown_now = None if active is None else PREVIEW.get_shown(active.name)
    if is_first and shown_now is None:
        actuator.tick(context)
    elif is_first and shown_now is not None:
        actuator.tick(context, shown_now.stamp, shown_now.signal)
    settings = scene.hnf
    seen = (
        STATE.changes, active and active.name, active and controller.get_image_style(context),
        get_actuator_profile(scene),
        settings.monitor_gain_db,
        tuple((name, status.freshness, status.why) for name, status in STATE.get_statuses(scene).items()),
    )  # fmt: skip
    if seen != looked.inputs:
        looked.inputs = seen
        others = list_cached_strokes(scene) if settings.follow_timeline else []
        PREVIEW.discard_except({obj.name for obj in bpy.data.objects})
        looked.pending[:] = [obj.name for obj in others if obj != active]
        if active is not None:
            controller.refresh(active, context, wait=False)
            controller.update_outdated_strips(active, scene)
    until = time.monotonic() + TICK_BUDGET_S
    while looked.pending and time.monotonic() < until:
        other = scene.objects.get(looked.pending.pop(0))
        if other is not None:
            controller.refresh(other, context, wait=False, first=False)
    shown = active.name if active is not None else ""
    for name in updated | {shown} - {""}:
        controller.update_facts(name, scene)
    drawn = shown, _delay_busy(PREVIEW.facts.get(shown), looked), get_actuator_profile(scene)
    if updated or ended or drawn != looked.shown:
        looked.shown = drawn
        redraw_tab()
    _update_playback(context, updated, context.window.screen.is_animation_playing)


def _delay_busy(facts: PreviewFacts | None, snapshot: SceneSnapshot) -> PreviewFacts | None:
    """Facts as the panel is to show them: busy only after BUSY_S."""
    if facts is None or not facts.busy:
        snapshot.busy_since = math.inf
        return facts
    snapshot.busy_since = min(snapshot.busy_since, time.monotonic())
    return facts if time.monotonic() - snapshot.busy_since >= BUSY_DELAY_S else facts._replace(busy=False)


def _update_playback(context: Any, updated: set[str], timeline_plays: bool) -> None:
    """What was waited for is played; what sounds goes on as it is now."""
    from hnf_core.errors import HnfError

    from . import controller

    is_ready = PREVIEW.play_when_ready in updated
    if is_ready or PREVIEW.sounding in updated:
        name, begin = PREVIEW.sounding, controller.continue_playback
        if is_ready:
            name, begin, PREVIEW.play_when_ready = PREVIEW.play_when_ready, controller.play, ""
        try:
            begin(name, context.scene)
        except HnfError as error:
            PREVIEW.problems[name] = str(error)
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
