"""A user's own recordings: a folder for each material, a CSV table for each stroke.

Columns are known by name, in any order and case, their unit behind it: `speed [mm/s]`, `speed (mm/s)` or `speed_mm_s`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from .data_files import find_files, parse_unit_factor, read_header, read_table
from .recording import ActionRange, DataSet, Recording, compute_action_range, match_name
from .time_series import MeasuredSignal, assemble_recording, check_time_grid, interpolate_series, measure_sampling_rate

Float = NDArray[np.float64]

COLUMNS = {
    "time": ("time", ""), "acceleration": ("acceleration", ""), "ax": ("acceleration", "x"),
    "ay": ("acceleration", "y"), "az": ("acceleration", "z"), "force": ("force", ""), "speed": ("speed", ""),
    "x": ("position", "x"), "y": ("position", "y"),
}  # fmt: skip
"""Name → quantity and axis."""
_SI_UNITS = {"time": "s", "acceleration": "m/s²", "force": "N", "speed": "m/s", "position": "m"}
_EXPECTED_COLUMNS = (
    "Name its columns time, acceleration (or ax, ay, az), force, speed, x, y: all but the first two may lack."
)
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class UserFolder(DataSet):
    """Materials are called like the folders that their tables lie in; tables in the folder itself like that one."""

    folder: Path

    @cached_property
    def _strokes(self) -> dict[str, list[Path]]:
        out: dict[str, list[Path]] = {}
        for path in find_files(self.folder, (".csv",)):
            out.setdefault((path.parent if path.parent != self.folder else self.folder.absolute()).name, []).append(
                path
            )
        return out

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
        return [read_stroke(path, known) for path in self._strokes[known]]

    def process(self, name: str) -> None:
        self._match_material(name)

    def action_range(self, name: str) -> ActionRange:
        return compute_action_range(self.recordings(name))

    def image(self, name: str) -> Path | None:
        beside = self._strokes[self._match_material(name)][0].parent
        return next((path for path in sorted(beside.iterdir()) if path.suffix.lower() in IMAGE_SUFFIXES), None)

    def _match_material(self, name: str) -> str:
        return match_name(name, self.materials, str(self.folder))


def read_stroke(path: Path, material: str) -> Recording:
    """One table → Recording. Raises FileError that says what is missing, in which column or line."""
    where = str(path)
    found, notes = _find_columns(path)
    table, bracketed = read_table(path, tuple(found))
    columns = [
        values
        * parse_unit_factor(
            COLUMNS[name][0], bracketed.get(title, unit) or _SI_UNITS[COLUMNS[name][0]], f"{where}, {title}"
        )
        for values, (title, (name, unit)) in zip(table.T, found.items(), strict=True)
    ]
    names = [name for name, _ in found.values()]
    bare = [title for title, (name, unit) in found.items() if not unit and title not in bracketed]
    if bare:
        units = ", ".join(f"{title} in {_SI_UNITS[COLUMNS[found[title][0]][0]]}" for title in bare)
        notes.append(f"without a unit, so taken as: {units}")
    time = columns[names.index("time")]
    check_time_grid(time, where)
    rate, of_the_grid = measure_sampling_rate(time, where)
    even = time[0] + np.arange(int((time[-1] - time[0]) * rate * (1.0 + 1e-9)) + 1) / rate
    signals = []
    for quantity in ("acceleration", "force", "speed", "position"):
        at = sorted((index for index, name in enumerate(names) if COLUMNS[name][0] == quantity), key=names.__getitem__)
        if at:
            values = interpolate_series(time, np.stack([columns[index] for index in at], axis=1), even)
            signals.append(
                MeasuredSignal(quantity, tuple(COLUMNS[names[index]][1] for index in at), values, rate, where)
            )
    whole = assemble_recording(signals, material, where)
    return Recording(
        whole.action, whole.samples, whole.sample_rate, material, where, whole.known,
        (*notes, *of_the_grid, *whole.notes, "the probe is taken as the pen"),
    )  # fmt: skip


def _find_columns(path: Path) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Title of each column that is read → (name in COLUMNS, unit behind an underscore or ""), and notes."""
    where, found, unread = str(path), dict[str, tuple[str, str]](), []
    for title in read_header(path):
        match = re.fullmatch(r"([a-z]+)(?:[_ ](\w+))?", title)
        if match is None or match[1] not in COLUMNS:
            unread += [title] if title else []
            continue
        if match[1] in [name for name, _ in found.values()]:
            raise FileError(f"two columns of {match[1]}.", where=where, remedy="Keep one of them.")
        found[title] = match[1], (match[2] or "").replace("_", "/")
    names = {name for name, _ in found.values()}
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
    return found, [f"columns not read: {', '.join(unread)}"] if unread else []
