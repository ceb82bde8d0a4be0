"""Entry point of the child processes that play or list devices.

Run as `python player_worker.py CORE PATHS VERSION MODULE [WORD…]`, or under a background Blender as
`blender -b --factory-startup --python player_worker.py -- …`. It loads the parent's hnf_core from its folder CORE and
calls `main([WORD…])` of MODULE; it needs neither preferences nor an enabled add-on.
"""

import importlib
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

LIST_DEVICES = "devices"
"""Value of MODULE that prints the devices as one line of JSON.

{"devices": [{"target", "title", "facts"}], "without": [missing package], "missing": [why a list is short]}
"""
WRONG_PYTHON = 4
"""Exit code if the Python version differs from the parent's or numpy is missing."""


def load_child_process(core: str) -> Any:
    """Load hnf_core/child_process.py by its path, since this script belongs to no package when it is run."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(child_process: Any, paths: str, version: str, module: str, *arguments: str) -> int:
    """Import MODULE with the parent's paths and run it; return the exit code."""
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


if __name__ == "__main__":
    core, *arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    child_process = load_child_process(core)
    child_process.run_main(main, child_process, *arguments)
