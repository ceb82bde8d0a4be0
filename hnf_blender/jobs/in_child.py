"""The job as the child process does it: open the copy, work, tell."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path

from hnf_core.errors import HnfError

from ..bridge.quiet import suppress_output
from .messages import Failed, Finished, Message, Step, encode_message
from .order import SCENE_NAME, read_request, write_result
from .work import job_steps


def run_request(folder: Path) -> int:
    """Do the order in folder; returns the exit code. Never raises: what goes wrong is said."""
    import bpy

    # Our own copy of the stream: whatever is redirected or held back meanwhile, messages pass.
    stream = os.dup(1)

    def say(message: Message) -> None:
        # A new line first: Blender may have stopped in the middle of its own.
        os.write(stream, f"\n{encode_message(message)}\n".encode())

    try:
        order = read_request(folder)
        say(Step("opening the copy", 0, 1))
        if not hasattr(bpy.types.Object, "hnf_stroke"):
            from .. import props

            props.register()
        with suppress_output():
            bpy.ops.wm.open_mainfile(filepath=str(folder / SCENE_NAME), load_ui=False, use_scripts=order.use_scripts)
        steps = job_steps(order, folder)
        while True:
            try:
                say(next(steps))
            except StopIteration as done:
                write_result(folder, done.value)
                break
        say(Finished())
        return 0
    except HnfError as error:
        say(Failed(str(error)))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        say(Failed(f"internal error ({error!r}). Please report it."))
    return 1
