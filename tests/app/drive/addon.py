"""The installed add-on as a scenario looks at it: its modules, its state, and what it keeps in the .blend."""

import hashlib
import importlib
import os
import tempfile
import threading
import time
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.hnf"


def ours(name: str):
    """A module of the add-on, such as ours("state.session_state")."""
    return importlib.import_module(f"{MODULE}.{name}")


def state():
    """The run-time state that panels read."""
    return ours("state.session_state").STATE


def strokes() -> list:
    """The stroke objects of the scene, by name."""
    return sorted((obj for obj in bpy.context.scene.objects if obj.hnf_stroke.is_stroke), key=lambda obj: obj.name)


def freshness(name: str) -> str:
    """ "fresh", "force", "stale" … as the panel shows it; "" where the state knows nothing of the stroke."""
    status = state().get_statuses(bpy.context.scene).get(name)
    return "" if status is None else status.freshness.value


def force_keys(obj) -> list[tuple[float, float]]:
    """(frame, newtons) of every force key."""
    return keys_of(obj, "force")


def keys_of(obj, name: str) -> list[tuple[float, float]]:
    curves = ours("compat").fcurves_of(obj)
    return [
        (round(point.co[0], 4), round(point.co[1], 5))
        for curve in curves
        if curve.data_path == f"hnf_stroke.{name}"
        for point in curve.keyframe_points
    ]


def kept() -> dict[str, object]:
    """All that an artist would miss: strokes with their paths, keys, settings and bakes, choices, tokens."""
    found: dict[str, object] = {}
    for obj in strokes():
        points = [
            tuple(round(x, 6) for x in point.co)
            for spline in obj.data.splines
            for point in (*spline.points, *spline.bezier_points)
        ]
        group = obj.hnf_stroke
        settings = (group.mute, group.seed, group.law, group.probe, group.material, round(group.duration_s, 5))
        surface = group.surface.name if group.surface else ""
        bake = obj.get("hnf_bake") or obj.data.get("hnf_bake")
        found[obj.name] = (points, force_keys(obj), keys_of(obj, "progress"), settings, surface, short(bake))
    for material in bpy.data.materials:
        if material.hnf_touch.library:
            found[f"choice {material.name}"] = material.hnf_touch.library
    for mesh in bpy.data.meshes:
        if "hnf_palette" in mesh:
            found[f"tokens {mesh.name}"] = short(mesh["hnf_palette"])
    return found


def short(data) -> str:
    """A digest of bytes kept in the file, "" of nothing."""
    return hashlib.blake2b(bytes(data), digest_size=6).hexdigest() if data is not None else ""


class Ending:
    """When no job and no child of this Blender runs any more. at: that moment (time.monotonic), or None.

    A thread looks, every few milliseconds: the window's own timers come only when it has drawn.
    """

    STEP_S = 0.005

    def __init__(self) -> None:
        self.at: float | None = None
        self._state = state()
        threading.Thread(target=self._watch, name="hnf tests: ending", daemon=True).start()

    def _watch(self) -> None:
        while self._state.job is not None or children():
            time.sleep(self.STEP_S)
        self.at = time.monotonic()


def busy_children() -> list[int]:
    """Those of its children that are not the bake's process, where that waits for the next bake."""
    process = ours("jobs.bake_process").get_process()
    waiting = [] if process is None else [process.pid, *children(process.pid)]
    return [pid for pid in children() if pid not in waiting]


def children(of: int = 0) -> list[int]:
    """Processes that this Blender, or another process, started and that still run, however deep."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state_and_parent = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if state_and_parent[0] != "Z":
                parents[int(entry.name)] = int(state_and_parent[1])
    found, front = [], [of or os.getpid()]
    while front:
        front = [pid for pid, parent in parents.items() if parent in front]
        found += front
    return found


def job_folders() -> list[Path]:
    """What a job keeps on the disk while it runs."""
    return sorted(Path(tempfile.gettempdir()).glob("hnf-job-*"))


def heard(name: str):
    """The newest signal of a stroke as the preview has it, or None."""
    return ours("preview.preview_state").PREVIEW.results.get(name)


def start_bake(stage, **properties) -> None:
    """Press Bake, with the mouse over the 3-D view."""
    with stage.over():
        bpy.ops.hnf.bake("INVOKE_DEFAULT", True, **properties)


def baked(stage, seconds: float = 90.0):
    """Bake to the end."""
    start_bake(stage)
    yield from stage.until("a job runs", lambda: state().job is not None or state().last_job is not None, 10.0)
    yield from stage.until("the bake ends", lambda: state().job is None, seconds)
    last = state().last_job
    stage.require("it went well", last is not None and last.ok, last)
    yield 0.3
