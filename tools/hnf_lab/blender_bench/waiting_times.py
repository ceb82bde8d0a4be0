"""Benches of waiting times in Blender: enabling the add-on, a second run, authoring, and responsiveness in a bake.

`measure_enable`: processor time, memory and modules against `import numpy`. `measure_second_run`: `hnf touch` without
changes, against opening the same scene, in fresh processes. `measure_authoring`: a stroke drawn by hand, or a primitive
placed. `measure_responsiveness`: every call during a bake (start, ticks, handlers, checks for changes, commit, end).
The window's timers are simulated at their own pace with occasional edits; the tab is drawn into a fake layout once per
tick, which excludes Blender's own drawing (tests/app measures that in a real window).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.pen_stroke import PenSamples, PenStyle
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.errors import HnfError
from hnf_lab import CHILD_PATH, ROOT

from ..bench.harness import BenchOptions, Row, Spread, Times
from ..bench.startup import STARTUP_NAME, measure_pairs, run_process
from .scenes import (
    PLATE_CUTS,
    QUICK_PLATE_CUTS,
    STROKE_COUNT,
    add_plate_with_strokes,
    draw_tab,
    list_stroke_names,
    open_test_file,
    register_tab,
    require_bpy,
)

ENABLE_NAME = "enable"
MAX_ENABLE_S = 60.0
HEAVY_PACKAGES = frozenset({"torch", "scipy", "matplotlib", "OpenEXR", "embreex", "safetensors", "PIL"})
"""Packages that enabling must not load."""
# Blender loads bpy and numpy before any add-on; numpy is loaded first, so that its cost is measured separately.
ENABLE_CODE = """
import json, os, sys, time, tracemalloc
start = time.process_time()
import numpy
numpy_s = time.process_time() - start
import bpy, addon_utils
before = set(sys.modules)
if "memory" in sys.argv:
    tracemalloc.start()
