"""The action u(t) = [direction, speed, normal force] at the action rate (200 Hz), and its CSV tables.

Tables may have any rising time grid. A table finer than the action rate is low-passed first, so that a vibration
between its rows does not alias to a tone.
"""

from __future__ import annotations

import csv
import io
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..errors import FileError, StrokeError
from ..files import write_text
from ..tables import MAX_FILE_BYTES, decode_text, parse_columns

ACTION_RATE_HZ = 200.0
"""Rate at which the field is evaluated and then interpolated [Hz]; an artist's stroke has nothing above about 20 Hz."""

Float = NDArray[np.float64]

SHORTEST_STEP_S = 1e-9
"""Step of a force curve below which slopes are not distinguished [s]."""


@dataclass(frozen=True)
class ForceCurve:
    """Pressing force on a time grid of its own: monotone and smooth between its points, constant beyond them.

    Cubic Hermite pieces whose slopes are those of F. N. Fritsch & J. Butland (1984, SIAM J. Sci. Stat. Comput. 5): it
    passes through all points without overshoot, and without the kinks of straight lines, which a hard contact would
    answer.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Rising times [s].
    force_n : ndarray, shape (m,)
        Force ≥ 0, 0 out of contact [N].
    """

    time_s: Float
    force_n: Float

    def evaluate(self, time_s: Float) -> Float:
        """Return the force at times (k,) [N]."""
        if len(self.time_s) < 2:
            return np.full(np.shape(time_s), self.force_n[0])
        left = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2)
        step, low, high = self.time_s[left + 1] - self.time_s[left], self.force_n[left], self.force_n[left + 1]
        t = np.clip(time_s - self.time_s[left], 0.0, step) / step
        rest = 1.0 - t
        force = low * (1.0 + 2.0 * t) * rest**2 + high * (3.0 - 2.0 * t) * t**2
        force += step * t * rest * (self._slopes[left] * rest - self._slopes[left + 1] * t)
        return np.asarray(np.clip(force, np.minimum(low, high), np.maximum(low, high)))

    @cached_property
    def _slopes(self) -> Float:
        """Slope at each point [N/s]: 0 at both ends and where the force turns, else a harmonic mean of both chords."""
        step = np.maximum(np.diff(self.time_s), SHORTEST_STEP_S)
        chord, slopes = np.diff(self.force_n) / step, np.zeros(len(self.time_s))
        inner = np.flatnonzero(np.sign(chord[:-1]) * np.sign(chord[1:]) > 0.0)
        before, after = step[inner], step[inner + 1]
        near, far = 2.0 * after + before, after + 2.0 * before
        with np.errstate(over="ignore"):  # A chord of nearly 0 makes the slope 0.
            slopes[inner + 1] = (near + far) / (near / chord[inner] + far / chord[inner + 1])
        return slopes

    def find_extremes(self, edges_s: Float) -> tuple[Float, Float]:
        """Return the lowest and highest force (k − 1,) between each two of k ≥ 2 rising times [N]."""
        inside = slice(*np.searchsorted(self.time_s, (edges_s[0], edges_s[-1])))
        order_time = np.concatenate([edges_s, self.time_s[inside]])
        force = np.concatenate([self.evaluate(edges_s), self.force_n[inside]])[np.argsort(order_time, kind="stable")]
        starts, ends = np.searchsorted(np.sort(order_time), edges_s)[:-1], self.evaluate(edges_s[1:])
        count = int(np.searchsorted(np.sort(order_time), edges_s[-1]))
        return (
            np.minimum(np.minimum.reduceat(force[:count], starts), ends),
            np.maximum(np.maximum.reduceat(force[:count], starts), ends),
        )

    def touches_near(self, grid_s: Float) -> NDArray[np.bool_]:
        """Return (k,) whether the force is above 0 anywhere within half a step of each time of an even grid."""
        if len(grid_s) < 2:
            return self.evaluate(grid_s) > 0.0
        half = 0.5 * (grid_s[1] - grid_s[0])
        return np.asarray(self.find_extremes(np.append(grid_s - half, grid_s[-1] + half))[1] > 0.0)


