"""Plays a scenario: its functions `check_*(stage)` in the order they are written, one small step a timer tick.

A check is a generator; a number it yields is how long Blender runs on before the next step [s]. A check that fails
does not stop those after it. Timers run between Blender's own events, so that modal operators, redraws, child
processes and playback go on as they do under a person's hand.
"""

import importlib
import sys
import time
import traceback
from pathlib import Path

import bpy

from .record import Record
from .stage import Stage

FIRST_STEP_S = 1.5  # until the window is drawn for the first time


def checks_in(module):
    """(name without `check_`, function) of a scenario, in the order of the file."""
    return [(name.removeprefix("check_"), value) for name, value in vars(module).items() if name.startswith("check_")]


def play(scenario: str, folder: Path) -> None:
    """Begin scenarios/SCENARIO.py; Blender quits when it ends. Everything seen goes to folder."""
    bpy.context.preferences.view.show_splash = False  # it would cover the window and swallow the first click
    if getattr(importlib.import_module(f"scenarios.{scenario}"), "SMOOTH", "yes") == "no":
        bpy.context.preferences.system.viewport_aa = "OFF"  # drawn once after a change, not eight times over
    record = Record(folder)
    record.write("blender", version=bpy.app.version_string)
    steps = played(scenario, Stage(folder, record), record)

    def advance() -> float | None:
        try:
            return float(next(steps))
        except StopIteration:
            record.write("finished")
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        # Not now: an operator that is still modal would be ended inside this very call.
        bpy.app.timers.register(leave, first_interval=0.2, persistent=True)
        return None

    bpy.app.timers.register(advance, first_interval=FIRST_STEP_S, persistent=True)  # it outlives the opening of files


def leave() -> None:
    """Quit, without asking about unsaved changes. A timer still registered at the exit would hang older Blenders."""
    bpy.ops.wm.quit_blender()


def played(scenario: str, stage: Stage, record: Record):
    """All checks as one generator of waits [s]."""
    for name, check in checks_in(importlib.import_module(f"scenarios.{scenario}")):
        record.begin(name)
        print(f"==== {name}", flush=True)
        started, error = time.monotonic(), ""
        try:
            yield from check(stage) or ()
        except Exception:
            error = traceback.format_exc(limit=-4)
            stage.photograph(f"failed-{name}")
        sys.stdout.flush()
        record.end(error, time.monotonic() - started)
