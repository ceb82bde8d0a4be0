"""The child that learns a material, under a Python outside Blender: `PYTHON learn_worker.py CORE REQUEST OUT`. It loads
the add-on's own hnf_core by its folder, CORE: nothing of the project is installed there, and no bpy. REQUEST is
hnf_core.training.learn.LearnRequest as JSON, OUT the weights to write. It tells its steps as child_job.py reads
them."""

import importlib
import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Any


def load_child_process(core: str) -> Any:
    """hnf_core/child_process.py, by its path: a script that is run has no package."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def send_message(kind: str, **values: object) -> None:
    # A new line first: a library may have stopped in the middle of its own.
    os.write(1, f"\n@hnf {kind} {json.dumps(values)}\n".encode())


def main(child_process: Any, request: str, out: str) -> int:
    child_process.exit_with_parent()
    own = str(Path(__file__).resolve().parent)  # its modules are the add-on's, and no library is to meet them
    sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry) != own]
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
