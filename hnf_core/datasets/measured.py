"""What was measured of one stroke, quantity by quantity → a Recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ
from ..errors import FileError
from ..field.resampling import resample
from ..simulation.dft321 import dft321
from .recording import Recording
from .series import (
    SIGNAL_RATE_HZ,
    build_action,
    constant_direction,
    count_action_samples,
    derive_motion,
    interpolate_series,
    resample_to_action_rate,
)

Float = NDArray[np.float64]

DURATION_TOLERANCE = 0.02


@dataclass(frozen=True)
class MeasuredSignal:
    """One quantity, (n, axes) in SI units, axes in the order x, y, z, or one."""

    quantity: str
    axes: tuple[str, ...]
    values: Float
    rate: float
    source: str
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> Float:
        return np.arange(len(self.values)) / self.rate


def assemble_recording(signals: Sequence[MeasuredSignal], material: str, where: str) -> Recording:
    """The signals of one stroke → Recording. What is not there is assumed and said: direction +x, 0.1 m/s, 1 N.

    Raises FileError without acceleration, with a quantity twice, or where they do not last equally long (to 2 %).
    """
    by_name = {signal.quantity: signal for signal in signals}
    if len(by_name) != len(signals):
        raise FileError("a quantity stands in it twice.", where=where, remedy="Keep one file per quantity and stroke.")
    if "acceleration" not in by_name:
        raise FileError("there is no acceleration.", where=where, remedy="Give the Accel file of this stroke too.")
    lasting = {name: len(signal.values) / signal.rate for name, signal in by_name.items()}
    shortest, longest = min(lasting.values()), max(lasting.values())
    if longest - shortest > DURATION_TOLERANCE * longest:
        listed = ", ".join(f"{name} {seconds:.3f} s" for name, seconds in sorted(lasting.items()))
        raise FileError(f"its signals do not belong together: {listed}.", where=where, remedy="Get the file again.")
    count = count_action_samples(shortest, where)
    notes = [note for signal in signals for note in signal.notes]
    acceleration = by_name["acceleration"]
    samples = _resample_acceleration(acceleration, round((count - 1) * SIGNAL_RATE_HZ / ACTION_RATE_HZ), where)
    force, force_known = _resample_force(by_name.get("force"), count, notes, where)
    direction, speed, moving_known = _resample_motion(by_name, count, notes, where)
    return Recording(
        build_action(direction, speed, force), samples, SIGNAL_RATE_HZ, material, where,
        frozenset(force_known + moving_known), tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _resample_acceleration(acceleration: MeasuredSignal, count: int, where: str) -> Float:
    values = acceleration.values - acceleration.values.mean(axis=0)
    if values.shape[1] not in (1, 3):
        raise FileError(f"acceleration has {values.shape[1]} axes.", where=where, remedy="One or three are expected.")
    fused = dft321(values) if values.shape[1] == 3 else values[:, 0]
    if acceleration.rate > SIGNAL_RATE_HZ:  # what only the faster rate holds must not fold into the touch band
        fused = resample(fused, acceleration.rate, SIGNAL_RATE_HZ)[0]
    elif acceleration.rate < SIGNAL_RATE_HZ:
        fused = interpolate_series(acceleration.time, fused, np.arange(count) / SIGNAL_RATE_HZ)
    return fused[:count].copy()


def _resample_force(signal: MeasuredSignal | None, count: int, notes: list[str], where: str) -> tuple[Float, list[str]]:
    if signal is None:
        notes.append("no force was recorded: 1 N assumed")
        return np.ones(count), []
    normal = signal.values[:, -1]
    if signal.values.shape[1] > 1:
        notes.append("the last axis of force is taken as normal to the surface")
    if normal.mean() < 0.0:
        notes.append("force is negative on average: its sign is turned")
        normal = -normal
    return resample_to_action_rate(signal.time, normal, 0.0, count), ["force"]


def _resample_motion(
    signals: dict[str, MeasuredSignal], count: int, notes: list[str], where: str
) -> tuple[Float, Float, list[str]]:
    position, speed = signals.get("position"), signals.get("speed")
    direction, pace, known = constant_direction(count, 0.0), np.full(count, 0.1), []
    if position is not None and position.values.shape[1] >= 2:
        direction, pace = derive_motion(resample_to_action_rate(position.time, position.values[:, :2], 0.0, count))
        known = ["direction", "speed"]
    else:
        notes.append("no position in a plane was recorded: direction +x assumed")
    if speed is not None:
        along = speed.values[:, 0] if speed.values.shape[1] == 1 else np.linalg.norm(speed.values[:, :2], axis=1)
        pace = np.abs(resample_to_action_rate(speed.time, along, 0.0, count))
        known = [*known, "speed"]
    elif not known:
        notes.append("no speed was recorded: 0.1 m/s assumed")
    return direction, pace, known
