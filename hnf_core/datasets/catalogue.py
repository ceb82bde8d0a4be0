"""One door to all data sets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import UsageError
from .cluster import ClusterFolder
from .dataset import DataSet
from .hatt import HattFolder
from .lmt import LmtFolder
from .own import UserFolder
from .simulated import SimulatedLibrary

_FOLDER_TYPES: dict[str, Callable[[Path], DataSet]] = {
    "own": UserFolder, "hatt": HattFolder, "cluster": ClusterFolder, "lmt": LmtFolder,
}  # fmt: skip
DATASET_KINDS = (*_FOLDER_TYPES, "simulated")
LICENCES = {
    "own": "trained on the user's own recordings",
    "hatt": "trained on the Penn Haptic Texture Toolkit: non-profit research only, not to be redistributed",
    "cluster": "trained on the Cluster Haptic Texture Database (CC BY 4.0, doi 10.6084/m9.figshare.29438288)",
    "lmt": "trained on the LMT haptic texture database: its own terms apply",
    "simulated": "GPL-3.0-or-later",
}
"""What weights that were trained on a kind say of themselves."""


def open_dataset(kind: str, folder: Path | None) -> DataSet:
    """kind: one of KINDS. folder: the user's own copy; the simulator has none. Nothing is read yet.

    Raises UsageError for an unknown kind, a missing folder, or one too many.
    """
    if kind not in DATASET_KINDS:
        raise UsageError(f"{kind!r} is no data set.", remedy=f"Known are {', '.join(DATASET_KINDS)}.")
    if kind == "simulated":
        if folder is not None:
            raise UsageError("simulated data have no folder.", remedy="Leave the folder out.")
        return SimulatedLibrary()
    if folder is None:
        raise UsageError(f"{kind} needs the folder of your recordings.", remedy=f"For example: --data {kind} DIR")
    return _FOLDER_TYPES[kind](folder)
