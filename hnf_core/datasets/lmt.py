"""Reader of the LMT haptic texture databases of 69 and of 108 surfaces: accelerations without the hand's motion.

M. Strese, C. Schuwerk, A. Iepure & E. Steinbach (2017), "Multimodal feature-based surface material classification",
IEEE Transactions on Haptics 10(2). 69: Training/Accel/<label>_query<n>.txt,
Testing/AccelScansDFT321/<label>_<person>.txt, already fused. 108:
AccelScansComponents/Movement/{Training,Testing}/G<digit><Name>…_{train|test}<n>.txt, with or without an axis.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..signal import dft321
from ..tables import read_numbers
from .data_files import find_files
from .recording import ActionRange, DataSet, Recording, match_name, normalise_name
from .time_series import SIGNAL_RATE_HZ, build_action, constant_direction, count_action_samples

Float = NDArray[np.float64]

ASSUMED_SPEED_M_S = 0.1
"""Speed assumed for every scan [m/s]."""
ASSUMED_FORCE_N = 1.0
"""Force assumed for every scan [N]."""
ASSUMPTIONS = (
    f"no action was recorded: direction +x, {ASSUMED_SPEED_M_S:g} m/s and {ASSUMED_FORCE_N:g} N are assumed",
    "the files have no units: 10 kHz and m/s² are assumed",
    "the probe is taken as the pen",
)
"""Notes of every recording."""
_TAKE = r"(?P<take>(?:query|train|training|test|testing)_?\d+)"
_NAME_PATTERNS = (
    re.compile(rf"(?i)(?P<name>G\d.*?)(?:_(?:Movement|Accel\w*?))*(?:_(?P<axis>[XYZ]))?_{_TAKE}(?:_(?P<last>[XYZ]))?"),
    re.compile(rf"(?i)(?P<name>.+?)_{_TAKE}"),
    re.compile(r"(?P<name>.+?)_(?P<take>[^_]+)"),
)


@dataclass(frozen=True)
class LmtFolder(DataSet):
    """A folder of one of the LMT haptic texture databases.

    The hand's motion was not recorded: speed and force are assumed, as notes say, and a recording's `known` is empty.
    """

    folder: Path

    @cached_property
    def _strokes(self) -> dict[str, dict[str, dict[str, Path]]]:
        """Files by material and take (stroke), one per axis or "" for a file with fused axes."""
        strokes_by_material: dict[str, dict[str, dict[str, Path]]] = {}
        spelling: dict[str, str] = {}
        for path in find_files(self.folder, (".txt",)):
            parts = path.relative_to(self.folder).parts[:-1]
            if any(word in part.lower() for part in parts for word in ("sound", "image", "audio", "tapping", "impact")):
                continue
            match = next((candidate for pattern in _NAME_PATTERNS if (candidate := pattern.fullmatch(path.stem))), None)
            in_scan_folder = any("accel" in part.lower() for part in (self.folder.name, *parts))
            if match is None or not (in_scan_folder or _is_dataset_name(path.stem)):
                continue
            groups = match.groupdict()
            name = spelling.setdefault(normalise_name(groups["name"]), groups["name"])
            axis = (groups.get("axis") or groups.get("last") or "").lower()
            parts_without_axis = [part for part in parts if part.lower() not in ("x", "y", "z")]
            if not axis and len(parts_without_axis) < len(parts):
                axis = next(part.lower() for part in parts if part.lower() in ("x", "y", "z"))
            take = "/".join([*parts_without_axis, groups["take"]])
            strokes_by_material.setdefault(name, {}).setdefault(take, {})[axis] = path
        return strokes_by_material

    @cached_property
    def materials(self) -> tuple[str, ...]:
        if not self._strokes:
            raise FileError(
                "no accelerations of the 69 or the 108 set are in it.",
                where=str(self.folder),
                remedy="Give the folder with Training/Accel and Testing, or with AccelScansComponents.",
            )
        return tuple(sorted(self._strokes))

    def recordings(self, name: str) -> list[Recording]:
        known = match_name(name, self.materials, str(self.folder))
        return [read_scan(files, known) for _, files in sorted(self._strokes[known].items())]

    def process(self, name: str) -> None:
        match_name(name, self.materials, str(self.folder))

    def action_range(self, name: str) -> ActionRange:
        """Return the range of speed and force, which contains only the assumed values."""
        match_name(name, self.materials, str(self.folder))
        return ActionRange((ASSUMED_SPEED_M_S,) * 2, (ASSUMED_FORCE_N,) * 2)

    def image(self, name: str) -> Path | None:
        key = normalise_name(match_name(name, self.materials, str(self.folder)))
        images = find_files(self.folder, (".jpg", ".jpeg", ".png", ".bmp"))
        return next((path for path in images if normalise_name(path.stem).startswith(key)), None)


def _is_dataset_name(stem: str) -> bool:
    """Return True if a file name alone shows that it is of the databases; <label>_<person> is too general."""
    return any(pattern.fullmatch(stem) for pattern in _NAME_PATTERNS[:2])


def read_scan(files: dict[str, Path], material: str) -> Recording:
    """Read one take, the acceleration of one stroke.

    Parameters
    ----------
    files : dict of str to Path
        A fused file (axis ""), or one per axis.
    material : str
        Name of the material.

    Returns
    -------
    Recording
        Samples with the mean removed, axes fused by DFT321.

    Raises
    ------
    FileError
        If a file cannot be used, or some axes are missing.
    """
    where = str(next(iter(files.values())))
    if set(files) not in ({""}, {"x", "y", "z"}):
        raise FileError(
            f"of its axes only {', '.join(sorted(files))} are there.",
            where=where,
            remedy="Give X, Y and Z, or one file.",
        )
    columns = [read_numbers(files[axis]) for axis in sorted(files)]
    if len({len(column) for column in columns}) != 1:
        raise FileError("its axes are not equally long.", where=where, remedy="Get the files again.")
    values = np.stack([column - column.mean() for column in columns], axis=1)
    count = count_action_samples(len(values) / SIGNAL_RATE_HZ, where)
    action = build_action(
        constant_direction(count, 0.0), np.full(count, ASSUMED_SPEED_M_S), np.full(count, ASSUMED_FORCE_N)
    )
    fused = dft321(values) if values.shape[1] == 3 else values[:, 0].copy()
    return Recording(
        action, fused[: (count - 1) * 50].copy(), SIGNAL_RATE_HZ, material, where, frozenset(), ASSUMPTIONS
    )
