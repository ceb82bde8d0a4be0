"""Begins a bake and dies without a word: `python die_while_baking.py FOLDER`."""

import os
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

import bpy  # noqa: E402

from hnf_blender import props  # noqa: E402

props.register()
bpy.ops.wm.read_factory_settings(use_empty=True)

from job_scene import small_scene, start  # noqa: E402

from hnf_blender.jobs import current, running  # noqa: E402
from hnf_blender.state.session import STATE  # noqa: E402

running.get_cache_folder = lambda: Path(sys.argv[-1])
small_scene()
pid = start().pid
while STATE.job is None or STATE.job.stage == "starting":
    current.tick()
    time.sleep(0.01)
print("CHILD", pid, "PARENT", os.getpid(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
