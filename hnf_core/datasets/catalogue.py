"""One door to all data sets."""

from __future__ import annotations

from pathlib import Path

from ..errors import UsageError
from .dataset import DataSet
from .hatt import HattFolder

KINDS = ("hatt",)


def open_dataset(kind: str, folder: Path | None) -> DataSet:
    """kind: one of KINDS. folder: the user's own copy. Nothing is read yet.

    Raises UsageError for an unknown kind or a missing folder.
    """
    if kind not in KINDS:
        raise UsageError(f"{kind!r} is no data set.", remedy=f"Known are {', '.join(KINDS)}.")
    if folder is None:
        raise UsageError(f"{kind} needs the folder of your own copy.", remedy=f"For example: --data {kind} DIR")
    return HattFolder(folder)
