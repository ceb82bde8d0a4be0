"""Conversion of measured time series to a recording: acceleration at 10 kHz and an action at 200 Hz.

Series may have any rising time grid. Motion and force are low-passed at the bandwidth of a hand; a recording can also
give them raw, at the rate of its samples. A user's own recordings are a folder for each material with a CSV table for
each stroke, whose columns are identified by name, in any order and case, with their unit behind it: `speed [mm/s]`,
`speed (mm/s)` or `speed_mm_s`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import FileError, pluralize
from ..field.resampling import resample
from ..signal import dft321
from ..tables import parse_unit_factor, read_header, read_table
from .data_files import find_files
from .recording import ActionRange, DataSet, Recording, compute_action_range, match_name

Float = NDArray[np.float64]

SIGNAL_RATE_HZ = 10_000.0
"""Sample rate of recordings [Hz]."""
HAND_BANDWIDTH_HZ = 20.0
"""Bandwidth of a hand's motion [Hz]. Above it a force or speed sensor shows the vibration itself, and a field would
learn from an action that contains the signal."""
RAW_BANDWIDTH_HZ = 1000.0
"""Bandwidth of a raw action, that of the signal (Haptic Neural Fields, "Implementation")."""
REST_SPEED_M_S = 1e-3
"""Speed below which the last direction is kept [m/s], since a tracked position is mostly noise then."""
MIN_DURATION_S = 0.1
"""Shortest recording [s]."""
MIN_SAMPLING_HZ = 2000.0
"""Least sampling rate of an accelerometer [Hz]; a slower one does not cover the band of touch."""
LIMITED_SHARE = 0.99
"""Fraction of the signal's rate below which a sensor's rate limits what is known of the touch."""
LONG_GAP_S = 5e-3
"""Gap between samples of an acceleration that cuts a recording in two [s]."""
GAP_STEPS = 3.0
"""Interval between samples, relative to the median one, that is bridged by a straight line."""
RATE_ROUNDING = 1e-5
"""Relative deviation of a rate from an integer that rounded times explain."""
SMOOTHING_MARGIN_S = 0.2
"""Margin beyond the used part that smoothing includes [s]."""


def check_time_grid(time: Float, where: str) -> None:
    """Raise FileError unless times (n ≥ 4,) [s] rise by a nanosecond or more from sample to sample."""
    if len(time) < 4:
        raise FileError(f"only {len(time)} samples.", where=where, remedy="Record more.")
    not_rising = np.diff(time) < 1e-9
    if not_rising.any():
        row = int(np.argmax(not_rising)) + 2
        if np.all(np.diff(time) >= 0.0) and time[-1] > time[0]:
            raise FileError(
                f"its times are rounded, so that they are equal at sample {row}.",
                where=where,
                remedy="Write more decimals of the times.",
            )
        raise FileError(f"time does not rise at sample {row}.", where=where, remedy="Sort the rows by time.")


def measure_sampling_rate(time: Float, where: str) -> float:
    """Return the mean rate of an acceleration's grid between its long gaps [Hz]; raise FileError if too slow."""
    step = np.diff(time)
    within = step[step <= LONG_GAP_S]
    rate = len(within) / float(within.sum()) if len(within) else 1.0 / float(np.median(step))
    rate = float(round(rate)) if abs(rate - round(rate)) < RATE_ROUNDING * rate else rate
    if rate < MIN_SAMPLING_HZ:
        raise FileError(
            f"sampled {rate:.0f} times a second only.",
            where=where,
            remedy=f"{MIN_SAMPLING_HZ:g} Hz are the least. If it was sampled faster: is its time column in seconds?",
        )
    return rate


@dataclass(frozen=True)
class Piece:
    """Samples of an acceleration between two long gaps.

    rows: of the table. notes: what was cut, and what was left out.
    """

    rows: slice
    notes: tuple[str, ...]


