"""u(t): what the hand does, at the action rate.

What an even grid can hold of a table of any grid: no vibration between its rows folds to a tone.

An action from a table: the CSV that `hnf synth --action` reads.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..errors import FileError, StrokeError

ACTION_RATE_HZ = 200.0
"""An artist's stroke has nothing above about 20 Hz; the field is evaluated at this rate and interpolated."""

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Action:
    """u(t) = [direction, speed, normal force] on an even time grid that starts at 0.

    rate: samples per second. direction: (n, 2) unit vectors (cos d, sin d) in the tangent frame of the touched
    patch; where the hand rests, the last direction is kept. speed: (n,) m/s ≥ 0. force: (n,) N ≥ 0.
    position: (n,) m, signed place along the path (arc length; runs backward when the stroke does).
    contact: (n,) bool, False where F_z = 0 or the path is off the surface. probe: name in probe.PROBES.
    """

    rate: float
    direction: Float
    speed: Float
    force: Float
    position: Float
    contact: NDArray[np.bool_]
    probe: str = "pen"

    @property
    def time(self) -> Float:
        return np.arange(len(self.speed)) / self.rate

    @property
    def duration_s(self) -> float:
        return (len(self.speed) - 1) / self.rate


CELLS_PER_SAMPLE = 16
"""Averages per sample of the grid that the Gaussian is summed over. An average knows every row in its cell, so neither
time nor memory follows the finest step of a table."""
_SUPPORT_SIGMAS = 4.0
_STEP_NEIGHBOURHOOD = 2.0
"""Samples of the grid on either side of one that say how fine the table is there: about as far as the Gaussian."""
_SUPPORT_SAMPLES = 4.0
"""Samples of the grid that no average or Gaussian looks beyond."""
_SAMPLES_PER_CHUNK = 1024


def resample_band_limited(values: Float, time: Float, count: int, rate: float) -> Float:
    """(count, k) of values (n, k) at times (n,) [s], ascending, on a grid of `rate` Hz that begins with them.

    Straight lines between rows; where the table is finer than half a step of the grid, averaged under a Gaussian that
    is −3 dB at a quarter of the rate and −27 dB at three. Beyond its ends a table goes on as it began and ended.
    """
    place = time[0] + np.arange(count) / rate
    out = np.stack([np.interp(place, time, column) for column in values.T], axis=1)
    if np.diff(time).min() > 0.5 / rate:
        return out
    since, reach = time - time[0], _SUPPORT_SAMPLES / rate
    for low in range(0, count, _SAMPLES_PER_CHUNK):
        samples = np.arange(low, min(low + _SAMPLES_PER_CHUNK, count)) / rate
        about = _find_rows(since, samples[0] - reach, samples[-1] + reach)
        fine = _compute_mean_step(since[about], samples, rate) <= 0.5 / rate
        if fine.any():
            out[low : low + _SAMPLES_PER_CHUNK][fine] = _average_gaussian(
                values[about], since[about], low, len(samples), rate
            )[fine]
    return out


def _find_rows(time: Float, first: float, last: float) -> slice:
    """The rows that say what is between two times, one beyond each where there is one."""
    low, high = np.searchsorted(time, (first, last))
    return slice(max(int(low) - 1, 0), int(high) + 1)


def _compute_mean_step(time: Float, at: Float, rate: float) -> Float:
    """Mean step [s] of the rows about each place: one narrow pair among wide ones does not make a table fine."""
    low = np.maximum(at - _STEP_NEIGHBOURHOOD / rate, time[0])
    high = np.minimum(at + _STEP_NEIGHBOURHOOD / rate, time[-1])
    row = np.arange(len(time), dtype=np.float64)
    return np.asarray((high - low) / np.maximum(np.interp(high, time, row) - np.interp(low, time, row), 1e-300))


def _average_gaussian(values: Float, time: Float, first: int, count: int, rate: float) -> Float:
    """(count, k) under the Gaussian, from sample `first` of the grid on; times begin with 0."""
    cell = 1.0 / (rate * CELLS_PER_SAMPLE)
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * 0.25 * rate)
    reach = int(np.ceil(_SUPPORT_SIGMAS * sigma / cell))
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) * cell / sigma))
    middles = np.arange(first * CELLS_PER_SAMPLE - reach, (first + count - 1) * CELLS_PER_SAMPLE + reach + 1)
    cells = _compute_cell_means(values, time, (np.append(middles, middles[-1] + 1) - 0.5) * cell)
    return np.asarray(sliding_window_view(cells, len(weights), axis=0)[::CELLS_PER_SAMPLE] @ (weights / weights.sum()))


def _compute_cell_means(values: Float, time: Float, edges: Float) -> Float:
    """(m, k) of the straight lines between rows, in each of m cells between edges (m + 1,): exact, and with nothing
    subtracted that is nearly equal."""
    inside = time[slice(*np.searchsorted(time, (edges[0], edges[-1])))]
    knots = np.sort(np.concatenate([edges, inside]), kind="stable")
    width, starts = np.diff(knots), np.searchsorted(knots, edges[:-1])
    spans = np.add.reduceat(width, starts)
    means = np.empty((len(edges) - 1, values.shape[1]))
    for column, series in enumerate(values.T):
        at = np.interp(knots, time, series)
        means[:, column] = np.add.reduceat(0.5 * width * (at[1:] + at[:-1]), starts) / spans
    return means


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
