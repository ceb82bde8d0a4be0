"""The Python of these tests, which has torch, lent to the application as the one outside Blender that learns."""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path

NAME = "home/torch/bin/python"
"""In the shared folder."""


def parts() -> list[Path]:
    """What it consists of on this machine: its environment, and the program, library and modules it was made from."""
    library = Path(sysconfig.get_config_var("LIBDIR") or "", sysconfig.get_config_var("INSTSONAME") or "")
    needed = [Path(sys.prefix), Path(os.path.realpath(sys.executable)), Path(sysconfig.get_path("stdlib"))]
    return [*needed, *([library] if library.suffix != ".a" and library.is_file() else [])]


def lend(share: Path) -> None:
    """Make share/NAME start it, as `App.run` lends its parts."""
    program = share / NAME
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    program.chmod(0o755)
