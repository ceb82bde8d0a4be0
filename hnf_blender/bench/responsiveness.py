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

from hnf_core.bench.frame import BenchOptions, Row, Times
from hnf_core.errors import HnfError

from .hollow import draw_tab, register_tab
from .needs import require_bpy
from .stage import PLATE_CUTS, QUICK_PLATE_CUTS, STROKE_COUNT, add_plate_with_strokes, list_stroke_names, open_test_file

RESPONSIVENESS_NAME = "responsiveness"
JOB_TICK_S, CHECK_TICK_S, EDIT_S, STEP_S = 0.1, 0.25, 0.5, 0.01
MAX_BAKE_S = 300.0
CANCEL_AT_S = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
"""After the start; the child loads Blender in the first second."""

COMPLETE_BAKE = "the whole bake, beside the window"
DRAW_TAB = "draw the tab"

WaitTimes = dict[str, Times]


def measure_responsiveness(options: BenchOptions) -> list[Row]:
    """One row for each kind of call, of all bakes together. Raises HnfError without bpy, or where a bake fails.

    Empties the file that is open.
    """
    require_bpy(RESPONSIVENESS_NAME)
    waits: WaitTimes = defaultdict(Times)
    for repeat in range(options.repeats):
        options.watch(f"{RESPONSIVENESS_NAME}: bake {repeat + 1} of {options.repeats}")
        with open_test_file() as (scene, layer), register_tab():
            faces = len(add_plate_with_strokes(QUICK_PLATE_CUTS if options.quick else PLATE_CUTS).data.polygons)
            _measure_copy(waits)
            for pause in CANCEL_AT_S[:1] if options.quick else CANCEL_AT_S:
                _measure_cancel(scene, layer, waits, pause)
            _measure_bake(scene, layer, waits)
    notes = {
        "save a copy": f"{faces:,} faces",
        "start": "the copy, the order, the child process",
        "cancel": f"{', '.join(f'{pause:g}' for pause in CANCEL_AT_S)} s after the start",
        DRAW_TAB: "every panel open, into a hollow layout",
        COMPLETE_BAKE: f"{STROKE_COUNT} strokes, no close-up there yet",
    }
    return [
        Row(RESPONSIVENESS_NAME, name, found.seconds, found.cpu, note=notes.get(name, ""))
        for name, found in waits.items()
    ]


def _measure_bake(scene: Any, layer: Any, waits: WaitTimes) -> None:
    """A bake to its end, every call of ours timed."""
    import bpy

    from ..handlers import on_depsgraph_update
    from ..jobs import current
    from ..jobs.running import BakeJob
    from ..state.session import STATE
    from ..state.watch import process_changes

    def told(changed: Any, depsgraph: Any) -> None:
        waits["handler"].measure(lambda: on_depsgraph_update(changed, depsgraph))

    stroke = scene.objects["Beside"]
    began = time.perf_counter()
    bake: BakeJob = waits["start"].measure(lambda: current.start_bake(scene, layer, list_stroke_names()))
    next_job = next_look = next_edit = 0.0
    bpy.app.handlers.depsgraph_update_post.append(told)
    try:
        ended = None
        while ended is None:
            now = time.perf_counter() - began
            if now > MAX_BAKE_S:
                raise HnfError(f"the bake did not end within {MAX_BAKE_S:g} s.", where=RESPONSIVENESS_NAME)
            if now >= next_edit:
                next_edit = now + EDIT_S
                stroke.location.z += 1e-5
                layer.update()
            if now >= next_look:
                next_look = now + CHECK_TICK_S
                waits["look at what changed"].measure(lambda: process_changes(((scene, layer),)))
            if now >= next_job:
                next_job = now + JOB_TICK_S
                stage = "tick, commit" if bake.is_committing else "tick, child at work"
                ended = waits[stage].measure(current.tick)
                waits[DRAW_TAB].measure(lambda: draw_tab(scene, layer))
            time.sleep(STEP_S)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(told)
        current.cancel()
    if not ended.ok:
        raise HnfError(f"the bake failed: {ended.message}", where=RESPONSIVENESS_NAME)
    waits[COMPLETE_BAKE].add_wall_time(time.perf_counter() - began)
    STATE.dirty_names.clear()


def _measure_copy(waits: WaitTimes) -> None:
    from ..jobs.running import save_copy

    with tempfile.TemporaryDirectory() as folder:
        waits["save a copy"].measure(lambda: save_copy(Path(folder) / "copy.blend"))


def _measure_cancel(scene: Any, layer: Any, waits: WaitTimes, pause: float) -> None:
    from ..jobs import current
    from ..jobs.folder import is_process_alive

    bake = current.start_bake(scene, layer, list_stroke_names())
    time.sleep(pause)
    current.tick()
    pid = bake.pid
    started = time.perf_counter()
    waits["cancel"].measure(current.cancel)
    while pid is not None and is_process_alive(pid):
        time.sleep(0.001)
    waits["cancel → the child is gone"].add_wall_time(time.perf_counter() - started)
