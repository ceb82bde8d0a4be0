"""Bakes to watch: a small scene, a job driven as the window drives it, and what it left."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import bpy
from touch_scene import PLATE, line_stroke, ridge_plate

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.jobs import manager
from hnf_blender.jobs.child_job import JOB_FOLDER_PREFIX, get_job_root, is_process_alive
from hnf_blender.jobs.request import pack_tokens
from hnf_blender.state.session_state import STATE, LastJob
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY

LIMIT_S = 60.0
ORDER = ("starting", "opening", "reading", "Along", "Along: close-ups", "Along: synthesis", "saving")
"""Stages of a bake of stroke "Along" in their order."""
STAGES = tuple(stage for stage in ORDER if stage != "Along: close-ups")
"""Those that a bake goes through whose close-ups are there already."""


def small_scene(**settings):
    """The plate with one stroke on it."""
    plate = ridge_plate()
    return plate, line_stroke("Along", surface=plate, **settings)


def start(only=()):
    return manager.start_bake(bpy.context.scene, bpy.context.view_layer, only)


def finish(bake) -> LastJob:
    """Tick until it has ended, as the operator's timer does."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        ended = manager.tick()
        if ended is not None:
            return ended
        time.sleep(0.01)
    manager.cancel()
    raise AssertionError(f"it did not end: {STATE.job}")


def bake() -> LastJob:
    return finish(start())


def reach(stage: str) -> bool:
    """Tick until that stage or a later one is told; False where the job ended first."""
    place = ORDER.index(stage)
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until and manager.is_running():
        manager.tick()
        if STATE.job is not None and _place(STATE.job.stage) >= place:
            return True
        time.sleep(0.001)
    return False


def kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):  # it has just ended by itself
        os.kill(pid, signal.SIGKILL)


def my_folders(prefix: str = JOB_FOLDER_PREFIX) -> list:
    return list(get_job_root().glob(f"{prefix}{os.getpid()}-*"))


def is_gone(pid: int) -> bool:
    """Within a moment: the system takes one to clear a killed process away."""
    for _ in range(100):
        if not is_process_alive(pid):
            return True
        time.sleep(0.05)
    return False


def kept() -> dict:
    """What the scene holds of bakes: bytes by stroke, packed tokens by mesh."""
    bakes = {obj.name: bytes(obj[BAKE_PROPERTY]) for obj in bpy.data.objects if BAKE_PROPERTY in obj}
    tokens = {}
    for mesh in bpy.data.meshes:
        found = read_tokens(mesh)
        if found is not None:
            tokens[mesh.name] = pack_tokens(found)
    return {"bakes": bakes, "tokens": tokens}


NOTHING = {"bakes": {}, "tokens": {}}


def _place(stage: str) -> int:
    named = [place for place, name in enumerate(ORDER) if stage == name or (stage.startswith(name) and place < 3)]
    return named[-1] if named else len(ORDER)


__all__ = ["PLATE", "line_stroke"]
