"""Every flat format that a signal leaves in and comes back from: one table, word → Format.

To add one: write two functions of the types below in a file of its own, and put a Format with them into FORMATS. The
command line, the loss report and the tests of all formats take it from there.

* A *writer* `(path, signal, options) -> (what it left out, …)` writes path atomically (`hnf_core/files.py`) and returns,
  in sentences, what the format has no place for; numbers are not needed, the loss report measures them. It raises
  FileError where the signal cannot be held (not finite, no rate that fits), UsageError where an option is missing.
* A *reader* `(path, options) -> Signal` gives back m/s². Where the format keeps envelopes only, they are rendered on a
  carrier (`tone.py`). It raises one FileError for whatever is wrong with the file, within bounded memory
  (`json_files.py` reads JSON so). None: the format cannot be read back, and its loss is told in words alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from ..signal import Signal
from .options import ExportOptions, ImportOptions

Writer = Callable[[Path, Signal, ExportOptions], tuple[str, ...]]
Reader = Callable[[Path, ImportOptions], Signal]


@dataclass(frozen=True)
class Format:
    """word: as asked for. suffix: of its files, with the dot. what: it is, in a sentence. checked: against what its files
    are validated, and what could not be checked. write, read: see above."""

    word: str
    suffix: str
    what: str
    checked: str
    write: Writer
    read: Reader | None


FORMATS: dict[str, Format] = {}


def format_of(word: str) -> Format:
    """Raises UsageError naming those there are."""
    if word not in FORMATS:
        raise UsageError(f"there is no format '{word}'.", remedy=f"There are: {', '.join(FORMATS)}.")
    return FORMATS[word]


def format_of_file(path: Path) -> Format:
    """The format to read path with, by its suffix. Raises UsageError naming those that can be read."""
    suffix = path.suffix.lower()
    for each in FORMATS.values():
        if each.suffix == suffix and each.read is not None:
            return each
    readable = sorted({each.suffix for each in FORMATS.values() if each.read is not None})
    raise UsageError(
        f"{path.name}: files of the kind '{path.suffix}' cannot be read.", remedy=f"Give one of {', '.join(readable)}."
    )
