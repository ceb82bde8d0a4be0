"""Entry point of the child process of a bake or touch query.

Run as `blender -b --factory-startup --python worker.py -- CORE JOBFOLDER`, or with the bpy module as `python worker.py
CORE JOBFOLDER`. CORE is the folder of hnf_core. It loads the parent's package by its path and name, so neither
preferences nor an enabled add-on are needed.
"""

import importlib
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any


def load_child_process(core: str) -> Any:
    """Load hnf_core/child_process.py by its path, since this script belongs to no package when it is run."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(child_process: Any, job_folder: str) -> int:
    """Run the request in the job's folder; return the exit code."""
    child_process.exit_with_parent()
    folder = Path(job_folder)
    request = json.loads((folder / "order.json").read_text(encoding="utf-8"))
    importlib.import_module("bpy")  # Imported before the parent's paths are added, as they contain bpy's own files.
    sys.path += [entry for entry in request["sys_path"] if entry not in sys.path]
    child_process.load_package(request["package"], request["package_folder"])
    job_runner = importlib.import_module(request["package"] + ".jobs.job_runner")
    return int(job_runner.run_request(folder))


if __name__ == "__main__":
    child_process = load_child_process(sys.argv[-2])
    child_process.run_main(main, child_process, sys.argv[-1])