start = time.process_time()
import hnf_blender
hnf_blender.register()
addon_s = time.process_time() - start
peak = tracemalloc.get_traced_memory()[1]
hnf_blender.unregister()
print("RESULT", json.dumps([numpy_s, addon_s, peak / 1e6, sorted(set(sys.modules) - before)]))
sys.stdout.flush()
os._exit(0)
"""


@dataclass(frozen=True)
class EnableRun:
    """Measurements of one fresh process.

    Attributes
    ----------
    numpy_s, addon_s
        Processor times [s].
    peak_mb
        Peak of Python's memory [MB], 0 if not traced.
    modules
        Modules loaded by the add-on.
    """

    numpy_s: float
    addon_s: float
    peak_mb: float
    modules: tuple[str, ...]

    @property
    def heavy_packages(self) -> tuple[str, ...]:
        """Heavy packages among the modules."""
        return tuple(sorted({name.partition(".")[0] for name in self.modules} & HEAVY_PACKAGES))


def measure_enable(options: BenchOptions) -> list[Row]:
    """Measure both costs in the same processes, after one for compilation and one that traces memory.

    Raises
    ------
    HnfError
        Without bpy.
    """
    require_bpy(ENABLE_NAME)
    options.watch(f"{ENABLE_NAME}: compiling")
    enable_in_process()
    peak_mb = enable_in_process("memory").peak_mb
    runs = []
    for repeat in range(options.repeats):
        options.watch(f"{ENABLE_NAME}: process {repeat + 1} of {options.repeats}")
        runs.append(enable_in_process())
    heavy = ", ".join(runs[-1].heavy_packages) or "none"
    return [
        Row(ENABLE_NAME, "import numpy", cpu=Spread.from_values([run.numpy_s for run in runs])),
        Row(
            ENABLE_NAME,
            "switch the add-on on",
            cpu=Spread.from_values([run.addon_s for run in runs]),
            ratio=Spread.from_values([run.addon_s / run.numpy_s for run in runs]),
            ratio_to="import numpy",
            peak_mb=peak_mb,
            note=f"{len(runs[-1].modules)} modules; heavy ones: {heavy}",
        ),
    ]


def enable_in_process(*arguments: str) -> EnableRun:
    """Enable the add-on in a fresh process; "memory" traces its peak. Raises HnfError if that fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPATH"] = CHILD_PATH
    try:
        finished = subprocess.run(
            [sys.executable, "-c", ENABLE_CODE, *arguments], cwd=ROOT, env=environment, timeout=MAX_ENABLE_S,
            stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise HnfError(f"the add-on was not switched on within {MAX_ENABLE_S:g} s in a fresh process.") from error
    except subprocess.CalledProcessError as error:
        output = str(error.stderr).strip()[-1500:]
        raise HnfError(f"the add-on could not be switched on in a fresh process:\n{output}") from error
    line = next(line for line in finished.stdout.splitlines() if line.startswith("RESULT "))
    numpy_s, addon_s, peak, modules = json.loads(line.removeprefix("RESULT "))
    return EnableRun(float(numpy_s), float(addon_s), float(peak), tuple(modules))


OPEN_NAME, SECOND_RUN_NAME = "import bpy, open the scene", "hnf touch, second run"
OPEN_CODE = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath={scene!r}, load_ui=False, use_scripts=False)
"""
TOUCH_CODE = "from hnf_blender.cli import main; sys.exit(main(sys.argv[1:]))"
MAKE_CODE = (
    "from hnf_lab.blender_bench.waiting_times import write_scene; write_scene(sys.argv[1], sys.argv[2] == 'quick')"
)
FREE_COUNTS = ("renders", "rays", "network_calls", "diffusion_calls")
PLATE_COUNT = 2
SCENE_CUTS, QUICK_SCENE_CUTS = 224, 4
RELIEF_PIXELS, QUICK_RELIEF_PIXELS = 2048, 16


def measure_second_run(options: BenchOptions) -> list[Row]:
    """Measure opening the scene, and the second run.

    Raises
    ------
    HnfError
        Without bpy, or if the second run renders, casts rays or evaluates a network.
    """
    require_bpy(STARTUP_NAME)
    with tempfile.TemporaryDirectory() as folder:
        scene, out = Path(folder) / "scene.blend", Path(folder) / "out"
        # Quick runs query one point instead of strokes and their images.
        query = ("--at", "Plate 0:0.1,0.1") if options.quick else ()
        command = ("touch", str(scene), "--out", str(out), "--json", *query)
        options.watch(f"{STARTUP_NAME}: making a scene")
        run_process(MAKE_CODE, str(scene), "quick" if options.quick else "whole")
        options.watch(f"{STARTUP_NAME}: first run")
        run_process(TOUCH_CODE, *command)
        code = OPEN_CODE.format(scene=str(scene))
        rows = measure_pairs(options, OPEN_NAME, code, {SECOND_RUN_NAME: (TOUCH_CODE, command)})
        counts = json.loads((out / "report.json").read_text(encoding="utf-8"))["counts"]
    if any(counts[name] for name in FREE_COUNTS):
        raise HnfError(f"the second run was not free: {counts}", where=STARTUP_NAME)
    return rows


def write_scene(path: str, quick: bool) -> None:
    """Save plates of 100,000 faces in all, each with an image relief and a stroke, to a file.

    quick: a handful of faces and pixels.
    """
    import bpy

    from hnf_blender import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    from .scenes import add_crossing_stroke, add_plate

    for number in range(PLATE_COUNT):
        plate = add_plate(f"Plate {number}", QUICK_SCENE_CUTS if quick else SCENE_CUTS)
        plate.location.x = 0.5 * number
        uv = plate.data.uv_layers.new(name="UVMap")
        corners = np.empty(len(plate.data.loops), dtype=np.int32)
        plate.data.loops.foreach_get("vertex_index", corners)
        positions = np.array([tuple(vertex.co)[:2] for vertex in plate.data.vertices], dtype=np.float32)
        uv.uv.foreach_set("vector", (5.0 * positions[corners]).ravel())
        image_path = Path(path).with_name(f"relief {number}.png")
        plate.data.materials.append(
            _make_rough_material(image_path, QUICK_RELIEF_PIXELS if quick else RELIEF_PIXELS, number)
        )
        stroke = add_crossing_stroke(plate, f"Stroke {number}", turned=0.4 * number)
        stroke.location.x = plate.location.x
    bpy.ops.wm.save_as_mainfile(filepath=path)


def _make_rough_material(path: Path, pixels: int, seed: int) -> Any:
    """Make a material with a noise image, stored next to the scene, as its height."""
    import bpy

    from hnf_blender import compat

    image = bpy.data.images.new(path.stem, pixels, pixels, is_data=True)
    grey = np.random.default_rng(seed).random((pixels * pixels, 1), dtype=np.float32)
    image.pixels.foreach_set(np.concatenate([np.repeat(grey, 3, axis=1), np.ones_like(grey)], axis=1).ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    material = bpy.data.materials.new(path.stem)
    compat.switch_nodes_on(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
    texture.image, bump.inputs["Distance"].default_value = image, 1e-4
    links.new(texture.outputs["Color"], bump.inputs["Height"])
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


AUTHORING_NAME = "authoring"
SCRIBBLE_S, QUICK_SCRIBBLE_S = 10.0, 1.0
EVENTS_HZ = 100.0
PIXEL_M = 0.3e-3
"""Step of drawn positions, as on a screen [m]."""
PRIMITIVE = next(iter(PRIMITIVES))


def measure_authoring(options: BenchOptions) -> list[Row]:
    """Measure each way to make a stroke. Raises HnfError without bpy. Empties the open file."""
    require_bpy(AUTHORING_NAME)
    from hnf_blender.bridge.stroke.new_stroke import create_drawn_stroke
    from hnf_blender.bridge.stroke.place_primitive import place_primitive

    seconds = QUICK_SCRIBBLE_S if options.quick else SCRIBBLE_S
    samples, draw_times, place_times, knots = make_scribble(seconds), Times(), Times(), 0
    with open_test_file() as (scene, layer):
        plate = add_plate_with_strokes(QUICK_PLATE_CUTS if options.quick else PLATE_CUTS)
        for repeat in range(options.repeats):
            options.watch(f"{AUTHORING_NAME}: {repeat + 1} of {options.repeats}")
            depsgraph = layer.depsgraph
            draw = partial(create_drawn_stroke, scene, depsgraph, [plate], samples, PenStyle())
            stroke = draw_times.measure(partial(draw, start_frame=1.0, probe="pen", metres_per_unit=1.0))
            knots = len(stroke.pen_stroke.path.knot)
            place_times.measure(partial(place_primitive, scene, plate, None, PRIMITIVE, 1.0, depsgraph))
            layer.update()
    return [
        Row(
            AUTHORING_NAME,
            f"draw {seconds:g} s",
            draw_times.seconds,
            draw_times.cpu,
            note=f"{len(samples.time)} samples → {knots} knots",
        ),
        Row(AUTHORING_NAME, f"place {PRIMITIVE}", place_times.seconds, place_times.cpu),
    ]


def make_scribble(seconds: float) -> PenSamples:
    """Make pen samples of a hand's loops over 6 cm of the plane z = 0."""
    time = np.arange(round(seconds * EVENTS_HZ)) / EVENTS_HZ
    turn = 2.0 * np.pi * time
    x = 0.02 * np.sin(0.7 * turn) + 0.01 * np.sin(1.3 * turn + 1.0)
    point = np.stack([x, 0.02 * np.cos(0.9 * turn), np.zeros_like(time)], axis=1)
    pressure = 0.5 + 0.2 * np.sin(0.5 * turn)
    return PenSamples(time, np.round(point / PIXEL_M) * PIXEL_M, pressure, np.ones(len(time), dtype=bool))


