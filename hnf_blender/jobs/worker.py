"""The child process of a bake: `blender -b --factory-startup --python worker.py -- CORE JOBFOLDER`, or with the bpy
module `python worker.py CORE JOBFOLDER`. CORE is the folder of hnf_core. It loads the parent's own package, by path and
under its own name, so that neither preferences nor an enabled add-on are needed."""

import importlib
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any


def load_child_process(core: str) -> Any:
    """hnf_core/child_process.py, by its path: a script that is run has no package."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(child_process: Any, job_folder: str) -> int:
    child_process.exit_with_parent()
    folder = Path(job_folder)
    order = json.loads((folder / "order.json").read_text(encoding="utf-8"))
    importlib.import_module("bpy")  # before the parent's paths: among them is the inside of the bpy module
    sys.path += [entry for entry in order["sys_path"] if entry not in sys.path]
    child_process.load_package(order["package"], order["package_folder"])
    bake_steps = importlib.import_module(order["package"] + ".jobs.bake_steps")
    return int(bake_steps.run_request(folder))


if __name__ == "__main__":
    child_process = load_child_process(sys.argv[-2])
    child_process.run_main(main, child_process, sys.argv[-1])
