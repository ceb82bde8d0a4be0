"""How long Blender waits for us while a bake runs beside it: start, ticks, handlers, looks at changes, commit, end.

The window is played: its timers' calls are made by hand at their own pace, with an edit now and then, so that every
call is seen from the outside. The tab is drawn into a hollow layout, once a tick as in the window; what Blender itself
makes of it is not in it (tests/app times that in a real window).
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from hnf_core.bench.frame import Options, Row, Times
from hnf_core.errors import HnfError

from .hollow import draw_tab, tab_on
from .needs import need_bpy
from .stage import CUTS, QUICK_CUTS, STROKES, plate_with_strokes, playing, stroke_names

NAME = "responsiveness"
JOB_TICK_S, LOOK_TICK_S, EDIT_S, STEP_S = 0.1, 0.25, 0.5, 0.01
LIMIT_S = 300.0
CANCEL_AT_S = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
"""After the start; the child loads Blender in the first second."""

WHOLE = "the whole bake, beside the window"
DRAW = "draw the tab"

Waits = dict[str, Times]


def rows(options: Options) -> list[Row]:
    """One row for each kind of call, of all bakes together. Raises HnfError without bpy, or where a bake fails.

    Empties the file that is open.
    """
    need_bpy(NAME)
    waits: Waits = defaultdict(Times)
    for repeat in range(options.repeats):
        options.watch(f"{NAME}: bake {repeat + 1} of {options.repeats}")
        with playing() as (scene, layer), tab_on():
            faces = len(plate_with_strokes(QUICK_CUTS if options.quick else CUTS).data.polygons)
            _saved_copy(waits)
            for pause in CANCEL_AT_S[:1] if options.quick else CANCEL_AT_S:
                _started_and_cancelled(scene, layer, waits, pause)
            _baked(scene, layer, waits)
    notes = {
        "save a copy": f"{faces:,} faces",
        "start": "the copy, the order, the child process",
        "cancel": f"{', '.join(f'{pause:g}' for pause in CANCEL_AT_S)} s after the start",
        DRAW: "every panel open, into a hollow layout",
        WHOLE: f"{STROKES} strokes, no close-up there yet",
    }
    return [Row(NAME, name, found.seconds, found.cpu, note=notes.get(name, "")) for name, found in waits.items()]


def _baked(scene: Any, layer: Any, waits: Waits) -> None:
    """A bake to its end, every call of ours timed."""
    import bpy

    from ..handlers import note_changes
    from ..jobs import current
    from ..jobs.running import Bake
    from ..state.session import STATE
    from ..state.watch import drain

    def told(changed: Any, depsgraph: Any) -> None:
        waits["handler"].take(lambda: note_changes(changed, depsgraph))

    stroke = scene.objects["Beside"]
    began = time.perf_counter()
    bake: Bake = waits["start"].take(lambda: current.start(scene, layer, stroke_names()))
    next_job = next_look = next_edit = 0.0
    bpy.app.handlers.depsgraph_update_post.append(told)
    try:
        ended = None
        while ended is None:
            now = time.perf_counter() - began
            if now > LIMIT_S:
                raise HnfError(f"the bake did not end within {LIMIT_S:g} s.", where=NAME)
            if now >= next_edit:
                next_edit = now + EDIT_S
                stroke.location.z += 1e-5
                layer.update()
            if now >= next_look:
                next_look = now + LOOK_TICK_S
                waits["look at what changed"].take(lambda: drain(((scene, layer),)))
            if now >= next_job:
                next_job = now + JOB_TICK_S
                stage = "tick, commit" if bake.is_committing else "tick, child at work"
                ended = waits[stage].take(current.tick)
                waits[DRAW].take(lambda: draw_tab(scene, layer))
            time.sleep(STEP_S)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(told)
        current.cancel()
    if not ended.ok:
        raise HnfError(f"the bake failed: {ended.message}", where=NAME)
    waits[WHOLE].note(time.perf_counter() - began)
    STATE.dirty.clear()


def _saved_copy(waits: Waits) -> None:
    from ..jobs.running import save_copy

    with tempfile.TemporaryDirectory() as folder:
        waits["save a copy"].take(lambda: save_copy(Path(folder) / "copy.blend"))


def _started_and_cancelled(scene: Any, layer: Any, waits: Waits, pause: float) -> None:
    from ..jobs import current
    from ..jobs.folder import is_alive

    bake = current.start(scene, layer, stroke_names())
    time.sleep(pause)
    current.tick()
    pid = bake.pid
    started = time.perf_counter()
    waits["cancel"].take(current.cancel)
    while pid is not None and is_alive(pid):
        time.sleep(0.001)
    waits["cancel → the child is gone"].note(time.perf_counter() - started)
