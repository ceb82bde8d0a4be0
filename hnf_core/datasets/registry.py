"""Opening of texture data sets by their kind, and the recordings that a field is trained on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..action.synthetic_actions import make_random_smooth_action
from ..errors import UsageError
from .cluster_database import ClusterFolder
from .hatt import HattFolder
from .lmt import LmtFolder
from .recording import DataSet, Recording
from .simulated import SimulatedLibrary
from .time_series import UserFolder

_FOLDER_TYPES: dict[str, Callable[[Path], DataSet]] = {
    "own": UserFolder, "hatt": HattFolder, "cluster": ClusterFolder, "lmt": LmtFolder,
}  # fmt: skip
DATASET_KINDS = (*_FOLDER_TYPES, "simulated")
"""Kinds of data sets."""
LICENCES = {
    "own": "trained on the user's own recordings",
    "hatt": "trained on the Penn Haptic Texture Toolkit: non-profit research only, not to be redistributed",
    "cluster": "trained on the Cluster Haptic Texture Database (CC BY 4.0, doi 10.6084/m9.figshare.29438288)",
    "lmt": "trained on the LMT haptic texture database: its own terms apply",
    "simulated": "GPL-3.0-or-later",
}
"""Licence statement of weights trained on each kind."""


def open_dataset(kind: str, folder: Path | None) -> DataSet:
    """Open a data set, without reading anything yet.

    Parameters
    ----------
    kind : str
        One of `DATASET_KINDS`.
    folder : Path or None
        The user's copy; None for the simulator.

    Returns
    -------
    DataSet
        The data set.

    Raises
    ------
    UsageError
        For an unknown kind, a missing folder, or an unnecessary one.
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


TRAINING_STROKE_S = 5.0
"""Duration of a training stroke [s]."""
LOW_END_FACTOR = 0.6
"""Factor below the least speed and force of a model's data that strokes go down to: hands do, and the model fades
there."""
TYPICAL_SPEED_M_S, TYPICAL_FORCE_N = (0.03, 0.2), (0.3, 3.0)
"""Ranges of typical speeds [m/s] and forces [N]."""
TYPICAL_SHARE = 0.7
"""Fraction of strokes within the typical ranges; the others cover the complete range of the data."""


def get_training_recordings(
    data: DataSet, name: str, seconds: float, seed: int, source: str | None = None
) -> list[Recording]:
    """Return the recordings to train a material on: strokes on its model, or recorded ones.

    Parameters
    ----------
    data : DataSet
        The data set.
    name : str
        Name of the material.
    seconds : float
        Total duration of strokes on a model [s].
    seed : int
        Seed of the strokes and of the model.
    source : str, optional
        "recordings" to use recordings even if there is a model.

    Returns
    -------
    list of Recording
        The recordings.

    Raises
    ------
    UsageError
        If there are no recordings, or `seconds` is out of range.
    """
    process, recorded = data.process(name), []
    if process is None or source == "recordings":
        recorded = data.recordings(name)
        if not recorded:
            raise UsageError(
                f"there are no recordings of {name!r} here.", remedy="Leave --source out to use its model."
            )
        return recorded
    if not TRAINING_STROKE_S <= seconds < 1e5:
        raise UsageError(f"--seconds {seconds:g}: give at least {TRAINING_STROKE_S:g}.", remedy="480 is plenty.")
    limits = data.action_range(name)
    speed, force = ((LOW_END_FACTOR * low, high) for low, high in (limits.speed_m_s, limits.force_n))
    count = round(seconds / TRAINING_STROKE_S)
    actions = [
        make_random_smooth_action(
            TRAINING_STROKE_S, seed * 100_003 + index,
            speed_m_s=_intersect_ranges(speed, TYPICAL_SPEED_M_S) if index < TYPICAL_SHARE * count else speed,
            force_n=_intersect_ranges(force, TYPICAL_FORCE_N) if index < TYPICAL_SHARE * count else force,
            angle_rad=limits.angle_rad,
        )
        for index in range(count)
    ]  # fmt: skip
    return process.record(actions, seed)


def _intersect_ranges(limits: tuple[float, float], typical: tuple[float, float]) -> tuple[float, float]:
    """Return the intersection of two ranges, or `limits` if it spans less than a factor of 1.5."""
    low, high = max(limits[0], typical[0]), min(limits[1], typical[1])
    return (low, high) if high >= 1.5 * low else limits