def split_at_gaps(time: Float, where: str) -> list[Piece]:
    """Split times (n,) [s] at gaps longer than LONG_GAP_S, since nothing is known of the signal within them.

    Pieces shorter than MIN_DURATION_S are left out, and noted on the others. Raises FileError if none is left.
    """
    gaps = np.flatnonzero(np.diff(time) > LONG_GAP_S)
    edges = [0, *(gaps + 1).tolist(), len(time)]
    if not len(gaps):
        return [Piece(slice(0, len(time)), ())]
    pieces = [slice(low, high) for low, high in pairwise(edges) if time[high - 1] - time[low] >= MIN_DURATION_S]
    if not pieces:
        longest = max(float(time[high - 1] - time[low]) for low, high in pairwise(edges))
        raise FileError(
            f"gaps of more than {1e3 * LONG_GAP_S:g} ms cut it into pieces of {longest:.3f} s and less.",
            where=where,
            remedy=f"Record it again without holes; {MIN_DURATION_S:g} s are the least.",
        )
    widest = float(np.diff(time)[gaps].max())
    cut = f"cut at {pluralize(len(gaps), 'gap')} of up to {1e3 * widest:.0f} ms between samples"
    left_out = len(edges) - 1 - len(pieces)
    short = (f"left out: {pluralize(left_out, 'piece')} shorter than {MIN_DURATION_S:g} s",) if left_out else ()
    return [Piece(rows, (f"{cut}: piece {number} of {len(pieces)}", *short)) for number, rows in enumerate(pieces, 1)]


def interpolate_series(time: Float, values: Float, new_time: Float) -> Float:
    """Interpolate values (n,) or (n, k) on a rising grid at new times, by cubic Hermite polynomials.

    Slopes are those of parabolas through three samples; beyond the ends, values are constant. Intervals of more than
    GAP_STEPS times the median one are bridged by a straight line: a slope measured over one step and followed for many
    would lead far beyond both neighbours.
    """
    step = np.diff(time)
    is_gap = step > GAP_STEPS * np.median(step)
    step = step.reshape(-1, *[1] * (values.ndim - 1))
    secant = np.diff(values, axis=0) / step
    slope = np.concatenate(
        [secant[:1], (secant[:-1] * step[1:] + secant[1:] * step[:-1]) / (step[:-1] + step[1:]), secant[-1:]]
    )
    new_time = np.clip(new_time, time[0], time[-1])
    index = np.clip(np.searchsorted(time, new_time, side="right") - 1, 0, len(time) - 2)
    width = step[index]
    t = ((new_time - time[index]).reshape(width.shape)) / width
    difference = values[index + 1] - values[index]
    curvature = width * (slope[index] + slope[index + 1]) - 2.0 * difference
    curve = t * (width * slope[index] + t * (difference - width * slope[index] - curvature * (1.0 - t)))
    return np.asarray(values[index] + np.where(is_gap[index].reshape(width.shape), t * difference, curve))


def smooth_series(values: Float, rate: float, cutoff_hz: float = HAND_BANDWIDTH_HZ) -> Float:
    """Low-pass values (n,) or (n, k): Gaussian, −3 dB at `cutoff_hz`, no delay, ends mirrored at a point."""
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff_hz)
    pad = min(len(values) - 1, int(np.ceil(6.0 * sigma * rate)))
    first, last = values[:1], values[-1:]
    extended = np.concatenate([2 * first - values[pad:0:-1], values, 2 * last - values[-2 : -pad - 2 : -1]])
    gain = np.exp(-0.5 * np.square(2.0 * np.pi * sigma * np.fft.rfftfreq(len(extended), 1.0 / rate)))
    spectrum = np.fft.rfft(extended, axis=0) * gain.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.fft.irfft(spectrum, len(extended), axis=0)[pad : pad + len(values)])


