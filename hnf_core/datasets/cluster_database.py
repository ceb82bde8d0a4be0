"""Reader of the Cluster Haptic Texture Database: 118 materials, stroked in eight directions.

CC BY 4.0, doi 10.6084/m9.figshare.29438288. Layout:
sensor_data/{accel,force,position}/<id>/<id>_<direction>_<speed>_<force>_<repetition>.csv; photographs img<id>.jpg.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import FileError
from ..signal import dft321
from ..tables import parse_unit_factor, read_table
from .data_files import find_files
from .recording import ActionRange, DataSet, Recording, compute_action_range, match_name
from .time_series import (
    SIGNAL_RATE_HZ,
    Piece,
    build_action,
    check_time_grid,
    constant_direction,
    count_action_samples,
    derive_motion,
    interpolate_series,
    measure_sampling_rate,
    resample_to_action_rate,
    split_at_gaps,
)

Float = NDArray[np.float64]

FAMILIES = ((38, "wood"), (49, "stone"), (65, "polymer"), (74, "metal"), (79, "glass"), (82, "composite"),
            (87, "ceramic"), (102, "biodegradable"), (118, "cloth"))  # fmt: skip
"""First identity after each family, and the family."""
_NAME = re.compile(r"(\d+)_(\d+(?:\.\d+)?)_(\d+(?:\.\d+)?)_(\d+(?:\.\d+)?)_(\d+)")


@dataclass(frozen=True)
class ClusterFolder(DataSet):
    """A folder of the database; materials are called "<family> <id>", as "wood 12"; the number alone is accepted."""

    folder: Path

    @cached_property
    def _strokes(self) -> dict[int, dict[str, dict[str, Path]]]:
        """Files by identity, stroke and quantity."""
        strokes_by_identity: dict[int, dict[str, dict[str, Path]]] = {}
        for path in find_files(self.folder, (".csv",)):
            match = _NAME.fullmatch(path.stem)
            parents = [part.lower() for part in path.relative_to(self.folder).parts[:-1]] or [self.folder.name.lower()]
            quantity = next(
                (name for name in ("accel", "force", "position") if any(name in part for part in parents)), ""
            )
            if match and quantity:
                strokes_by_identity.setdefault(int(match[1]), {}).setdefault(path.stem, {})[quantity] = path
        return {
            identity: strokes
            for identity, strokes in strokes_by_identity.items()
            if any("accel" in files for files in strokes.values())
        }

    @cached_property
    def materials(self) -> tuple[str, ...]:
        if not self._strokes:
            raise FileError(
                "no accel/<id>/<id>_<direction>_<speed>_<force>_<repetition>.csv is in it.",
                where=str(self.folder),
                remedy="Give the folder that holds sensor_data, or sensor_data itself.",
            )
        return tuple(f"{get_family(identity)} {identity}" for identity in sorted(self._strokes))

    def recordings(self, name: str) -> list[Recording]:
        known, identity = self._find_identity(name)
        strokes = self._strokes[identity]
        complete = [files for _, files in sorted(strokes.items()) if "accel" in files]
        return [recording for files in complete for recording in read_stroke(files, known)]

    def process(self, name: str) -> None:
        self._find_identity(name)

    def action_range(self, name: str) -> ActionRange:
        return compute_action_range(self.recordings(name))

    def image(self, name: str) -> Path | None:
        identity = self._find_identity(name)[1]
        images = find_files(self.folder, (".jpg", ".jpeg", ".png"))
        matching = [path for path in images if re.fullmatch(rf"(?i)img[ _]?0*{identity}", path.stem)]
        # The image of the scanned area is preferred, because the strokes ran over it.
        return max(matching, key=lambda path: "scan" in str(path.parent).lower(), default=None)

    def _find_identity(self, name: str) -> tuple[str, int]:
        numbered = {material.rpartition(" ")[2]: material for material in self.materials}
        known = numbered.get(name.strip()) or match_name(name, self.materials, str(self.folder))
        return known, int(known.rpartition(" ")[2])


def get_family(identity: int) -> str:
    """Return the family of an identity."""
    return next((name for end, name in FAMILIES if identity < end), "material")


def read_stroke(files: dict[str, Path], material: str) -> list[Recording]:
    """Read the files of one stroke; it is cut where accelerations are missing for more than LONG_GAP_S.

    Parameters
    ----------
    files : dict of str to Path
        Files by quantity (accel, force, position).
    material : str
        Name of the material.

    Returns
    -------
    list of Recording
        Acceleration at 10 kHz [m/s²], mean removed, fused by DFT321, from irregular samples of about 6 kHz in g.
        Direction and speed come from positions, force from its sensor, each below 20 Hz; for a missing file the value
        in the stroke's name is assumed and noted.

    Raises
    ------
    FileError
        For a file that cannot be used.
    """
    path = files["accel"]
    where = str(path)
    time, axes = _read_series(path, ("X", "Y", "Z"), "acceleration", "g")
    rate = measure_sampling_rate(time, where)
    force = _read_series(files["force"], ("force",), "force", "N") if "force" in files else None
    position = _read_series(files["position"], ("X", "Y"), "position", "mm") if "position" in files else None
    return [
        _assemble_piece(path, time, axes, piece, rate, force, position, material)
        for piece in split_at_gaps(time, where)
    ]


def _assemble_piece(
    path: Path,
    time: Float,
    axes: Float,
    piece: Piece,
    rate: float,
    force: tuple[Float, Float] | None,
    position: tuple[Float, Float] | None,
    material: str,
) -> Recording:
    """Assemble a piece of a stroke without a long gap. force, position: times (n,) [s] and values (n, k), if known."""
    where, time, axes = str(path), time[piece.rows], axes[piece.rows]
    grids = [time, *(series[0] for series in (force, position) if series is not None)]
    start, stop = max(grid[0] for grid in grids), min(grid[-1] for grid in grids)
    count = count_action_samples(stop - start, where)
    times = start + np.arange(round((count - 1) / 200.0 * SIGNAL_RATE_HZ)) / SIGNAL_RATE_HZ
    samples = interpolate_series(time, axes, times)
    resampled_from = f"{rate:.0f} Hz resampled to 10 kHz; gravity removed"
    known, notes = set(), [resampled_from, "the probe is taken as the pen", *piece.notes]
    angle, speed, newtons = _parse_stroke_name(path)
    if force is None:
        notes.append(f"no force file: {newtons:g} N assumed, as its name says")
    else:
        known.add("force")
    if position is None:
        notes.append(f"no position file: {np.degrees(angle):g}° and {speed:g} m/s assumed, as its name says")
    else:
        known |= {"direction", "speed"}

    def measure_action(count: int, rate: float) -> Action:
        force_n = np.full(count, newtons)
        direction, speed_m_s = constant_direction(count, angle), np.full(count, speed)
        if force is not None:
            force_n = resample_to_action_rate(*force, start, count, rate)[:, 0]
        if position is not None:
            direction, speed_m_s = derive_motion(resample_to_action_rate(*position, start, count, rate), rate)
        return build_action(direction, speed_m_s, force_n, rate)

    return Recording(
        measure_action(count, ACTION_RATE_HZ), dft321(samples - samples.mean(axis=0)), SIGNAL_RATE_HZ, material,
        where, frozenset(known), tuple(notes),
        (lambda: measure_action(len(samples) + 1, SIGNAL_RATE_HZ)) if known else None,
    )  # fmt: skip


def _read_series(path: Path, columns: tuple[str, ...], quantity: str, unit: str) -> tuple[Float, Float]:
    """Read time (n,) [s] and values (n, k) in SI units."""
    table, units = read_table(path, ("time", *columns))
    time = table[:, 0] * parse_unit_factor("time", units.get("time", "s"), str(path))
    check_time_grid(time, str(path))
    file_units = {units.get(column, unit) for column in columns}
    if len(file_units) != 1:
        raise FileError(f"columns in different units, {sorted(file_units)}.", where=str(path), remedy="Use one unit.")
    return time, table[:, 1:] * parse_unit_factor(quantity, file_units.pop(), str(path))


def _parse_stroke_name(path: Path) -> tuple[float, float, float]:
    """Return direction [rad], speed [m/s] and force [N] from the file's name."""
    match = _NAME.fullmatch(path.stem)
    if match is None:
        raise FileError("its name does not give direction, speed and force.", where=str(path),
                        remedy="Expected <id>_<direction>_<speed>_<force>_<repetition>.csv.")  # fmt: skip
    return float(np.radians(float(match[2]))), 1e-3 * float(match[3]), 1e-3 * float(match[4])
