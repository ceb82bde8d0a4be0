"""Start and end of this project's child processes: import a package from its folder, run, end with the parent.

Only the standard library and no relative imports: scripts outside any package run this file by its path, under
Blender's Python or another version.
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
    """End this process as soon as its parent ends.

    The parent holds the other end of standard input and never writes to it, so end of file means that it has ended.

    Parameters
    ----------
    kill_group : bool
        Also kill the processes that this one started, if it leads a process group.
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
    """Import the package in `folder` under `name`, without adding its parent folder to `sys.path`.

    Parent packages that do not exist are created empty.

    Parameters
    ----------
    name : str
        Dotted name to import the package as.
    folder : str
        Folder that holds the package's ``__init__.py``.

    Raises
    ------
    ImportError
        If the folder holds no package.
    """
    parents = name.split(".")[:-1]
    for depth in range(1, len(parents) + 1):
        parent = types.ModuleType(".".join(parents[:depth]))
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
    """Import the `hnf_core` that this file belongs to, under that name."""
    load_package(CORE, CORE_FOLDER)


def run_main(main: Any, *arguments: object) -> NoReturn:
    """End this process with the exit code of ``main(*arguments)``, or 1 with a traceback if it raises.

    Interpreter shutdown is skipped: in order, it costs time in Blender and hangs some versions of its module bpy, and a
    device driver must not keep a process alive whose parent is gone.
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
