"""The child process of a bake: `blender -b --factory-startup --python worker.py -- JOBFOLDER`, or with the bpy module
`python worker.py JOBFOLDER`. It loads the parent's own package, by path and under its own name, so that neither
preferences nor an enabled add-on are needed."""

import importlib
import importlib.util
import json
import os
import sys
import threading
import traceback
import types
from pathlib import Path

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


def load_package(name: str, folder: str) -> None:
    """Import the package in folder as name; packages above it that nothing provides are made up, empty."""
    above = name.split(".")[:-1]
    for depth in range(1, len(above) + 1):
        sys.modules.setdefault(".".join(above[:depth]), _empty_package(".".join(above[:depth])))
    spec = importlib.util.spec_from_file_location(
        name, Path(folder) / "__init__.py", submodule_search_locations=[folder]
    )
    if spec is None or spec.loader is None:
        raise ImportError(f"there is no package in {folder}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)


def _empty_package(name: str) -> types.ModuleType:
    package = types.ModuleType(name)
    package.__path__ = []
    return package


def main(folder: Path) -> int:
    leave_with_parent()
    order = json.loads((folder / "order.json").read_text(encoding="utf-8"))
    importlib.import_module("bpy")  # before the parent's paths: among them is the inside of the bpy module
    sys.path += [entry for entry in order["sys_path"] if entry not in sys.path]
    load_package(order["package"], order["package_folder"])
    child = importlib.import_module(order["package"] + ".jobs.bake_steps")
    return int(child.run_request(folder))


if __name__ == "__main__":
    code = 1
    try:
        code = main(Path(sys.argv[-1]))
    except BaseException:
        traceback.print_exc()  # the parent shows the last lines
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # leaving Blender in order would cost time, and some versions of the module hang there