@dataclass(frozen=True)
class Action:
    """u(t) = [direction, speed, normal force] on an even time grid that starts at 0.

    Attributes
    ----------
    rate : float
        Samples per second [Hz].
    direction : ndarray, shape (n, 2)
        Unit vectors (cos d, sin d) in the tangent frame of the touched patch; at rest, the last direction.
    speed : ndarray, shape (n,)
        Speed ≥ 0 [m/s].
    force : ndarray, shape (n,)
        Pressing force along the surface normal, ≥ 0 [N].
    position : ndarray, shape (n,)
        Signed arc length along the path [m]; falls when the stroke runs backward.
    contact : ndarray of bool, shape (n,)
        False where the force is 0 or the path is off the surface.
    probe : str
        Name or file of the probe, see `material.probe.get_probe`.
    force_curve : ForceCurve or None
        The force as it was given, if that is on a finer grid: a tap of 3 ms lies between two samples of `force`.
    """

    rate: float
    direction: Float
    speed: Float
    force: Float
    position: Float
    contact: NDArray[np.bool_]
    probe: str = "pen"
    force_curve: ForceCurve | None = None

    @property
    def time(self) -> Float:
        """Times of the samples [s]."""
        return np.arange(len(self.speed)) / self.rate

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self.speed) - 1) / self.rate


FINE_STEP = 0.999
"""Step of a table below which it is finer than the action's grid [grid steps]."""
CELLS_PER_SAMPLE = 16
"""Number of averages per grid sample that the Gaussian is summed over. An average includes all rows in its cell, so
that time and memory do not depend on the finest step of a table."""
_SUPPORT_SIGMAS = 4.0
_STEP_NEIGHBOURHOOD = 2.0
"""Range on either side of a sample in which the table's step is measured, about that of the Gaussian [grid samples]."""
_SUPPORT_SAMPLES = 4.0
"""Range that no average or Gaussian exceeds [grid samples]."""
_SAMPLES_PER_CHUNK = 1024


def resample_band_limited(values: Float, time: Float, count: int, rate: float) -> Float:
    """Resample a table to an even time grid that starts with its first row, without aliasing.

    Linear between rows. Where the table's rows are closer than half a grid step, it is smoothed by a Gaussian whose
    response is −3 dB at a quarter of the grid's rate and −27 dB at three quarters. Beyond its ends the end values
    continue.

    Parameters
    ----------
    values : ndarray, shape (n, k)
        Values of the table.
    time : ndarray, shape (n,)
        Rising times [s].
    count : int
        Number of grid samples.
    rate : float
        Rate of the grid [Hz].

    Returns
    -------
    ndarray, shape (count, k)
        Values on the grid.
    """
    grid = time[0] + np.arange(count) / rate
    resampled = np.stack([np.interp(grid, time, column) for column in values.T], axis=1)
    if np.diff(time).min() > 0.5 / rate:
        return resampled
    relative_time, reach = time - time[0], _SUPPORT_SAMPLES / rate
    for start in range(0, count, _SAMPLES_PER_CHUNK):
        samples = np.arange(start, min(start + _SAMPLES_PER_CHUNK, count)) / rate
        rows = _find_rows(relative_time, samples[0] - reach, samples[-1] + reach)
        is_fine = _compute_mean_step(relative_time[rows], samples, rate) <= 0.5 / rate
        if is_fine.any():
            resampled[start : start + _SAMPLES_PER_CHUNK][is_fine] = _average_gaussian(
                values[rows], relative_time[rows], start, len(samples), rate
            )[is_fine]
    return resampled


def _find_rows(time: Float, first: float, last: float) -> slice:
    """Return the slice of table rows needed between two times [s], with one row beyond each end if there is one."""
    low, high = np.searchsorted(time, (first, last))
    return slice(max(int(low) - 1, 0), int(high) + 1)


