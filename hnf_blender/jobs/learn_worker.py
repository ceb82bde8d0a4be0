"""Entry point of the child process that learns a material, run by a Python outside Blender.

Run as `PYTHON learn_worker.py CORE REQUEST OUT`. It loads the add-on's hnf_core from its folder CORE, since neither the
project nor bpy is installed in that Python. REQUEST is `hnf_core.training.learn.LearnRequest` as JSON, OUT the path of
the weights. It prints messages that `child_job.py` decodes.
"""

import importlib
import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Any


def load_child_process(core: str) -> Any:
    """Load hnf_core/child_process.py by its path, since this script belongs to no package when it is run."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def send_message(kind: str, **values: object) -> None:
    """Print a message of a kind ("Step", "Failed", …) with values; `child_job.decode_message` reads it."""
    # A library may have printed an incomplete line, so a line end comes first.
    os.write(1, f"\n@hnf {kind} {json.dumps(values)}\n".encode())


def main(child_process: Any, request: str, out: str) -> int:
    """Learn the material of the request and write its weights; return the exit code."""
    child_process.exit_with_parent()
    own_folder = str(Path(__file__).resolve().parent)  # Libraries must not import this folder's modules.
    sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry) != own_folder]
    try:
        child_process.load_core()
        learn = importlib.import_module(f"{child_process.CORE}.training.learn")
    except ImportError as error:
        send_message("Failed", why=f"This Python cannot learn ({error}). Check it in the add-on's preferences.")
        return 1
    errors = importlib.import_module(f"{child_process.CORE}.errors")
    try:
        learn.learn_material(
            learn.LearnRequest(**json.loads(request)),
            Path(out),
            lambda progress: send_message("Step", **vars(progress)),
        )
    except errors.HnfError as error:
        send_message("Failed", why=str(error))
        return 1
    send_message("Finished")
    return 0


if __name__ == "__main__":
    child_process = load_child_process(sys.argv[1])
    child_process.run_main(main, child_process, *sys.argv[2:])
