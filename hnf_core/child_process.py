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
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

CORE = "hnf_core"
CORE_FOLDER = str(Path(__file__).resolve().parent)
EXIT_PARENT_GONE = 3


def exit_with_parent(*, kill_group: bool = False, on_line: Callable[[str], object] | None = None) -> None:
    """End this process as soon as its parent ends.

    The parent holds the other end of standard input, so end of file means that it has ended.

    Parameters
    ----------
    kill_group : bool
        Also kill the processes that this one started, if it leads a process group.
    on_line : callable, optional
        Called from a thread with each line that the parent writes, without its end; without it they are discarded.
    """

    def watch() -> None:
        unfinished = b""
        while True:
            try:
                data = os.read(0, 1024)
            except OSError:
                break
            if not data:
                break
            if on_line is not None:
                *lines, unfinished = (unfinished + data).split(b"\n")
                for line in lines:
                    on_line(line.decode("utf-8", "replace"))
        if kill_group and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(EXIT_PARENT_GONE)

    threading.Thread(target=watch, name="hnf parent watch", daemon=True).start()


def measure_memory() -> int:
    """Return the resident memory of this process [bytes]; on macOS its peak, and 0 if the system tells nothing."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, AttributeError):
        return _measure_on_windows() if sys.platform == "win32" else _measure_peak()


def _measure_peak() -> int:
    import resource  # Windows has none.

    return int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)  # In bytes on macOS.


def _measure_on_windows() -> int:
    import ctypes

    sizes = (ctypes.c_size_t * 9)()  # PROCESS_MEMORY_COUNTERS: two DWORDs, then eight sizes
    sizes[0] = ctypes.sizeof(sizes)
    kernel: Any = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    this_process = ctypes.c_void_p(kernel.GetCurrentProcess())
    return int(sizes[2]) if kernel.K32GetProcessMemoryInfo(this_process, sizes, sizes[0]) else 0


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
