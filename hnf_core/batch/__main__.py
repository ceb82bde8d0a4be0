"""The child process of a job: `python -P -m hnf_core.batch.__main__ WORDS…` is `hnf WORDS…`, but leaves when its parent
does, and tells its own refusals (exit codes 1 and 2) from what should not have happened."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
import traceback

PROGRAM = "hnf_blender.cli"
"""The `hnf` command, by its name as a shell would: this package may not know it."""
EXIT_BROKEN = 70
"""Exit code where an exception came through (EX_SOFTWARE of sysexits.h)."""


def exit_with_parent() -> None:
    """The parent holds the other end of standard input and never writes: its end is the parent's, however it died."""

    def watch() -> None:
        while True:
            try:
                if not os.read(0, 1024):
                    break
            except OSError:
                break
        if os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(EXIT_BROKEN)

    threading.Thread(target=watch, name="hnf parent watch", daemon=True).start()


def main(arguments: list[str]) -> int:
    """The command's exit code, or BROKEN. Never raises."""
    exit_with_parent()
    try:
        return int(importlib.import_module(PROGRAM).main(arguments))
    except BaseException:
        traceback.print_exc()
        return EXIT_BROKEN


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # some versions of the bpy module hang where they are left in order