def _compute_mean_step(time: Float, at: Float, rate: float) -> Float:
    """Return the mean time step [s] of the table's rows around each time `at`.

    A mean, because a single pair of close rows does not call for smoothing.
    """
    low = np.maximum(at - _STEP_NEIGHBOURHOOD / rate, time[0])
    high = np.minimum(at + _STEP_NEIGHBOURHOOD / rate, time[-1])
    row = np.arange(len(time), dtype=np.float64)
    return np.asarray((high - low) / np.maximum(np.interp(high, time, row) - np.interp(low, time, row), 1e-300))


def _average_gaussian(values: Float, time: Float, first: int, count: int, rate: float) -> Float:
    """Return a table's values (count, k) smoothed by the anti-aliasing Gaussian, from grid sample `first` on."""
    cell = 1.0 / (rate * CELLS_PER_SAMPLE)
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * 0.25 * rate)
    reach = int(np.ceil(_SUPPORT_SIGMAS * sigma / cell))
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) * cell / sigma))
    cell_indices = np.arange(first * CELLS_PER_SAMPLE - reach, (first + count - 1) * CELLS_PER_SAMPLE + reach + 1)
    cells = _compute_cell_means(values, time, (np.append(cell_indices, cell_indices[-1] + 1) - 0.5) * cell)
    return np.asarray(sliding_window_view(cells, len(weights), axis=0)[::CELLS_PER_SAMPLE] @ (weights / weights.sum()))


def _compute_cell_means(values: Float, time: Float, edges: Float) -> Float:
    """Return exact means (m, k) of a linearly interpolated table over m time intervals with edges (m + 1,).

    Computed without subtracting nearly equal integrals, which would lose digits.
    """
    inside = time[slice(*np.searchsorted(time, (edges[0], edges[-1])))]
    knots = np.sort(np.concatenate([edges, inside]), kind="stable")
    width, starts = np.diff(knots), np.searchsorted(knots, edges[:-1])
    spans = np.add.reduceat(width, starts)
    means = np.empty((len(edges) - 1, values.shape[1]))
    for column, series in enumerate(values.T):
        knot_values = np.interp(knots, time, series)
        means[:, column] = np.add.reduceat(0.5 * width * (knot_values[1:] + knot_values[:-1]), starts) / spans
    return means


CSV_COLUMNS = ("time_s", "direction_rad", "speed_m_s", "force_n")
"""Columns of a table."""
POSITION_COLUMN = "position_m"
"""Column that a table may have besides: the signed arc length, which falls where the hand goes back."""
MAX_HEADER_LENGTH = 2**16
MAX_FORCE_NOISE_N, MAX_FORCE_NOISE_SHARE = 0.05, 0.02
"""Force below 0 that a load cell's noise explains [N], and as a share of the table's largest force."""
MAX_ACTION_S = 86_400.0
"""Longest accepted action [s]; a longer one has another unit, as ten seconds in microseconds would be four months."""
MAX_TURNS, MAX_STEP_S = 2.0, 1.5
"""Limits of direction [turns] and of the median time step [s] beyond which a table's units are doubted."""
MAX_HAND_SPEED_M_S = 5.0
"""Speed beyond which a table's unit is doubted [m/s]."""
WAY_DIFFERENCE, LEAST_WAY_M = 0.05, 1e-3
"""Relative and absolute [m] difference of the ways by speed and by position from which a table contradicts itself."""
_CSV_REMEDY = f"Give the header {','.join(CSV_COLUMNS)} and one row of four numbers per time."