def resample_to_action_rate(
    time: Float, values: Float, start: float, count: int, rate: float = ACTION_RATE_HZ
) -> Float:
    """Resample a measured quantity to the action rate, low-passed at `HAND_BANDWIDTH_HZ`.

    It is smoothed on a grid as fine as the measurement, so that its vibration does not alias. At a higher rate, that of
    a raw action, it is low-passed at `RAW_BANDWIDTH_HZ`.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times of the measurement [s].
    values : ndarray, shape (n,) or (n, k)
        The measurement.
    start : float
        Time of the first action sample [s].
    count : int
        Number of action samples.
    rate : float
        Rate of the action [Hz].

    Returns
    -------
    ndarray, shape (count,) or (count, k)
        The quantity at `rate`.
    """
    fine = max(rate, (len(time) - 1) / float(time[-1] - time[0]))
    first = max(float(time[0]), start - SMOOTHING_MARGIN_S)
    last = min(float(time[-1]), start + count / rate + SMOOTHING_MARGIN_S)
    grid = first + np.arange(int((last - first) * fine + 1e-6) + 1) / fine
    cutoff_hz = HAND_BANDWIDTH_HZ if rate == ACTION_RATE_HZ else RAW_BANDWIDTH_HZ
    smooth = smooth_series(interpolate_series(time, values, grid), fine, cutoff_hz)
    return interpolate_series(grid, smooth, start + np.arange(count) / rate)


def count_action_samples(duration_s: float, where: str) -> int:
    """Return the number of action samples in a duration; raise FileError below `MIN_DURATION_S`."""
    if not duration_s >= MIN_DURATION_S:
        raise FileError(
            f"all its signals together last {max(duration_s, 0.0):.3f} s only.",
            where=where,
            remedy=f"Record {MIN_DURATION_S:g} s or more; several files must belong to one stroke.",
        )
    return int(duration_s * ACTION_RATE_HZ + 1e-6) + 1


def build_action(direction: Float, speed: Float, force: Float, rate: float = ACTION_RATE_HZ) -> Action:
    """Build the pen's action from direction (n, 2), speed (n,) [m/s] and force (n,) [N] at a rate [Hz].

    Negative speed and force count as 0.
    """
    speed, force = np.maximum(speed, 0.0), np.maximum(force, 0.0)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / rate
    return Action(rate, direction, speed, force, position, force > 0.0)


def derive_motion(position: Float, rate: float = ACTION_RATE_HZ) -> tuple[Float, Float]:
    """Derive direction (n, 2) and speed (n,) [m/s] from positions (n, 2) [m] at a rate [Hz].

    At rest the last direction is kept; before the first motion the first one, without any motion +x.
    """
    velocity = np.gradient(position, 1.0 / rate, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > REST_SPEED_M_S)
    if len(moving) == 0:
        return constant_direction(len(position), 0.0), speed
    latest = moving[np.maximum(np.searchsorted(moving, np.arange(len(speed)), side="right") - 1, 0)]
    return velocity[latest] / speed[latest, None], speed


def constant_direction(count: int, angle_rad: float) -> Float:
    """Return one direction (count, 2) for all samples."""
    return np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))


DURATION_TOLERANCE = 0.02
"""Largest relative difference of the signals' durations."""


@dataclass(frozen=True)
class MeasuredSignal:
    """One measured quantity.

    Attributes
    ----------
    quantity : str
        acceleration, force, speed or position.
    axes : tuple of str
        Names of the axes, in the order x, y, z, or one.
    values : ndarray, shape (n, axes)
        Values in SI units.
    rate : float
        Sample rate [Hz].
    source : str
        File, for messages.
    notes : tuple of str
        Assumptions of the reader.
    """

    quantity: str
    axes: tuple[str, ...]
    values: Float
    rate: float
    source: str
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> Float:
        """Times of the samples [s]."""
        return np.arange(len(self.values)) / self.rate


