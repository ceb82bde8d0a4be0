"""What the child processes of this project have in common: they leave with their parent, load a package from its
folder, and end at once.

The standard library alone and no relative import: scripts that belong to no package run this file by its path, under
Blender's Python or another version's.
"""

import importlib.util
import os
import signal
import sys
import threading
import traceback
import types
from pathlib import Path
from typing import Any, NoReturn

CORE = "hnf_core"
CORE_FOLDER = str(Path(__file__).resolve().parent)
EXIT_PARENT_GONE = 3


def exit_with_parent(*, kill_group: bool = False) -> None:
    """The parent holds the other end of standard input and never writes: its end is the parent's, however it died.

    kill_group: what this process started ends too, where it leads a process group of its own.
    """

    def watch() -> None:
        while True:
            try:
                if not os.read(0, 1024):
                    break
            except OSError:
                break
        if kill_group and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(EXIT_PARENT_GONE)

    threading.Thread(target=watch, name="hnf parent watch", daemon=True).start()


def load_package(name: str, folder: str) -> None:
    """Import the package in folder as name, and put nothing beside it on the path. Packages above it that nothing
    provides are made up, empty."""
    above = name.split(".")[:-1]
    for depth in range(1, len(above) + 1):
        parent = types.ModuleType(".".join(above[:depth]))
        parent.__path__ = []
        sys.modules.setdefault(parent.__name__, parent)
    spec = importlib.util.spec_from_file_location(
        name, Path(folder) / "__init__.py", submodule_search_locations=[folder]
    )
    if spec is None or spec.loader is None:
        raise ImportError(f"there is no package in {folder}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)


def load_core() -> None:
    """Import the hnf_core that this file is in, under that name."""
    load_package(CORE, CORE_FOLDER)


def run_main(main: Any, *arguments: object) -> NoReturn:
    """End this process with the code that main(*arguments) returns; 1 where it raises, and standard error says why.

    Nothing is waited for: to leave Blender in order costs time, and hangs some versions of its module; a device's
    driver must not keep a process whose parent is gone.
    """
    code = 1
    try:
        code = main(*arguments)
    except BaseException:
        traceback.print_exc()  # the parent shows the last lines
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
