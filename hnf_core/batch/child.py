"""One `hnf` command in a process of its own: begun, watched, ended with all that it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..errors import FileError

ROOT = Path(__file__).resolve().parents[2]
CHILD_MODULE = f"{__package__}.in_child"
MAX_LINES, MAX_BYTES = 20, 4000
POLL_S = 0.2


@dataclass(frozen=True)
class CommandResult:
    """code: its exit code, below 0 the signal that killed it, None where it was stopped. stdout, stderr: last lines."""

    code: int | None
    seconds: float
    stdout: tuple[str, ...]
    stderr: tuple[str, ...]


def run_child(
    arguments: Sequence[str], base: Path, lock_descriptor: int, should_continue: Callable[[], bool]
) -> CommandResult:
    """Run `hnf words…` in folder base until it ends or may not go on.

    held: descriptor that the process holds too, whose lock tells that it lives. When this process dies, its child sees
    the end of its standard input and leaves. Raises FileError where it cannot be started.
    """
    began = time.monotonic()
    with (
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
        tempfile.TemporaryDirectory(prefix="hnf-batch-", ignore_cleanup_errors=True) as scratch,
    ):
        paths = os.pathsep.join(path for path in (str(ROOT), os.environ.get("PYTHONPATH", "")) if path)
        try:
            process = subprocess.Popen(
                # -P: the folder it runs in is the person's own, and no place to import from.
                [sys.executable, "-P", "-m", CHILD_MODULE, *arguments],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                cwd=base,
                env=os.environ | {"PYTHONPATH": paths, "TMPDIR": scratch},
                start_new_session=True,
                pass_fds=(lock_descriptor,),
            )
        except OSError as error:
            raise FileError(
                f"no command can be run there ({error.strerror or error}).",
                where=str(base),
                remedy="Check that this machine has the folder, and processes and memory left.",
            ) from error
        try:
            code = _wait(process, should_continue)
        finally:
            _kill_process_group(process)
        return CommandResult(code, time.monotonic() - began, _read_last_lines(out), _read_last_lines(err))


def _wait(process: subprocess.Popen[bytes], should_continue: Callable[[], bool]) -> int | None:
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(POLL_S)
        if not should_continue():
            return None


def _kill_process_group(process: subprocess.Popen[bytes]) -> None:
    """The whole group, also what the command started and left."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _read_last_lines(stream: IO[bytes]) -> tuple[str, ...]:
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - MAX_BYTES))
    return tuple(stream.read().decode("utf-8", "replace").splitlines()[-MAX_LINES:])