def read_action_csv(
    path: Path, probe: str = "pen", rate: float = ACTION_RATE_HZ, *, warn: Callable[[str], None] = lambda _: None
) -> Action:
    """Read an action from a CSV table.

    Parameters
    ----------
    path : Path
        Table with the columns time_s, direction_rad, speed_m_s and force_n, in any order, on any rising time grid; and
        position_m if it is not the integral of speed.
    probe : str
        Contacting tip.
    rate : float
        Rate of the action [Hz].
    warn : callable
        Called with a message for values that seem to have another unit; they are read as they are.

    Returns
    -------
    Action
        The action.

    Raises
    ------
    FileError
        If the file cannot be read or is no such table.
    StrokeError
        If its values make no action.
    """
    table = read_action_table(path, warn)
    action = action_from_table(
        table.time, table.direction, table.speed, table.force, position=table.position, probe=probe, rate=rate,
        where=str(path), lines=table.lines,
    )  # fmt: skip
    for message in check_plausibility(table.time, table.direction, table.speed, table.position):
        warn(f"{path.name}: {message}")
    return action


@dataclass(frozen=True)
class ActionTable:
    """Columns (n,) of a table of an action, on its own time grid.

    time, direction, speed, force: [s, rad, m/s, N]. position: signed arc length [m]; None if the table has none. lines:
    line numbers of the rows in the file, for messages; may be empty.
    """

    time: Float
    direction: Float
    speed: Float
    force: Float
    position: Float | None
    lines: Sequence[int]


def read_action_table(path: Path, warn: Callable[[str], None]) -> ActionTable:
    """Read the columns of a table as `read_action_csv` does, but keep its own rows.

    warn: called with a message if forces below 0 are taken for noise. Raises FileError.
    """
    lines: Sequence[int] = ()
    try:
        with path.open("rb") as file:
            stream = file if file.seekable() else io.BytesIO(file.read())  # a pipe gives its text once
            first = stream.readline(MAX_HEADER_LENGTH).decode("utf-8-sig", errors="replace")
            stream.seek(0)
            if not {cell.strip() for cell in first.split(",")}.issuperset(CSV_COLUMNS):
                header, table = _read_own_table(path, decode_text(stream.read(MAX_FILE_BYTES + 1), str(path)))
            else:
                text = io.TextIOWrapper(stream, encoding="utf-8-sig", newline="")
                header, table, lines = _read_table(path, text)
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"not a CSV table ({error}).", where=str(path), remedy=_CSV_REMEDY) from error
    force = table[:, header.index("force_n")]
    is_noise = (force < 0.0) & (
        force >= -max(MAX_FORCE_NOISE_N, MAX_FORCE_NOISE_SHARE * float(np.max(force, initial=0.0)))
    )
    if is_noise.any():
        warn(f"{path.name}: {int(is_noise.sum())} forces below 0 are taken for the sensor's noise, and for 0.")
        force[is_noise] = 0.0
    time, direction, speed, force = (table[:, header.index(name)] for name in CSV_COLUMNS)
    position = table[:, header.index(POSITION_COLUMN)] if POSITION_COLUMN in header else None
    return ActionTable(time, direction, speed, force, position, lines)


def check_plausibility(time: Float, direction: Float, speed: Float, position: Float | None = None) -> tuple[str, ...]:
    """Return messages about columns (n,) [s, rad, m/s, m] that are hardly in these units, or contradict each other."""
    messages = []
    widest, step = float(np.max(np.abs(direction))), float(np.median(np.diff(time)))
    if widest > MAX_TURNS * 2.0 * np.pi:
        messages.append(f"direction_rad reaches {widest:.4g}, more than {MAX_TURNS:g} turns: is it in degrees?")
    if len(time) > 2 and step > MAX_STEP_S:
        messages.append(f"time_s steps by {step:.4g} s from row to row: is it in milliseconds?")
    fastest = float(np.max(np.abs(speed)))
    if fastest > MAX_HAND_SPEED_M_S:
        messages.append(f"speed_m_s reaches {fastest:.4g}, and no hand is so fast: is it in mm/s?")
    if position is not None and len(time) > 1:
        way = float(np.sum(0.5 * np.abs(speed[1:] + speed[:-1]) * np.diff(time)))
        moved = float(np.abs(np.diff(position)).sum())
        if abs(way - moved) > WAY_DIFFERENCE * max(way, moved) + LEAST_WAY_M:
            messages.append(
                f"position_m moves by {moved:.4g} m, and speed_m_s comes to {way:.4g} m. Relief and tones follow "
                "position_m: leave it out if the speed was changed."
            )
    return tuple(messages)


