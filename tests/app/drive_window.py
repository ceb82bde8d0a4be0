"""Run by a windowed Blender: wait until it is drawn, photograph the screen, say what is loaded, quit.

Arguments after `--`: the picture's path.
"""

import json
import subprocess
import sys
import traceback

import bpy

bpy.context.preferences.view.show_splash = False  # it would cover the window and swallow the first click


def steps():
    """One item a redraw or more; the number is how long to wait before the next [s]."""
    area = next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D")
    area.spaces.active.show_region_ui = True
    area.spaces.active.shading.type = "SOLID"
    yield 1.0
    subprocess.run(["scrot", "-o", sys.argv[-1]], check=True, timeout=30)
    names = [addon.module for addon in bpy.context.preferences.addons]
    heavy = [name for name in ("torch", "scipy", "hnf_core", "hnf_blender") if name in sys.modules]
    print("RESULT", json.dumps({"addons": names, "foreign": heavy, "windows": len(bpy.context.window_manager.windows)}))
    yield 0.1


RUNNING = steps()


def advance():
    """Timer: the next step; at the end, or after an error, leave for good (a live timer would hang the exit)."""
    try:
        return next(RUNNING)
    except StopIteration:
        pass
    except Exception:
        traceback.print_exc()
    sys.stdout.flush()
    bpy.ops.wm.quit_blender()
    return None


bpy.app.timers.register(advance, first_interval=2.0)
