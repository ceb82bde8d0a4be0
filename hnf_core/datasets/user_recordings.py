"""Reader of a user's own recordings: a folder for each material, a CSV table for each stroke.

Columns are identified by name, in any order and case, with their unit behind it: `speed [mm/s]`, `speed (mm/s)` or
`speed_mm_s`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..tables import parse_unit_factor, read_header, read_table
from .data_files import find_files
from .recording import ActionRange, DataSet, Recording, compute_action_range, match_name
from .time_series import (
    MeasuredSignal,
    assemble_recording,
    check_time_grid,
    interpolate_series,
    measure_sampling_rate,
    split_at_gaps,
)

Float = NDArray[np.float64]

COLUMNS = {
    "time": ("time", ""), "acceleration": ("acceleration", ""), "ax": ("acceleration", "x"),
    "ay": ("acceleration", "y"), "az": ("acceleration", "z"), "force": ("force", ""), "speed": ("speed", ""),
    "x": ("position", "x"), "y": ("position", "y"),
}  # fmt: skip
"""Quantity and axis of each column name."""
_SI_UNITS = {"time": "s", "acceleration": "m/s²", "force": "N", "speed": "m/s", "position": "m"}
_EXPECTED_COLUMNS = (
    "Name its columns time, acceleration (or ax, ay, az), force, speed, x, y: all but the first two may lack."
)
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class UserFolder(DataSet):
    """A folder of recordings; materials have the names of the folders that their tables are in."""

    folder: Path

    @cached_property
    def _strokes(self) -> dict[str, list[Path]]:
        tables: dict[str, list[Path]] = {}
        for path in find_files(self.folder, (".csv",)):
            tables.setdefault((path.parent if path.parent != self.folder else self.folder.absolute()).name, []).append(
                path
            )
        return tables

    @cached_property
    def materials(self) -> tuple[str, ...]:
        if not self._strokes:
            raise FileError(
                "no CSV table is in it.",
                where=str(self.folder),
                remedy="Give a folder with a folder for each material, and in that a table for each stroke.",
            )
        return tuple(sorted(self._strokes))

    def recordings(self, name: str) -> list[Recording]:
        known = self._match_material(name)
        return [recording for path in self._strokes[known] for recording in read_stroke(path, known)]

    def process(self, name: str) -> None:
        self._match_material(name)

    def action_range(self, name: str) -> ActionRange:
        return compute_action_range(self.recordings(name))

    def image(self, name: str) -> Path | None:
        material_folder = self._strokes[self._match_material(name)][0].parent
        return next((path for path in sorted(material_folder.iterdir()) if path.suffix.lower() in IMAGE_SUFFIXES), None)

    def _match_material(self, name: str) -> str:
        return match_name(name, self.materials, str(self.folder))


def read_stroke(path: Path, material: str) -> list[Recording]:
    """Read one table; it is cut where samples are missing for more than time_series.LONG_GAP_S.

    Raises FileError that names the missing or faulty column or line.
    """
    where = str(path)
    columns_by_title, notes = _find_columns(path)
    table, header_units = read_table(path, tuple(columns_by_title))
    columns = [
        values
        * parse_unit_factor(
            COLUMNS[name][0], header_units.get(title, unit) or _SI_UNITS[COLUMNS[name][0]], f"{where}, {title}"
        )
        for values, (title, (name, unit)) in zip(table.T, columns_by_title.items(), strict=True)
    ]
    names = [name for name, _ in columns_by_title.values()]
    without_unit = [title for title, (name, unit) in columns_by_title.items() if not unit and title not in header_units]
    if without_unit:
        units = ", ".join(f"{title} in {_SI_UNITS[COLUMNS[columns_by_title[title][0]][0]]}" for title in without_unit)
        notes.append(f"without a unit, so taken as: {units}")
    time = columns[names.index("time")]
    check_time_grid(time, where)
    rate = measure_sampling_rate(time, where)
    recordings = []
    for piece in split_at_gaps(time, where):
        assembled = _assemble_piece(names, [values[piece.rows] for values in columns], rate, material, where)
        notes_of_piece = (*notes, *piece.notes, *assembled.notes, "the probe is taken as the pen")
        recordings.append(replace(assembled, notes=notes_of_piece))
    return recordings


def _assemble_piece(names: list[str], columns: list[Float], rate: float, material: str, where: str) -> Recording:
    """Assemble columns without a long gap, called by names in `COLUMNS`, to a recording on an even grid."""
    time = columns[names.index("time")]
    grid = time[0] + np.arange(int((time[-1] - time[0]) * rate * (1.0 + 1e-9)) + 1) / rate
    signals = []
    for quantity in ("acceleration", "force", "speed", "position"):
        indices = sorted(
            (index for index, name in enumerate(names) if COLUMNS[name][0] == quantity), key=names.__getitem__
        )
        if indices:
            values = interpolate_series(time, np.stack([columns[index] for index in indices], axis=1), grid)
            signals.append(
                MeasuredSignal(quantity, tuple(COLUMNS[names[index]][1] for index in indices), values, rate, where)
            )
    return assemble_recording(signals, material, where)


def _find_columns(path: Path) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Return name in `COLUMNS` and unit (behind an underscore, or "") of each column by its title, and notes."""
    where, columns, unread = str(path), dict[str, tuple[str, str]](), []
    for title in read_header(path):
        axis = re.fullmatch(r"(?:acceleration|accel|acc)[_ ]?([xyz])(?:[_ ](\w+))?", title)
        match = axis or re.fullmatch(r"([a-z]+)(?:[_ ](\w+))?", title)
        name = f"a{axis[1]}" if axis else match[1] if match else ""
        if match is None or name not in COLUMNS:
            unread += [title] if title else []
            continue
        if name in [known for known, _ in columns.values()]:
            raise FileError(f"two columns of {name}.", where=where, remedy="Keep one of them.")
        columns[title] = name, (match[2] or "").replace("_", "/")
    names = {name for name, _ in columns.values()}
    axes = names & {"ax", "ay", "az"}
    if "time" not in names or not names & {"acceleration", "ax", "ay", "az"}:
        raise FileError(
            f"there is no column of {'acceleration' if 'time' in names else 'time'}.",
            where=where,
            remedy=_EXPECTED_COLUMNS,
        )
    if ("acceleration" in names and axes) or len(axes) == 2:
        raise FileError(
            "its acceleration is neither one column nor three.", where=where, remedy="Give acceleration, or ax, ay, az."
        )
    if len(names & {"x", "y"}) == 1:
        raise FileError("of x and y one is missing.", where=where, remedy="Give both, or speed alone.")
    return columns, [f"columns not read: {', '.join(unread)}"] if unread else []