def action_from_table(
    time: Float, direction: Float, speed: Float, force: Float, *, position: Float | None = None, probe: str = "pen",
    rate: float = ACTION_RATE_HZ, where: str = "action", lines: Sequence[int] = (),
) -> Action:  # fmt: skip
    """Make an action from columns (n,) on any rising time grid.

    Direction is interpolated as a vector (179° and −179° are neighbors); where that vanishes, the next row counts.
    Position is the integral of speed over the table's own grid. There is contact where the force is positive. A table
    finer than the action is low-passed first (`resample_band_limited`), and its own force goes along as the action's
    `force_curve`; there is contact where it presses within half a step of the grid.

    Parameters
    ----------
    time, direction, speed, force : ndarray, shape (n,)
        Columns [s, rad, m/s, N].
    position : ndarray, shape (n,), or None
        Signed arc length [m]; None for the integral of speed.
    probe : str
        Contacting tip.
    rate : float
        Rate of the action [Hz].
    where : str
        Name of the table in messages.
    lines : sequence of int
        Line numbers of the rows in messages; rows are counted from 1 without them.

    Returns
    -------
    Action
        The action.

    Raises
    ------
    StrokeError
        For columns of different lengths or fewer than two rows, times that do not rise, durations below 5 ms or above a
        day, values that are not finite, or negative speed or force.
    """
    if not time.shape == direction.shape == speed.shape == force.shape or time.ndim != 1:
        shapes = ", ".join(str(column.shape) for column in (time, direction, speed, force))
        raise StrokeError(f"its columns have shapes {shapes}.", where=where, remedy="Give four columns of one length.")
    if len(time) < 2:
        raise StrokeError("fewer than two rows.", where=where, remedy=_CSV_REMEDY)
    columns = np.stack([time, direction, speed, force, force if position is None else position]).astype(np.float64)
    if not np.isfinite(columns).all():
        row = _format_row(int(np.argmin(np.isfinite(columns).all(axis=0))), lines)
        raise StrokeError(f"{row} holds a value that is not finite.", where=where, remedy="Remove or repair it.")
    if np.any(np.diff(time) <= 0.0):
        row = _format_row(int(np.argmax(np.diff(time) <= 0.0)) + 1, lines)
        raise StrokeError(f"time does not rise at {row}.", where=where, remedy="Sort the rows by time_s.")
    if speed.min() < 0.0:
        row = _format_row(int(np.argmax(speed < 0.0)), lines)
        raise StrokeError(
            f"the speed at {row} is negative.", where=where, remedy="Turn the direction by π to go backward."
        )
    if force.min() < 0.0:
        row = _format_row(int(np.argmax(force < 0.0)), lines)
        raise StrokeError(
            f"the force at {row} is negative.", where=where,
            remedy="Give the force with which the probe presses, 0 where it does not touch.",
        )  # fmt: skip
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
    grid = time[0] + np.arange(count) / rate
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    vector = resample_band_limited(np.stack([np.cos(direction), np.sin(direction)], axis=1), time, count, rate)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    nearest = direction[np.searchsorted(time, grid).clip(0, len(time) - 1)]
    nearest_vector = np.stack([np.cos(nearest), np.sin(nearest)], axis=1)
    curve = ForceCurve(time - time[0], columns[3]) if np.diff(time).min() < FINE_STEP / rate else None
    contact = np.interp(grid, time, force) > 0.0 if curve is None else curve.touches_near(grid - time[0])
    resampled = resample_band_limited(np.stack([speed, force], axis=1), time, count, rate)
    return Action(
        rate=rate,
        direction=np.where(length > 1e-6, vector / np.maximum(length, 1e-6), nearest_vector),
        speed=resampled[:, 0],
        force=np.where(contact, resampled[:, 1], 0.0),
        position=_integrate_speed(grid, time, speed, distance) if position is None else np.interp(grid, time, position),
        contact=contact,
        probe=probe,
        force_curve=curve,
    )


