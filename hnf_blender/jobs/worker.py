"""Entry point of the add-on's child processes: a bake or touch query, learning of a material, playing on an actuator.

Run as `PYTHON worker.py CORE TASK [WORD…]`, or under a background Blender as `blender -b --factory-startup --python
worker.py -- CORE TASK [WORD…]`. CORE is the folder of hnf_core, which is loaded by its path, so neither preferences nor
an enabled add-on are needed. TASK is a key of `TASKS`.
"""

import importlib
import importlib.util
import json
import os
import queue
import shutil
import sys
from pathlib import Path
from typing import Any

LIST_DEVICES = "devices"
"""Module of `play` that prints the devices as one line of JSON.

{"devices": [{"target", "title", "facts"}], "without": [missing package], "missing": [why a list is short]}
"""
WRONG_PYTHON = 4
"""Exit code of `play` if the Python version differs from the parent's or numpy is missing."""
NOTHING_TAKEN = 5
"""Exit code of `bake` if it ended between two jobs: a job that was given meanwhile was not begun."""


def bake(child_process: Any, own_folder: str, idle_s: str, max_bytes: str) -> int:
    """Run bakes and touch queries until one fails or none is left; return the exit code.

    Parameters
    ----------
    child_process : module
        Module `hnf_core.child_process`.
    own_folder : str
        Folder of this process, removed if it ends between two jobs.
    idle_s : str
        Time after which it ends if no job is given [s].
    max_bytes : str
        Memory that it may hold between two jobs [bytes].

    Notes
    -----
    Each line of standard input is the folder of a job, as a JSON string.
    """
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    child_process.exit_with_parent(on_line=lines.put)
    importlib.import_module("bpy")  # Imported before the parent's paths are added, as they contain bpy's own files.
    folder = Path(json.loads(lines.get()))
    request = json.loads((folder / "order.json").read_text(encoding="utf-8"))
    sys.path += [entry for entry in request["sys_path"] if entry not in sys.path]
    child_process.load_package(request["package"], request["package_folder"])
    job_runner = importlib.import_module(request["package"] + ".jobs.job_runner")
    while True:
        code = int(job_runner.run_request(folder))
        if code:
            return code
        try:
            may_go_on = job_runner.close_file(use_scripts=request["use_scripts"])
            if not may_go_on or child_process.measure_memory() > float(max_bytes):
                break
            _send_message("Waiting")
            folder = Path(json.loads(lines.get(timeout=float(idle_s))))
        except queue.Empty:
            break
    os.chdir(Path(own_folder).parent)  # Windows removes no folder in which a process works.
    shutil.rmtree(own_folder, ignore_errors=True)
    return NOTHING_TAKEN


def learn(child_process: Any, request: str, out: str) -> int:
    """Learn the material of a request and write its weights; return the exit code.

    The request is `hnf_core.training.learn.LearnRequest` as JSON, `out` the path of the weights. This Python is one
    outside Blender, without the project and bpy. Messages are printed, which `child_job.decode_message` reads.
    """
    child_process.exit_with_parent()
    own_folder = str(Path(__file__).resolve().parent)  # Libraries must not import this folder's modules.
    sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry) != own_folder]
    try:
        child_process.load_core()
        training = importlib.import_module(f"{child_process.CORE}.training.learn")
    except ImportError as error:
        _send_message("Failed", why=f"This Python cannot learn ({error}). Check it in the add-on's preferences.")
        return 1
    errors = importlib.import_module(f"{child_process.CORE}.errors")
    try:
        training.learn_material(
            training.LearnRequest(**json.loads(request)),
            Path(out),
            lambda progress: _send_message("Step", **vars(progress)),
        )
    except errors.HnfError as error:
        _send_message("Failed", why=str(error))
        return 1
    _send_message("Finished")
    return 0


def _send_message(kind: str, **values: object) -> None:
    # A library may have printed an incomplete line, so a line end comes first.
    os.write(1, f"\n@hnf {kind} {json.dumps(values)}\n".encode())


def play(child_process: Any, paths: str, version: str, module: str, *arguments: str) -> int:
    """Import a module of hnf_core with the parent's paths and run its `main`; return the exit code."""
    if version != "{}.{}".format(*sys.version_info):
        return WRONG_PYTHON
    sys.path += [entry for entry in json.loads(paths) if entry not in sys.path]
    try:
        importlib.import_module("numpy")
    except ImportError:
        return WRONG_PYTHON
    child_process.load_core()
    if module == LIST_DEVICES:
        return print_devices(child_process.CORE)
    return int(importlib.import_module(f"{child_process.CORE}.{module}").main(list(arguments)))


def print_devices(core: str) -> int:
    """Print the connected devices as one line of JSON; return the exit code 0."""
    runtime = importlib.import_module(f"{core}.actuators.runtime")
    listing = importlib.import_module(f"{core}.actuators.stream_targets").list_devices()
    missing_packages, notes = [], list(listing.missing)
    for name, package in runtime.PIP_PACKAGES.items():
        try:
            runtime.import_optional(name)
        except Exception as error:
            missing_packages.append(package)
            if not any(package in line for line in notes):
                notes.append(str(error))
    devices = [{"target": device.target, "title": device.title, "facts": device.facts} for device in listing.all]
    print(json.dumps({"devices": devices, "without": missing_packages, "missing": notes}), flush=True)
    return 0


TASKS = {"bake": bake, "learn": learn, "play": play}


def main() -> None:
    """Run the task of the command line, and end this process with its exit code."""
    core, task, *words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    # By its path, since this script belongs to no package when it is run.
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    child_process = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(child_process)
    child_process.run_main(TASKS[task], child_process, *words)


if __name__ == "__main__":
    main()
