"""Supervise a command at a shell, since a damaged file can end Blender's process, which then says nothing.

Blender's readers trust what a file says of itself. The command runs in a fork of this process, made before anything
slow is imported; this process waits for it, and says in one line on which file Blender broke down.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from hnf_core.errors import FileError, HnfError

SLOW_READ_S = 10.0
"""Time that Blender reads a file [s] after which a note says so."""
SLOW_READ_NOTE = (
    "{}: Blender is still reading it. A large file takes long, a damaged one perhaps forever: Ctrl-C stops it."
)
CRASHES = ("SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL", "SIGTRAP")
"""Signals by which a program ends that broke down by itself."""
FORWARDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
PR_SET_PDEATHSIG = 1
"""Number of the request to Linux that a signal be sent when the parent ends."""

_is_supervised = False
_pipe: int | None = None
"""In a supervised process that has read no file yet: where it says which one Blender reads."""


def run_supervised(run: Callable[[], int]) -> int:
    """Run a command in a fork of this process; return its exit code, or 1 with one line on stderr if it broke down.

    The fork returns from here too. A signal that ended it from outside ends this process as well. Where a system
    cannot fork (Windows), the command runs in this process.
    """
    global _pipe, _is_supervised
    if not hasattr(os, "fork"):
        return run()
    # A terminal sends an interrupt to both processes, a program to one: the fork heeds that alone which is sent on.
    forwarded = {getattr(signal, name): getattr(signal, name) for name in FORWARDED} | {signal.SIGINT: signal.SIGUSR1}
    reading, writing = os.pipe()
    parent, mask = os.getpid(), signal.pthread_sigmask(signal.SIG_BLOCK, forwarded)
    child = os.fork()
    if child == 0:
        os.close(reading)
        _pipe = writing
        _end_with_parent(parent)
        signal.signal(signal.SIGINT, lambda number, frame: None)
        signal.signal(signal.SIGUSR1, signal.default_int_handler)
        _is_supervised = True
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        return run()
    os.close(writing)
    # They stay blocked here: a handler would run late if a signal came just before this process begins to wait.
    threading.Thread(target=_forward_signals, args=(child, forwarded), daemon=True).start()
    path, was_read = _follow_read(reading)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status):
        return os.WEXITSTATUS(status)
    return _report_signal(signal.Signals(os.WTERMSIG(status)), path, was_read)


def is_supervised() -> bool:
    """Return True if this process is supervised, and gets its interrupts from the one that does."""
    return _is_supervised


@contextlib.contextmanager
def announce_read(path: Path) -> Iterator[None]:
    """Tell the process that supervises this one, if one does, that Blender reads this file in the with block."""
    global _pipe
    if _pipe is None:
        yield
        return
    os.write(_pipe, os.fsencode(path) + b"\0")
    try:
        yield
    finally:
        os.write(_pipe, b"\0")
        os.close(_pipe)
        _pipe = None


def _end_with_parent(parent: int) -> None:
    """Let Linux kill this process when its parent is killed; elsewhere it finishes its work."""
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _forward_signals(process: int, forwarded: dict[signal.Signals, signal.Signals]) -> None:
    """Wait for blocked signals for ever, and send a process what stands for each in `forwarded`."""
    while True:
        number = signal.Signals(signal.sigwait(forwarded))
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, forwarded[number])


def _follow_read(pipe: int) -> tuple[str, bool]:
    """Wait until the supervised process has read its file, or ended; return the file, and whether it was read."""
    said, was_noted = b"", False
    while True:
        path = os.fsdecode(said.rstrip(b"\0"))
        if not select.select([pipe], [], [], SLOW_READ_S if said and not was_noted else None)[0]:
            print(f"note: {SLOW_READ_NOTE.format(path)}", file=sys.stderr, flush=True)
            was_noted = True
        elif data := os.read(pipe, 4096):
            said += data
        else:
            os.close(pipe)
            return path, said.endswith(b"\0\0")


def _report_signal(number: signal.Signals, path: str, was_read: bool) -> int:
    """Say in one line why the supervised process ended by a signal; return the exit code.

    Ends by the same signal if someone sent it, so that whoever waits for this process sees what ended the command.
    """
    from hnf_core.files import remove_dead_folders

    remove_dead_folders()
    error: HnfError
    if number == signal.SIGKILL and path and not was_read:
        error = FileError(
            "the system ended Blender while it read it, as if memory had run out.",
            where=path,
            remedy="Export or download it again, since a damaged file may ask for any amount; or free some memory.",
        )
    elif number.name not in CRASHES:
        with contextlib.suppress(OSError):  # of SIGKILL nobody can change what it does
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
        signal.raise_signal(number)
        return 1
    elif path and not was_read:
        error = FileError(
            f"is damaged: Blender broke down when it read it ({number.name}).",
            where=path,
            remedy="Export or download it again; or, if Blender opens it, save it there anew.",
        )
    else:
        error = HnfError(
            f"Blender broke down ({number.name}).",
            where=path,
            remedy="Run it again: what was finished is kept. If it ends alike, report it with what hnf doctor prints.",
        )
    print(f"hnf: {error}", file=sys.stderr)
    return 1