RESPONSIVENESS_NAME = "responsiveness"
JOB_TICK_S, CHECK_TICK_S, EDIT_S, STEP_S = 0.1, 0.25, 0.5, 0.01
MAX_BAKE_S = 300.0
CANCEL_AT_S = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
"""Times of cancelling after the start [s]; the child loads Blender in the first second."""

COMPLETE_BAKE = "the whole bake, beside the window"
FIRST_BAKE, NEXT_BAKE = "one changed stroke, in a new process", "one changed stroke, in the process that waits"
DRAW_TAB = "draw the tab"

WaitTimes = dict[str, Times]


def measure_responsiveness(options: BenchOptions) -> list[Row]:
    """Measure each kind of call over all bakes. Empties the open file.

    Raises
    ------
    HnfError
        Without bpy, or if a bake fails.
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
            _measure_changed_stroke(scene, layer, waits)
    notes = {
        "save a copy": f"{faces:,} faces",
        "start": "the copy, the order, the child process",
        "cancel": f"{', '.join(f'{pause:g}' for pause in CANCEL_AT_S)} s after the start",
        DRAW_TAB: "every panel open, into a hollow layout",
        COMPLETE_BAKE: f"{STROKE_COUNT} strokes, no close-up there yet",
        FIRST_BAKE: "start to commit; CPU: with that of the child process",
        NEXT_BAKE: "the same",
    }
    rows = [
        Row(RESPONSIVENESS_NAME, name, times.seconds, times.cpu, note=notes.get(name, ""))
        for name, times in waits.items()
        if name != NEXT_BAKE
    ]
    first, again = waits[FIRST_BAKE], waits[NEXT_BAKE]
    ratio = again.compute_ratio(first) if Path("/proc").is_dir() else None
    row = Row(RESPONSIVENESS_NAME, NEXT_BAKE, again.seconds, again.cpu, ratio, FIRST_BAKE, note=notes[NEXT_BAKE])
    return [*rows, row]


def _measure_bake(scene: Any, layer: Any, waits: WaitTimes) -> None:
    """Run a complete bake and time every call of the add-on."""
    import bpy

    from hnf_blender.handlers import on_depsgraph_update
    from hnf_blender.jobs import manager
    from hnf_blender.jobs.bake_job import BakeJob
    from hnf_blender.state.session_state import STATE
    from hnf_blender.state.status_tracker import process_changes

    def on_update(changed: Any, depsgraph: Any) -> None:
        waits["handler"].measure(lambda: on_depsgraph_update(changed, depsgraph))

    stroke = scene.objects["Beside"]
    start = time.perf_counter()
    bake: BakeJob = waits["start"].measure(lambda: manager.start_bake(scene, layer, list_stroke_names()))
    next_job = next_check = next_edit = 0.0
    bpy.app.handlers.depsgraph_update_post.append(on_update)
    try:
        result = None
        while result is None:
            now = time.perf_counter() - start
            if now > MAX_BAKE_S:
                raise HnfError(f"the bake did not end within {MAX_BAKE_S:g} s.", where=RESPONSIVENESS_NAME)
            if now >= next_edit:
                next_edit = now + EDIT_S
                stroke.location.z += 1e-5
                layer.update()
            if now >= next_check:
                next_check = now + CHECK_TICK_S
                waits["look at what changed"].measure(lambda: process_changes(((scene, layer),)))
            if now >= next_job:
                next_job = now + JOB_TICK_S
                stage = "tick, commit" if bake.is_committing else "tick, child at work"
                result = waits[stage].measure(manager.tick)
                waits[DRAW_TAB].measure(lambda: draw_tab(scene, layer))
            time.sleep(STEP_S)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(on_update)
        manager.cancel()
    if not result.ok:
        raise HnfError(f"the bake failed: {result.message}", where=RESPONSIVENESS_NAME)
    waits[COMPLETE_BAKE].add_wall_time(time.perf_counter() - start)
    STATE.dirty_names.clear()


def _measure_changed_stroke(scene: Any, layer: Any, waits: WaitTimes) -> None:
    """Bake a stroke whose seed changed, in a new process and in the one that waits after it; its close-ups exist."""
    from hnf_blender.jobs import manager

    stroke = scene.objects[list_stroke_names()[0]]
    manager.close()
    for name in (FIRST_BAKE, NEXT_BAKE):
        stroke.hnf_stroke.seed += 1
        layer.update()
        waits.setdefault(name, Times(_read_cpu_with_child)).measure(lambda: _bake_stroke(scene, layer, stroke.name))


def _bake_stroke(scene: Any, layer: Any, name: str) -> None:
    from hnf_blender.jobs import manager

    manager.start_bake(scene, layer, (name,))
    while (result := manager.tick()) is None:
        time.sleep(JOB_TICK_S)
    if not result.written:
        raise HnfError(f"the bake failed: {result.message}", where=RESPONSIVENESS_NAME)


def _read_cpu_with_child() -> float:
    """Return the processor time of this thread and of the process that waits for a bake [s]; Linux tells the latter."""
    from hnf_blender.jobs.bake_process import get_process

    process, own_s = get_process(), time.thread_time()
    stat = Path("/proc") / ("" if process is None else str(process.pid)) / "stat"
    if process is None or not stat.is_file():
        return own_s
    user, system = stat.read_text(encoding="utf-8").rpartition(")")[2].split()[11:13]
    return own_s + (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def _measure_copy(waits: WaitTimes) -> None:
    from hnf_blender.jobs.bake_job import save_copy

    with tempfile.TemporaryDirectory() as folder:
        waits["save a copy"].measure(lambda: save_copy(Path(folder) / "copy.blend"))


def _measure_cancel(scene: Any, layer: Any, waits: WaitTimes, pause: float) -> None:
    from hnf_blender.jobs import manager
    from hnf_blender.jobs.child_job import is_process_alive

    bake = manager.start_bake(scene, layer, list_stroke_names())
    time.sleep(pause)
    manager.tick()
    pid = bake.pid
    started = time.perf_counter()
    waits["cancel"].measure(manager.cancel)
    while pid is not None and is_process_alive(pid):
        time.sleep(0.001)
    waits["cancel → the child is gone"].add_wall_time(time.perf_counter() - started)
