"""The child process of a job: `python -P -m hnf_core.batch.__main__ WORDS…` is `hnf WORDS…`, but leaves when its parent
does, and tells its own refusals (exit codes 1 and 2) from what should not have happened."""

from __future__ import annotations

import importlib
import sys
import traceback

from ..child_process import exit_with_parent, run_main

PROGRAM = "hnf_blender.cli"
"""The `hnf` command, by its name as a shell would: this package may not know it."""
EXIT_BROKEN = 70
"""Exit code where an exception came through (EX_SOFTWARE of sysexits.h)."""


def main(arguments: list[str]) -> int:
    """The command's exit code, or EXIT_BROKEN. Never raises."""
    exit_with_parent(kill_group=True)
    try:
        return int(importlib.import_module(PROGRAM).main(arguments))
    except BaseException:
        traceback.print_exc()
        return EXIT_BROKEN


if __name__ == "__main__":
    run_main(main, sys.argv[1:])
