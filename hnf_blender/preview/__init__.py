"""Hear and see a baked stroke: its stored bake, re-synthesis, playback, pictures."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from ..rooms import ignore, listen
from . import timeline
from .facts import PREVIEW, PreviewFacts, preview_facts, preview_icon

__all__ = ["PreviewFacts", "preview_facts", "preview_icon"]

INTERVAL_S = 0.04
LISTENING_INTERVAL_S = 0.01
"""While a signal is on its way."""
BUDGET_S = 0.02
"""Of looking at strokes that are not the active one, in one tick."""
BUSY_S = 0.5
"""From then on the panel says that a signal is on its way. To draw that at once would only keep it waiting: while
Blender draws, nothing is collected."""


class Looked:
    """What is known of one scene that a window shows. seen: of which signals follow; drawn: what the panels show of the
    active stroke and the actuator, busy_since when. waiting: names of strokes to be looked at yet."""

    def __init__(self) -> None:
        self.seen: object = None
        self.drawn: object = None
        self.busy_since = math.inf
        self.waiting: list[str] = []


_looked: dict[str, Looked] = {}
"""By scene."""


def enter_file(*_: Any) -> None:
    """load_post: nothing that was heard belongs to this file."""
    from .current import stop

    stop()
    timeline.playback_ends()
    _looked.clear()
    if PREVIEW.listener is not None:  # with what it kept and is still making of the other file's strokes
        PREVIEW.listener.end(wait=False)
        PREVIEW.listener = None
    PREVIEW.clear()


def ask_at_once(scene: Any, depsgraph: Any = None) -> None:
    """depsgraph_update_post: Blender draws after it, and what is asked for now is heard meanwhile."""
    import bpy

    if PREVIEW.listener is None or depsgraph is None:
        return
    window = next((each for each in bpy.context.window_manager.windows if each.scene == scene), None)
    if window is not None and not window.screen.is_animation_playing:
        with bpy.context.temp_override(window=window):
            _ask(bpy.context, depsgraph)


def _ask(context: Any, depsgraph: Any) -> None:
    """Only for the stroke that the panels speak of, and where that takes no evaluation of Blender's: the timer does
    all else."""
    from ..props.scene import active_stroke
    from ..state.session import STATE
    from ..state.watch import changed_names, parts_of
    from . import current

    if STATE.own:
        return
    active = active_stroke(context)
    if active is not None and parts_of(active) & changed_names(depsgraph) and not _is_driven(active, context.scene):
        current.refresh(active, context, wait=False)


def _is_driven(stroke: Any, scene: Any) -> bool:
    from hnf_core.errors import HnfError

    from ..bridge.channels import read_channel

    try:
        return read_channel(stroke, "force", scene).source == "driven"
    except HnfError:
        return True  # or broken, which the timer says


def tick() -> float:
    """Timer: take what was heard, ask for what changed, tell the panels. Looks at a counter while nothing happens."""
    import bpy

    from ..jobs.warm import is_ready

    windows = list(bpy.context.window_manager.windows)
    if not windows or not hasattr(bpy.types.Object, "hnf_stroke") or not is_ready():
        return INTERVAL_S
    look_at(windows)
    listening = PREVIEW.listener is not None and PREVIEW.listener.is_busy
    return LISTENING_INTERVAL_S if listening else INTERVAL_S


def look_at(windows: Sequence[Any]) -> None:
    """Every scene that one of them shows, once; the first one's is what an actuator plays."""
    import bpy

    from . import current

    current.PLAYER.settle()
    heard = current.collect()
    ended = bool(PREVIEW.sounding) and not current.PLAYER.is_playing
    if ended:
        PREVIEW.sounding = ""
    shown = {window.scene.name_full: window for window in reversed(windows)}
    first = windows[0].scene.name_full
    for name in _looked.keys() - shown.keys():
        del _looked[name]
    for name in (first, *(shown.keys() - {first})):
        own = {each for each in heard if each in shown[name].scene.objects}
        heard -= own  # an object may stand in both
        with bpy.context.temp_override(window=shown[name]):
            _look(bpy.context, own, ended, is_first=name == first)


