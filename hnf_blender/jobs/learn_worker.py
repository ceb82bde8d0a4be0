"""The child that learns a material, under a Python outside Blender: `PYTHON learn_worker.py CORE LESSON OUT`. It loads
the add-on's own hnf_core by its folder: nothing of the project is installed there, and no bpy. LESSON is
hnf_core.training.learn.Lesson as JSON, OUT the weights to write. It tells its steps as messages.py reads them."""

import importlib
import importlib.util
import json
import os
import sys
import threading
import traceback
from pathlib import Path

CORE = "hnf_core"
PARENT_GONE = 3


def leave_with_parent() -> None:
    """The parent holds the other end of standard input and never writes: its end is the parent's, however it died."""

    def watch() -> None:
        while True:
            try:
                if not os.read(0, 1024):
                    break
            except OSError:
                break
        os._exit(PARENT_GONE)

    threading.Thread(target=watch, name="hnf parent watch", daemon=True).start()


def load_core(folder: str) -> None:
    """Import the package in folder as hnf_core, and put nothing beside it on the path."""
    spec = importlib.util.spec_from_file_location(
        CORE, Path(folder) / "__init__.py", submodule_search_locations=[folder]
    )
    if spec is None or spec.loader is None:
        raise ImportError(f"there is no package in {folder}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[CORE] = module
    spec.loader.exec_module(module)


def send_message(kind: str, **values: object) -> None:
    # A new line first: a library may have stopped in the middle of its own.
    os.write(1, f"\n@hnf {kind} {json.dumps(values)}\n".encode())


def main(core: str, request: str, out: str) -> int:
    leave_with_parent()
    own = str(Path(__file__).resolve().parent)  # its modules are the add-on's, and no library is to meet them
    sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry) != own]
    try:
        load_core(core)
        learn = importlib.import_module(f"{CORE}.training.learn")
    except ImportError as error:
        send_message("Failed", why=f"This Python cannot learn ({error}). Check it in the add-on's preferences.")
        return 1
    errors = importlib.import_module(f"{CORE}.errors")
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
    code = 1
    try:
        code = main(*sys.argv[1:])
    except BaseException:
        traceback.print_exc()  # the parent shows the last lines
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
