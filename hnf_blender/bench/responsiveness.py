"""How long Blender waits for us while a bake runs beside it: start, ticks, handlers, looks at changes, commit, end.

The window is played: its timers' calls are made by hand at their own pace, with an edit now and then, so that every
call is seen from the outside. What Blender draws is not in it (tests/app times that in a real window).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from hnf_core.bench.frame import Options, Row, Spread
from hnf_core.errors import HnfError

from .needs import need_bpy

NAME = "responsiveness"
CUTS, QUICK_CUTS = 316, 8
"""Faces along each side of the plate: 99,856 of them, or 64."""
SIZE_M = 0.2
STROKES = 3
JOB_TICK_S, LOOK_TICK_S, EDIT_S, STEP_S = 0.1, 0.25, 0.5, 0.01
LIMIT_S = 300.0
CANCEL_AT_S = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
"""After the start; the child loads Blender in the first second."""

WHOLE = "the whole bake, beside the window"

Waits = dict[str, list[float]]


def rows(options: Options) -> list[Row]:
    """One row for each kind of call, of all bakes together. Raises HnfError without bpy, or where a bake fails.

    Empties the file that is open.
    """
    need_bpy(NAME)
    waits: Waits = {}
    for repeat in range(options.repeats):
        options.watch(f"{NAME}: bake {repeat + 1} of {options.repeats}")
        with _playing() as (scene, layer):
            faces = len(_scene(QUICK_CUTS if options.quick else CUTS).data.polygons)
            _saved_copy(waits)
            for pause in CANCEL_AT_S[:1] if options.quick else CANCEL_AT_S:
                _started_and_cancelled(scene, layer, waits, pause)
            _baked(scene, layer, waits)
    notes = {
        "save a copy": f"{faces:,} faces",
        "start": "the copy, the order, the child process",
        "cancel": f"{', '.join(f'{pause:g}' for pause in CANCEL_AT_S)} s after the start",
        WHOLE: f"{STROKES} strokes, no close-up there yet",
    }
    return [Row(NAME, name, Spread.of(found), note=notes.get(name, "")) for name, found in waits.items()]


def _baked(scene: Any, layer: Any, waits: Waits) -> None:
    """A bake to its end, every call of ours timed."""
    import bpy

    from ..handlers import note_changes
    from ..jobs import current
    from ..jobs.running import Bake
    from ..state.session import STATE
    from ..state.watch import drain

    def told(changed: Any, depsgraph: Any) -> None:
        _timed(waits, "handler", lambda: note_changes(changed, depsgraph))

    stroke = scene.objects["Beside"]
    began = time.perf_counter()
    bake: Bake = _timed(waits, "start", lambda: current.start(scene, layer, _names()))
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
                _timed(waits, "look at what changed", lambda: drain(((scene, layer),)))
            if now >= next_job:
                next_job = now + JOB_TICK_S
                stage = "tick, commit" if bake.is_committing else "tick, child at work"
                ended = _timed(waits, stage, current.tick)
            time.sleep(STEP_S)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(told)
        current.cancel()
    if not ended.ok:
        raise HnfError(f"the bake failed: {ended.message}", where=NAME)
    waits.setdefault(WHOLE, []).append(time.perf_counter() - began)
    STATE.dirty.clear()


def _saved_copy(waits: Waits) -> None:
    from ..jobs.running import save_copy

    with tempfile.TemporaryDirectory() as folder:
        _timed(waits, "save a copy", lambda: save_copy(Path(folder) / "copy.blend"))


def _started_and_cancelled(scene: Any, layer: Any, waits: Waits, pause: float) -> None:
    from ..jobs import current
    from ..jobs.folder import is_alive

    bake = current.start(scene, layer, _names())
    time.sleep(pause)
    current.tick()
    pid = bake.pid
    started = time.perf_counter()
    _timed(waits, "cancel", current.cancel)
    while pid is not None and is_alive(pid):
        time.sleep(0.001)
    waits.setdefault("cancel → the child is gone", []).append(time.perf_counter() - started)


def _timed(waits: Waits, name: str, function: Callable[[], Any]) -> Any:
    started = time.perf_counter()
    try:
        return function()
    finally:
        waits.setdefault(name, []).append(time.perf_counter() - started)


@contextmanager
def _playing() -> Iterator[tuple[Any, Any]]:
    """An empty file with the add-on's properties, and a cache of its own; (scene, view layer)."""
    import bpy

    from .. import props
    from ..jobs import current, running
    from ..state.session import STATE
    from ..state.warm import is_ready
    from ..state.watch import forget

    while not is_ready():
        time.sleep(STEP_S)
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder, patch.object(running, "cache_folder", lambda: Path(folder)):
        try:
            yield bpy.context.scene, bpy.context.view_layer
        finally:
            current.cancel()
            forget()
            STATE.clear()


def _scene(cuts: int) -> Any:
    """A plate of cuts × cuts faces with strokes on it, one more of them to be edited."""
    import bpy

    mesh = bpy.data.meshes.new("Plate")
    side = np.linspace(-SIZE_M / 2.0, SIZE_M / 2.0, cuts + 1)
    x, y = np.meshgrid(side, side)
    corner = (np.arange(cuts)[:, None] * (cuts + 1) + np.arange(cuts)).reshape(-1, 1)
    mesh.from_pydata(
        np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3), [], corner + np.array([0, 1, cuts + 2, cuts + 1])
    )
    plate = bpy.data.objects.new("Plate", mesh)
    bpy.context.scene.collection.objects.link(plate)
    for name in (*_names(), "Beside"):
        _stroke(name, plate, turned=0.4 * len(name))
    bpy.context.view_layer.update()
    return plate


def _names() -> tuple[str, ...]:
    return tuple(f"Stroke {'i' * (k + 1)}" for k in range(STROKES))


def _stroke(name: str, plate: Any, turned: float) -> None:
    """60 mm through the middle of the plate at 100 mm/s."""
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-0.03, 0.03), strict=True):
        point.co = (side * np.cos(turned), side * np.sin(turned), 0.0, 1.0)
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    group = obj.hnf_stroke
    group.is_stroke, group.surface, group.start, group.force = True, plate, 1.0, 1.0