def assemble_recording(signals: Sequence[MeasuredSignal], material: str, where: str) -> Recording:
    """Assemble the signals of one stroke to a recording.

    Missing quantities are assumed, and noted: direction +x, 0.1 m/s, 1 N.

    Parameters
    ----------
    signals : sequence of MeasuredSignal
        The signals.
    material : str
        Name of the material.
    where : str
        Source, for messages.

    Returns
    -------
    Recording
        The recording.

    Raises
    ------
    FileError
        Without acceleration, with a quantity twice, or if durations differ by more than 2 %.
    """
    by_name = {signal.quantity: signal for signal in signals}
    if len(by_name) != len(signals):
        raise FileError("a quantity stands in it twice.", where=where, remedy="Keep one file per quantity and stroke.")
    if "acceleration" not in by_name:
        raise FileError("there is no acceleration.", where=where, remedy="Give the Accel file of this stroke too.")
    durations = {name: len(signal.values) / signal.rate for name, signal in by_name.items()}
    shortest, longest = min(durations.values()), max(durations.values())
    if longest - shortest > DURATION_TOLERANCE * longest:
        listed = ", ".join(f"{name} {seconds:.3f} s" for name, seconds in sorted(durations.items()))
        raise FileError(f"its signals do not belong together: {listed}.", where=where, remedy="Get the file again.")
    count = count_action_samples(shortest, where)
    notes = [note for signal in signals for note in signal.notes]
    acceleration = by_name["acceleration"]
    samples = _resample_acceleration(acceleration, round((count - 1) * SIGNAL_RATE_HZ / ACTION_RATE_HZ), where)
    action, known = _resample_action(by_name, count, notes)
    return Recording(
        action, samples, SIGNAL_RATE_HZ, material, where, known, tuple(dict.fromkeys(notes)),
        partial(_resample_raw_action, by_name, len(samples) + 1) if known else None,
        acceleration.rate if acceleration.rate < LIMITED_SHARE * SIGNAL_RATE_HZ else None,
    )  # fmt: skip


def _resample_action(
    signals: dict[str, MeasuredSignal], count: int, notes: list[str], rate: float = ACTION_RATE_HZ
) -> tuple[Action, frozenset[str]]:
    """Return the action of `count` samples at a rate, and the names of its quantities that were recorded."""
    force, force_known = _resample_force(signals.get("force"), count, notes, rate)
    direction, speed, moving_known = _resample_motion(signals, count, notes, rate)
    return build_action(direction, speed, force, rate), frozenset(force_known + moving_known)


def _resample_raw_action(signals: dict[str, MeasuredSignal], count: int) -> Action:
    return _resample_action(signals, count, [], SIGNAL_RATE_HZ)[0]


def _resample_acceleration(acceleration: MeasuredSignal, count: int, where: str) -> Float:
    values = acceleration.values - acceleration.values.mean(axis=0)
    if values.shape[1] not in (1, 3):
        raise FileError(f"acceleration has {values.shape[1]} axes.", where=where, remedy="One or three are expected.")
    fused = dft321(values) if values.shape[1] == 3 else values[:, 0]
    # Band-limited both ways: nothing aliases into the touch band, and nothing is mirrored above a slow sensor's.
    return resample(fused, acceleration.rate, SIGNAL_RATE_HZ)[0][:count].copy()


def _resample_force(
    signal: MeasuredSignal | None, count: int, notes: list[str], rate: float
) -> tuple[Float, list[str]]:
    if signal is None:
        notes.append("no force was recorded: 1 N assumed")
        return np.ones(count), []
    normal = signal.values[:, -1]
    if signal.values.shape[1] > 1:
        notes.append("the last axis of force is taken as normal to the surface")
    if normal.mean() < 0.0:
        notes.append("force is negative on average: its sign is turned")
        normal = -normal
    return resample_to_action_rate(signal.time, normal, 0.0, count, rate), ["force"]


def _resample_motion(
    signals: dict[str, MeasuredSignal], count: int, notes: list[str], rate: float
) -> tuple[Float, Float, list[str]]:
    position, speed = signals.get("position"), signals.get("speed")
    direction, speed_m_s, known = constant_direction(count, 0.0), np.full(count, 0.1), []
    if position is not None and position.values.shape[1] >= 2:
        plane = resample_to_action_rate(position.time, position.values[:, :2], 0.0, count, rate)
        direction, speed_m_s = derive_motion(plane, rate)
        known = ["direction", "speed"]
    else:
        notes.append("no position in a plane was recorded: direction +x assumed")
    if speed is not None:
        measured_speed = (
            speed.values[:, 0] if speed.values.shape[1] == 1 else np.linalg.norm(speed.values[:, :2], axis=1)
        )
        speed_m_s = np.abs(resample_to_action_rate(speed.time, measured_speed, 0.0, count, rate))
        known = [*known, "speed"]
    elif not known:
        notes.append("no speed was recorded: 0.1 m/s assumed")
    return direction, speed_m_s, known


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
