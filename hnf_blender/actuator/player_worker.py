"""The child process that plays: `python player_worker.py CORE PATHS VERSION MODULE [WORD…]`, or under a background
Blender, `blender -b --factory-startup --python player_worker.py -- …`. It loads the parent's own hnf_core by its
folder, CORE, and calls main(WORDS) of MODULE; neither preferences nor an enabled add-on are needed."""

import importlib
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

LIST_DEVICES = "devices"
"""In place of a module: say what there is to play on, one JSON object in one line, {"devices": [{"target", "title",
"facts"}], "without": [package], "missing": [why a list is short]}."""
WRONG_PYTHON = 4
"""Exit code of a Python that cannot do it: another version than the parent's, or one without numpy."""


def load_child_process(core: str) -> Any:
    """hnf_core/child_process.py, by its path: a script that is run has no package."""
    spec: Any = importlib.util.spec_from_file_location("child_process", Path(core) / "child_process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(child_process: Any, paths: str, version: str, module: str, *arguments: str) -> int:
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
    runtime = importlib.import_module(f"{core}.actuators.runtime")
    found = importlib.import_module(f"{core}.actuators.stream_targets").list_devices()
    without, missing = [], list(found.missing)
    for name, package in runtime.PIP_PACKAGES.items():
        try:
            runtime.import_optional(name)
        except Exception as error:
            without.append(package)
            if not any(package in line for line in missing):
                missing.append(str(error))
    devices = [{"target": each.target, "title": each.title, "facts": each.facts} for each in found.all]
    print(json.dumps({"devices": devices, "without": without, "missing": missing}), flush=True)
    return 0


if __name__ == "__main__":
    core, *arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    child_process = load_child_process(core)
    child_process.run_main(main, child_process, *arguments)
