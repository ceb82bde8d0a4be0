"""An action from a table: the CSV that `hnf synth --action` reads."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, StrokeError
from .action import ACTION_RATE_HZ, Action
from .band_limited import resample_band_limited

Float = NDArray[np.float64]

CSV_COLUMNS = ("time_s", "direction_rad", "speed_m_s", "force_n")
MAX_ACTION_S = 86_400.0
"""Whoever asks for more has another unit in mind: ten seconds in microseconds would be four months."""
MAX_TURNS, MAX_STEP_S = 2.0, 1.5
"""Beyond them a table is read as it is, and doubted: a hand turns and changes its mind in less."""
_CSV_REMEDY = f"Give the header {','.join(CSV_COLUMNS)} and one row of four numbers per time."


def read_action_csv(
    path: Path, probe: str = "pen", rate: float = ACTION_RATE_HZ, *, warn: Callable[[str], None] = lambda _: None
) -> Action:
    """Read a CSV with the columns time_s, direction_rad, speed_m_s, force_n (any order, any rising time grid).

    warn: is told in words what looks like a number of another unit; it is read as it is. Raises FileError where it
    cannot be read or is no such table, StrokeError where its values make no action.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header, table, lines = _read_table(path, stream)
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"not a CSV table ({error}).", where=str(path), remedy=_CSV_REMEDY) from error
    columns = [table[:, header.index(name)] for name in CSV_COLUMNS]
    action = action_from_table(*columns, probe=probe, rate=rate, where=str(path), lines=lines)
    for doubt in check_units(*columns[:2]):
        warn(f"{path.name}: {doubt}")
    return action


def check_units(time: Float, direction: Float) -> tuple[str, ...]:
    """In words, what of a table's times and directions (n,) is hardly in seconds and radians."""
    doubts = []
    widest, step = float(np.max(np.abs(direction))), float(np.median(np.diff(time)))
    if widest > MAX_TURNS * 2.0 * np.pi:
        doubts.append(f"direction_rad reaches {widest:.4g}, more than {MAX_TURNS:g} turns: is it in degrees?")
    if len(time) > 2 and step > MAX_STEP_S:
        doubts.append(f"time_s steps by {step:.4g} s from row to row: is it in milliseconds?")
    return tuple(doubts)


def action_from_table(
    time: Float, direction: Float, speed: Float, force: Float, *, probe: str = "pen", rate: float = ACTION_RATE_HZ,
    where: str = "action", lines: Sequence[int] = (),
) -> Action:  # fmt: skip
    """Columns (n,) on any rising time grid [s, rad, m/s, N] → Action on an even one.

    Direction is interpolated as a vector (179° and −179° are neighbours); where it vanishes, the nearest row's counts.
    Position is the integral of speed over the table's own grid. Contact is where force is above zero. Of a table finer
    than the action, what the action cannot hold is taken out first: a vibration in it would fold to a tone. where,
    lines: the table and its rows (n,) as messages name them; without lines they are rows 1, 2 and so on. Raises
    StrokeError for columns of different lengths or of fewer than two rows, a grid that does not rise, spans less than
    5 ms or more than a day, values that are not finite, or negative speed or force.
    """
    if not time.shape == direction.shape == speed.shape == force.shape or time.ndim != 1:
        shapes = ", ".join(str(column.shape) for column in (time, direction, speed, force))
        raise StrokeError(f"its columns have shapes {shapes}.", where=where, remedy="Give four columns of one length.")
    if len(time) < 2:
        raise StrokeError("fewer than two rows.", where=where, remedy=_CSV_REMEDY)
    columns = np.stack([time, direction, speed, force]).astype(np.float64)
    if not np.isfinite(columns).all():
        row = _format_row(int(np.argmin(np.isfinite(columns).all(axis=0))), lines)
        raise StrokeError(f"{row} holds a value that is not finite.", where=where, remedy="Remove or repair it.")
    if np.any(np.diff(time) <= 0.0):
        row = _format_row(int(np.argmax(np.diff(time) <= 0.0)) + 1, lines)
        raise StrokeError(f"time does not rise at {row}.", where=where, remedy="Sort the rows by time_s.")
    if speed.min() < 0.0 or force.min() < 0.0:
        raise StrokeError(
            "speed and force must not be negative.", where=where, remedy="Turn the direction by π to go backward."
        )
    duration = float(time[-1] - time[0])
    if duration > MAX_ACTION_S:
        raise StrokeError(
            f"it lasts {duration:.4g} s, and {MAX_ACTION_S:g} s (a day) is the most.",
            where=where, remedy="Give time_s in seconds, or cut the table.",
        )  # fmt: skip
    count = int(np.floor(duration * rate + 1e-6)) + 1
    if count < 2:
        raise StrokeError(
            f"it lasts {duration:.3g} s, and 0.005 s is the least.", where=where, remedy="Give a longer time span."
        )
    place = time[0] + np.arange(count) / rate
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    vector = resample_band_limited(np.stack([np.cos(direction), np.sin(direction)], axis=1), time, count, rate)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    nearest = direction[np.searchsorted(time, place).clip(0, len(time) - 1)]
    kept = np.stack([np.cos(nearest), np.sin(nearest)], axis=1)
    contact = np.interp(place, time, force) > 0.0
    slow = resample_band_limited(np.stack([speed, force], axis=1), time, count, rate)
    return Action(
        rate=rate,
        direction=np.where(length > 1e-6, vector / np.maximum(length, 1e-6), kept),
        speed=slow[:, 0],
        force=np.where(contact, slow[:, 1], 0.0),
        position=_integrate_speed(place, time, speed, travelled),
        contact=contact,
        probe=probe,
    )


def _format_row(row: int, lines: Sequence[int]) -> str:
    """A row, counted from 0, as a message names it: its line in the file, or its number where there is none."""
    return f"line {lines[row]}" if lines else f"row {row + 1}"


def _read_table(path: Path, stream: Iterable[str]) -> tuple[list[str], Float, Sequence[int]]:
    """Header, (n, columns) numbers and the n lines of the file that they stand in; a row of text is held no longer than
    it takes to read it."""
    rows = csv.reader(stream)
    filled = (row for row in rows if any(cell.strip() for cell in row))
    header = [cell.strip() for cell in next(filled, [])]
    for name in CSV_COLUMNS:
        if header.count(name) != 1:
            fault = f"column {name} is missing" if name not in header else f"there are two columns {name}"
            raise FileError(f"{fault}.", where=str(path), remedy=_CSV_REMEDY)
    numbers, lines = array("d"), array("q")
    for row in filled:
        numbers.extend(_parse_row(path, rows.line_num, row, header))
        lines.append(rows.line_num)
    return header, np.array(numbers, dtype=np.float64).reshape(-1, len(header)), lines


def _integrate_speed(at: Float, time: Float, speed: Float, travelled: Float) -> Float:
    """∫ speed dt with speed linear between rows: exact, also between them."""
    row = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    dt = at - time[row]
    share = dt / (time[row + 1] - time[row])
    return np.asarray(travelled[row] + dt * (speed[row] + 0.5 * share * (speed[row + 1] - speed[row])))


def _parse_row(path: Path, number: int, row: list[str], header: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError as error:
        raise FileError(f"line {number}: {error}.", where=str(path), remedy=_CSV_REMEDY) from error
    if len(values) != len(header):
        raise FileError(
            f"line {number} has {len(values)} cells, the header {len(header)}.", where=str(path), remedy=_CSV_REMEDY
        )
    return values
