"""Begins a bake and dies without a word: `python die_while_baking.py FOLDER [waiting]`.

"waiting": once it is done, and its process waits for the next.
"""

import os
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

import bpy

from hnf_blender import props

props.register()
bpy.ops.wm.read_factory_settings(use_empty=True)

from job_scene import small_scene, start

from hnf_blender.jobs import manager
from hnf_blender.state.session_state import STATE

os.environ["BLENDER_USER_DATAFILES"] = sys.argv[1]
small_scene()
pid = start().pid
while manager.is_running() if "waiting" in sys.argv else STATE.job is None or STATE.job.stage == "starting":
    manager.tick()
    time.sleep(0.01)
print("CHILD", pid, "PARENT", os.getpid(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
