"""The child process of a job: `python -P -m hnf_core.batch WORDS…` runs `hnf WORDS…`.

It exits when its parent does. Its exit code is that of the command (1 and 2 are refusals), or EXIT_BROKEN after an
exception that nothing caught.
"""

from __future__ import annotations

import importlib
import sys
import traceback

from ..child_process import exit_with_parent, run_main

PROGRAM = "hnf_blender.cli"
"""Module of the `hnf` command, imported by name because this package may not depend on it."""
EXIT_BROKEN = 70
"""Exit code after an unexpected exception (EX_SOFTWARE of sysexits.h)."""


def main(arguments: list[str]) -> int:
    """Run the command and return its exit code, or EXIT_BROKEN. Never raises."""
    exit_with_parent(kill_group=True)
    try:
        return int(importlib.import_module(PROGRAM).main(arguments))
    except BaseException:
        traceback.print_exc()
        return EXIT_BROKEN


if __name__ == "__main__":
    run_main(main, sys.argv[1:])
