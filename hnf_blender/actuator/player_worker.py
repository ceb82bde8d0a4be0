"""The child process that plays: `python worker.py CORE PATHS VERSION MODULE [WORD…]`, or under a background Blender,
`blender -b --factory-startup --python worker.py -- …`. It loads the parent's own hnf_core by its folder and calls
main(WORDS) of MODULE; neither preferences nor an enabled add-on are needed."""

import importlib
import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path

CORE = "hnf_core"
LIST_DEVICES = "devices"
"""In place of a module: say what there is to play on, one JSON object in one line, {"devices": [{"target", "title",
"facts"}], "without": [package], "missing": [why a list is short]}."""
WRONG_PYTHON = 4
"""Exit code of a Python that cannot do it: another version than the parent's, or one without numpy."""


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


def main(core: str, paths: str, version: str, module: str, *arguments: str) -> int:
    if version != "{}.{}".format(*sys.version_info):
        return WRONG_PYTHON
    sys.path += [entry for entry in json.loads(paths) if entry not in sys.path]
    try:
        importlib.import_module("numpy")
    except ImportError:
        return WRONG_PYTHON
    load_core(core)
    if module == LIST_DEVICES:
        return print_devices()
    return int(importlib.import_module(f"{CORE}.{module}").main(list(arguments)))


def print_devices() -> int:
    libraries = importlib.import_module(f"{CORE}.actuators.runtime")
    found = importlib.import_module(f"{CORE}.actuators.stream_targets").list_devices()
    without, missing = [], list(found.missing)
    for name, package in libraries.PIP_PACKAGES.items():
        try:
            libraries.import_optional(name)
        except Exception as error:
            without.append(package)
            if not any(package in line for line in missing):
                missing.append(str(error))
    devices = [{"target": each.target, "title": each.title, "facts": each.facts} for each in found.all]
    print(json.dumps({"devices": devices, "without": without, "missing": missing}), flush=True)
    return 0


if __name__ == "__main__":
    code = 1
    try:
        code = main(*(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]))
    except BaseException:
        traceback.print_exc()  # the parent shows the last line
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # a device's driver must not keep a process whose parent is gone