def write_action_csv(path: Path, action: Action) -> None:
    """Write an action as a table that `read_action_csv` reads back to the last digits, at its own rate.

    The force is that of its states: a `force_curve` that is finer than they are is not written.
    """
    angle = np.arctan2(action.direction[:, 1], action.direction[:, 0])
    force = np.where(action.contact, action.force, 0.0)
    rows = zip(*(column.tolist() for column in (action.time, angle, action.speed, force, action.position)), strict=True)
    lines = (",".join(repr(value + 0.0) for value in row) for row in rows)
    write_text(path, "\n".join([",".join([*CSV_COLUMNS, POSITION_COLUMN]), *lines, ""]))


def _format_row(row: int, lines: Sequence[int]) -> str:
    """Format a row, counted from 0, for a message: its line in the file, or its number if there is none."""
    return f"line {lines[row]}" if lines else f"row {row + 1}"


def _read_table(path: Path, stream: Iterable[str]) -> tuple[list[str], Float, Sequence[int]]:
    """Return the header, numbers (n, columns) and line numbers of the n rows; text is not kept in memory."""
    rows = csv.reader(stream)
    nonblank = (row for row in rows if any(cell.strip() for cell in row))
    header = [cell.strip() for cell in next(nonblank, [])]
    for name in CSV_COLUMNS:
        if header.count(name) != 1:
            fault = f"column {name} is missing" if name not in header else f"there are two columns {name}"
            raise FileError(f"{fault}.", where=str(path), remedy=_CSV_REMEDY)
    numbers, lines = array("d"), array("q")
    for row in nonblank:
        numbers.extend(_parse_row(path, rows.line_num, row, header))
        lines.append(rows.line_num)
    return header, np.array(numbers, dtype=np.float64).reshape(-1, len(header)), lines


_ALIASES = {"t": "time", "angle": "direction", "velocity": "speed", "load": "force", "fz": "force", "fn": "force"}


def _read_own_table(path: Path, text: str) -> tuple[list[str], Float]:
    """Return header and numbers of a table whose header is not exactly ours, in our columns and SI units.

    Names may have another case or unit, and be separated by semicolons or tabs. Positions x and y give direction and
    speed where those lack.
    """
    wanted = ("time", "direction", "speed", "force", "position", "x", "y")
    columns, missing = parse_columns(text, wanted, _ALIASES, str(path))
    if {"x", "y"} <= columns.keys() and {"direction", "speed"} & set(missing) and "time" in columns:
        time = columns["time"]
        if len(time) > 1 and np.all(np.diff(time) > 0.0):
            dx, dy = np.gradient(columns["x"], time), np.gradient(columns["y"], time)
            columns.setdefault("direction", np.arctan2(dy, dx))
            columns.setdefault("speed", np.hypot(dx, dy))
    names = dict(zip(("time", "direction", "speed", "force"), CSV_COLUMNS, strict=True)) | {"position": POSITION_COLUMN}
    for name, title in names.items():
        if name not in columns and title != POSITION_COLUMN:
            found = f"; there are {', '.join(sorted(columns))}" if columns else ""
            raise FileError(f"column {title} is missing{found}.", where=str(path), remedy=_CSV_REMEDY)
    header = [title for name, title in names.items() if name in columns]
    return header, np.stack([columns[name] for name in names if name in columns], axis=1)


def _integrate_speed(at: Float, time: Float, speed: Float, travelled: Float) -> Float:
    """Integrate a table's speed, linear between its rows, exactly up to times `at`.

    travelled: integral up to each row of the table.
    """
    row = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    dt = at - time[row]
    fraction = dt / (time[row + 1] - time[row])
    return np.asarray(travelled[row] + dt * (speed[row] + 0.5 * fraction * (speed[row + 1] - speed[row])))


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
