"""How this program was called, for lines that a person is to paste."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path


def get_command_prefix(argv: Sequence[str] | None = None) -> list[str]:
    """The words before a command: hnf as it was found, or Blender's way to it. argv: None = sys.argv."""
    first = (sys.argv if argv is None else argv)[0]
    name = Path(first).name.lower()
    if name.startswith("blender"):
        return [first, "-b", "--command", "hnf"]
    return [first] if name in {"hnf", "hnf.exe"} else ["hnf"]
