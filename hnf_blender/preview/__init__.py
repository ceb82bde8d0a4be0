"""Hear and see a baked stroke: its stored bake, re-synthesis, playback, pictures."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

from . import timeline
from .facts import PREVIEW, PreviewFacts, preview_facts, preview_icon

__all__ = ["PreviewFacts", "preview_facts", "preview_icon"]

INTERVAL_S = 0.04
LISTENING_INTERVAL_S = 0.01
"""While a signal is on its way."""
HANDLERS = (
    ("animation_playback_pre", timeline.playback_begins),
    ("animation_playback_post", timeline.playback_ends),
    ("frame_change_post", timeline.frame_shown),
)

BUDGET_S = 0.02
"""Of looking at strokes that are not the active one, in one tick."""
BUSY_S = 0.5
"""From then on the panel says that a signal is on its way. To draw that at once would only keep it waiting: while
Blender draws, nothing is collected."""

_seen: object = None
_drawn: object = None
_busy_since = math.inf
_waiting: list[str] = []


def enter_file(*_: Any) -> None:
    """load_post: nothing that was heard belongs to this file."""
    from .current import stop

    stop()
    timeline.FOLLOWER.begun_at = None
    _waiting.clear()
    if PREVIEW.listener is not None:  # with what it kept and is still making of the other file's strokes
        PREVIEW.listener.end(wait=False)
        PREVIEW.listener = None
    PREVIEW.clear()


def tick() -> float:
    """Timer: take what was heard, ask for what changed, tell the panels. Looks at a counter while nothing happens."""
    import bpy

    from ..state.warm import is_ready

    window = next(iter(bpy.context.window_manager.windows), None)
    if window is None or not hasattr(bpy.types.Object, "hnf_stroke") or not is_ready():
        return INTERVAL_S
    with bpy.context.temp_override(window=window):
        _look(bpy.context, window.screen.is_animation_playing)
    listening = PREVIEW.listener is not None and PREVIEW.listener.is_busy
    return LISTENING_INTERVAL_S if listening else INTERVAL_S


def _look(context: Any, timeline_plays: bool) -> None:
    global _seen, _drawn
    import bpy

    from .. import actuator
    from ..props.scene import active_stroke, actuator_of, strokes_of
    from ..state.redraw import redraw_tab
    from ..state.session import STATE
    from . import current

    scene, active = context.scene, active_stroke(context)
    shown_now = None if active is None else PREVIEW.shown(active.name)
    if shown_now is None:
        actuator.tick(context)
    else:
        actuator.tick(context, shown_now.stamp, shown_now.signal)
    heard = current.collect()
    settings = scene.hnf
    seen = (
        STATE.changes, scene.name, active and active.name, actuator_of(scene), settings.monitor_gain_db,
        tuple((name, status.freshness, status.why) for name, status in STATE.strokes.items()),
    )  # fmt: skip
    ended = bool(PREVIEW.sounding) and not current.PLAYER.is_playing
    if ended:
        PREVIEW.sounding = ""
    if seen != _seen:
        _seen = seen
        others = strokes_of(scene) if settings.follow_timeline else []
        PREVIEW.keep_only({obj.name for obj in bpy.data.objects})
        _waiting.clear()
        _waiting.extend(obj.name for obj in others if obj != active)
        if active is not None:
            current.refresh(active, context, wait=False)
    until = time.monotonic() + BUDGET_S
    while _waiting and time.monotonic() < until:
        other = scene.objects.get(_waiting.pop(0))
        if other is not None:
            current.refresh(other, context, wait=False, first=False)
    shown = active.name if active is not None else ""
    for name in heard | {shown} - {""}:
        current.tell(name, scene)
    drawn = shown, _worth_drawing(PREVIEW.facts.get(shown))
    if heard or ended or drawn != _drawn:
        _drawn = drawn
        redraw_tab()
    _sound(context, heard, timeline_plays)


def _worth_drawing(facts: PreviewFacts | None) -> PreviewFacts | None:
    """Facts as the panel is to show them: busy only after BUSY_S."""
    global _busy_since
    if facts is None or not facts.busy:
        _busy_since = math.inf
        return facts
    _busy_since = min(_busy_since, time.monotonic())
    return facts if time.monotonic() - _busy_since >= BUSY_S else replace(facts, busy=False)


def _sound(context: Any, heard: set[str], timeline_plays: bool) -> None:
    """What was waited for is played; what sounds goes on as it is now."""
    from hnf_core.errors import HnfError

    from . import current

    if PREVIEW.play_when_ready in heard or PREVIEW.sounding in heard:
        name = PREVIEW.play_when_ready or PREVIEW.sounding
        begin = current.play if PREVIEW.play_when_ready else current.go_on
        PREVIEW.play_when_ready = ""
        try:
            begin(name, context.scene)
        except HnfError as error:
            PREVIEW.problems[name] = str(error)
        current.tell(name, context.scene)
    elif heard and timeline_plays and timeline.FOLLOWER.begun_at is not None:
        timeline.FOLLOWER.start(context.scene)


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(handler))
    bpy.app.handlers.load_post.append(bpy.app.handlers.persistent(enter_file))
    bpy.app.timers.register(tick, first_interval=INTERVAL_S, persistent=True)


def unregister() -> None:
    import bpy

    from . import current, images

    for name, handler in (*HANDLERS, ("load_post", enter_file)):
        listed = getattr(bpy.app.handlers, name)
        if handler in listed:
            listed.remove(handler)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    if PREVIEW.listener is not None:
        PREVIEW.listener.end()
        PREVIEW.listener = None
    current.PLAYER.release()
    images.release()
    PREVIEW.clear()
