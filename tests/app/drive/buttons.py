"""Buttons found as a hand and an eye find them: under the mouse, and by the colour of the one that Return presses."""

import subprocess

import bpy
import numpy as np

from .stage import MissedError, Point, Stage

ROW_PX = 20
"""Of a row of buttons, and the gap below it."""
DEFAULT_COLOUR = (71, 114, 179)
"""Of the button that Return presses, in the theme that Blender comes with."""


def under(stage: Stage, area: str, region: str) -> str:
    """What the button under the mouse would do, as Blender's own Copy Python Command says it; "" = it is no button."""
    with stage.over(area, region):
        if not bpy.ops.ui.copy_python_command_button.poll():
            return ""
        bpy.ops.ui.copy_python_command_button()
    return str(bpy.context.window_manager.clipboard)


def find(
    stage: Stage, command: str, area: str = "VIEW_3D", region: str = "UI", across: float = 0.5, below: int = 10_000
):
    """Generator that returns where the first button is whose command begins so, the mouse going down a column of the
    region. across: how far that is from left to right. below: this height [pixels of the window]."""
    box = stage.region(region, area)
    at: Point = (box.x + round(across * box.width), min(box.y + box.height, below))
    seen: list[str] = []
    while at[1] > box.y:
        at = (at[0], at[1] - ROW_PX)
        yield from stage.move(at)
        seen.append(under(stage, area, region))
        if seen[-1].startswith(command):
            return at
    raise MissedError(f"no button does {command}, but {sorted(set(seen))}")


def default_button(stage: Stage, name: str) -> Point:
    """The middle of a dialog's OK, seen on a photograph of this name. MissedError where there is none."""
    path, window = stage.photograph(name), stage.window()
    read = subprocess.run(["convert", str(path), "-depth", "8", "rgb:-"], capture_output=True, check=True, timeout=30)
    pixels = np.frombuffer(read.stdout, np.uint8).reshape(window.height, window.width, 3)
    rows, columns = np.nonzero(np.all(pixels == DEFAULT_COLOUR, axis=2))
    wide = np.bincount(rows, minlength=window.height) > 100  # anything else in that colour is small
    if not wide.any():
        raise MissedError("no OK is seen")
    middle = round(float(np.median(np.nonzero(wide)[0])))
    return round(float(np.median(columns[rows == middle]))), window.height - 1 - middle
