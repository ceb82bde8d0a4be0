"""One folder a job, named after the process that owns it: what a crashed Blender leaves is found by the next."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from hnf_core.errors import FileError

JOB_FOLDER_PREFIX = "hnf-job-"


def get_job_root() -> Path:
    import tempfile  # brings shutil and four packers along: 3 ms that switching on need not take

    return Path(tempfile.gettempdir())


def make_job_folder() -> Path:
    """A fresh, private folder of this process; those of dead ones go. Raises FileError where the disk refuses."""
    import tempfile

    where = ""
    try:
        where = str(get_job_root())
        remove_abandoned_folders()
        return Path(tempfile.mkdtemp(prefix=f"{JOB_FOLDER_PREFIX}{os.getpid()}-", dir=where))
    except OSError as error:
        raise FileError(
            f"no temporary folder can be made ({error.strerror}).",
            where=where or "the system's temporary folder",
            remedy="Free some disk space, or set another temporary folder for the system.",
        ) from error


def remove_job_folder(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned_folders() -> list[Path]:
    """Remove the folders of processes that are gone; returns them."""
    gone = []
    for folder in get_job_root().glob(f"{JOB_FOLDER_PREFIX}*"):
        owner = re.match(rf"{JOB_FOLDER_PREFIX}(\d+)-", folder.name)
        if owner and not is_process_alive(int(owner.group(1))):
            remove_job_folder(folder)
            gone.append(folder)
    return gone


def is_process_alive(pid: int) -> bool:
    """Does a process of this number run? A zombie does not."""
    if sys.platform == "win32":
        return _is_windows_process_alive(pid)
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):  # no /proc here
        return True


def _is_windows_process_alive(pid: int) -> bool:
    import ctypes

    query, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query, False, pid)
    if not handle:
        return False
    code = ctypes.c_ulong()
    kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return code.value == still_active