def _look(context: Any, heard: set[str], ended: bool, *, is_first: bool) -> None:
    """The scene of context's window. heard: whose signals came, of its objects; ended: what sounded is over."""
    import bpy

    from .. import actuator
    from ..props.scene import active_stroke, actuator_of, listed_strokes
    from ..state.redraw import redraw_tab
    from ..state.session import STATE
    from . import current

    scene, active = context.scene, active_stroke(context)
    looked = _looked.setdefault(scene.name_full, Looked())
    shown_now = None if active is None else PREVIEW.shown(active.name)
    if is_first and shown_now is None:
        actuator.tick(context)
    elif is_first and shown_now is not None:
        actuator.tick(context, shown_now.stamp, shown_now.signal)
    settings = scene.hnf
    seen = (
        STATE.changes, active and active.name, active and current.look_of(context), actuator_of(scene),
        settings.monitor_gain_db,
        tuple((name, status.freshness, status.why) for name, status in STATE.strokes_in(scene).items()),
    )  # fmt: skip
    if seen != looked.seen:
        looked.seen = seen
        others = listed_strokes(scene) if settings.follow_timeline else []
        PREVIEW.keep_only({obj.name for obj in bpy.data.objects})
        looked.waiting[:] = [obj.name for obj in others if obj != active]
        if active is not None:
            current.refresh(active, context, wait=False)
            current.look_behind(active, scene)
    until = time.monotonic() + BUDGET_S
    while looked.waiting and time.monotonic() < until:
        other = scene.objects.get(looked.waiting.pop(0))
        if other is not None:
            current.refresh(other, context, wait=False, first=False)
    shown = active.name if active is not None else ""
    for name in heard | {shown} - {""}:
        current.tell(name, scene)
    drawn = shown, _worth_drawing(PREVIEW.facts.get(shown), looked), actuator_of(scene)
    if heard or ended or drawn != looked.drawn:
        looked.drawn = drawn
        redraw_tab()
    _sound(context, heard, context.window.screen.is_animation_playing)


def _worth_drawing(facts: PreviewFacts | None, looked: Looked) -> PreviewFacts | None:
    """Facts as the panel is to show them: busy only after BUSY_S."""
    if facts is None or not facts.busy:
        looked.busy_since = math.inf
        return facts
    looked.busy_since = min(looked.busy_since, time.monotonic())
    return facts if time.monotonic() - looked.busy_since >= BUSY_S else facts._replace(busy=False)


def _sound(context: Any, heard: set[str], timeline_plays: bool) -> None:
    """What was waited for is played; what sounds goes on as it is now."""
    from hnf_core.errors import HnfError

    from . import current

    is_ready = PREVIEW.play_when_ready in heard
    if is_ready or PREVIEW.sounding in heard:
        name, begin = PREVIEW.sounding, current.go_on
        if is_ready:
            name, begin, PREVIEW.play_when_ready = PREVIEW.play_when_ready, current.play, ""
        try:
            begin(name, context.scene)
        except HnfError as error:
            PREVIEW.problems[name] = str(error)
        current.tell(name, context.scene)
    elif heard and timeline_plays and timeline.FOLLOWER.plays(context.scene):
        timeline.FOLLOWER.wait(context.scene)


HANDLERS = (
    ("depsgraph_update_post", ask_at_once),
    ("animation_playback_pre", timeline.playback_begins),
    ("animation_playback_post", timeline.playback_ends),
    ("frame_change_post", timeline.frame_shown),
    ("load_post", enter_file),
)


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    listen(HANDLERS, tick, INTERVAL_S)


def unregister() -> None:
    from ..state import icons
    from . import current

    ignore(HANDLERS, tick)
    if PREVIEW.listener is not None:
        PREVIEW.listener.end()
        PREVIEW.listener = None
    current.PLAYER.release()
    icons.release()
    PREVIEW.clear()
