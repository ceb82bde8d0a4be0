"""HaTT recordings: XML files of acceleration, force, position and speed, one quantity a file or all in one.

Their tags differ from copy to copy, so the tree is walked: an element with many <value> children, or with many numbers
in its text, is an array under its tag; SampleRate and …Units beside it are heeded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ
from ..errors import FileError
from ..simulation.dft321 import dft321
from .recording import Recording
from .safe_xml import read_xml
from .series import SIGNAL_RATE_HZ, action_of, hand_series, motion, resampled, straight_direction, whole_action_samples
from .written_units import BEYOND, measurable, unit_factor

Float = NDArray[np.float64]

QUANTITIES = {"accel": "acceleration", "force": "force", "speed": "speed", "veloc": "speed", "position": "position"}
_UNITS = {"acceleration": "m/s^2", "force": "N", "speed": "mm/s", "position": "mm"}
MANY = 4
"""Fewer numbers than this in one element are a setting, not a signal."""
LENGTHS_AGREE = 0.02
_AGAIN = "Get the file again from the toolkit."


@dataclass(frozen=True)
class Signal:
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


def quantity_in(text: str) -> str | None:
    """acceleration, force, speed or position, where a word of one is in the text."""
    lower = text.lower()
    return next((quantity for word, quantity in QUANTITIES.items() if word in lower), None)


def read_signals(path: Path) -> list[Signal]:
    """All quantities of one file. Raises FileError where there is none, or its numbers are no signal."""
    root, where = read_xml(path), str(path)
    settings = {e.tag.lower(): (e.text or "").strip() for e in root.iter() if len(e) == 0 and (e.text or "").strip()}
    rate, rate_note = _rate(settings, where)
    found: dict[str, list[tuple[str, Float]]] = {}
    for names, element in _walk(root, ()):
        values = _array(element, f"{where}, {element.tag}")
        quantity = quantity_in("/".join(names)) or quantity_in(path.stem) or quantity_in(path.parent.name)
        if values is None or quantity is None or "tangent" in element.tag.lower():
            continue
        found.setdefault(quantity, []).append((_axis(element.tag), values))
    if not found:
        raise FileError(
            "no signal of acceleration, force, speed or position is in it.",
            where=where,
            remedy="Expected elements such as Accel, ForceNormal or Speed with one value per sample.",
        )
    return [_signal(quantity, parts, settings, rate, where, rate_note) for quantity, parts in found.items()]


def _walk(element: Element, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Element]]:
    names = (*above, element.tag)
    yield names, element
    for child in element:
        if child.tag.lower() != "value":
            yield from _walk(child, names)


def _rate(settings: dict[str, str], where: str) -> tuple[float, tuple[str, ...]]:
    written = settings.get("samplerate", "")
    if not written:
        return SIGNAL_RATE_HZ, ("SampleRate is missing: taken as 10 kHz",)
    match = re.fullmatch(r"([0-9.eE+]+)\s*([a-zA-Z]*)", written)
    try:
        rate = float(match[1]) * unit_factor("rate", match[2] or "Hz", where) if match else 0.0
    except ValueError:
        rate = 0.0
    if not 10.0 <= rate <= 1e6:
        raise FileError(f"{written!r} is no sample rate.", where=f"{where}, SampleRate", remedy=_AGAIN)
    return rate, ()


def _array(element: Element, where: str) -> Float | None:
    """(n,) or (n, k) where every value holds k numbers; None where the element is no array."""
    children = [child.text for child in element if child.tag.lower() == "value"]
    rows = [(text or "").replace(",", " ").split() for text in children]
    if not rows and len(element) == 0:
        words = (element.text or "").replace(",", " ").split()
        if len(words) < MANY or not _is_number(words[0]):
            return None
        rows = [[word] for word in words]
    if len(rows) < MANY:
        return None
    widths = {len(row) for row in rows}
    if len(widths) != 1 or 0 in widths:
        raise FileError(f"its values hold {sorted(widths)} numbers each.", where=where, remedy=_AGAIN)
    try:
        values = np.array([[float(word) for word in row] for row in rows])
    except ValueError as error:
        raise FileError(f"{error}.", where=where, remedy=_AGAIN) from error
    if not measurable(values).all():
        bad = int(np.argmin(measurable(values).all(axis=1))) + 1
        raise FileError(f"value {bad} is not finite or beyond {BEYOND:g}.", where=where, remedy=_AGAIN)
    return values[:, 0] if values.shape[1] == 1 else values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _axis(tag: str) -> str:
    if "normal" in tag.lower():
        return "normal"
    last = re.search(r"(?:^|[a-z_])([XYZ])(?:$|_)|_([xyz])$|^([xyz])$", tag)
    return next((group.lower() for group in last.groups() if group), "") if last else ""


def _signal(
    quantity: str, parts: list[tuple[str, Float]], settings: dict[str, str], rate: float, where: str,
    notes: tuple[str, ...],
) -> Signal:  # fmt: skip
    tags = {"acceleration": ("accelunits", "accelerationunits"), "force": ("forceunits",),
            "speed": ("speedunits", "velocityunits"), "position": ("positionunits",)}[quantity]  # fmt: skip
    written = next((settings[tag] for tag in tags if tag in settings), "")
    if not written:
        notes = (*notes, f"units of {quantity} are missing: taken as {_UNITS[quantity]}")
    factor = unit_factor(quantity, written or _UNITS[quantity], f"{where}, {tags[0]}")
    lengths = {len(values) for _, values in parts}
    if len(lengths) != 1:
        raise FileError(f"axes of {quantity} of {sorted(lengths)} samples.", where=where, remedy=_AGAIN)
    if quantity == "force" and any(axis == "normal" for axis, _ in parts):
        parts = [part for part in parts if part[0] == "normal"]
    parts = sorted(parts, key=lambda part: part[0])
    columns = [values if values.ndim == 2 else values[:, None] for _, values in parts]
    names = [axis for axis, values in parts for _ in range(1 if values.ndim == 1 else values.shape[1])]
    return Signal(quantity, tuple(names), factor * np.concatenate(columns, axis=1), rate, where, notes)


def assemble(signals: Sequence[Signal], material: str, where: str) -> Recording:
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
    if longest - shortest > LENGTHS_AGREE * longest:
        listed = ", ".join(f"{name} {seconds:.3f} s" for name, seconds in sorted(lasting.items()))
        raise FileError(f"its signals do not belong together: {listed}.", where=where, remedy=_AGAIN)
    count = whole_action_samples(shortest, where)
    notes = [note for signal in signals for note in signal.notes]
    acceleration = by_name["acceleration"]
    samples = _samples(acceleration, round((count - 1) * SIGNAL_RATE_HZ / ACTION_RATE_HZ), where)
    force, force_known = _force(by_name.get("force"), count, notes, where)
    direction, speed, moving_known = _movement(by_name, count, notes, where)
    return Recording(
        action_of(direction, speed, force), samples, SIGNAL_RATE_HZ, material, where,
        frozenset(force_known + moving_known), tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _samples(acceleration: Signal, count: int, where: str) -> Float:
    values = acceleration.values - acceleration.values.mean(axis=0)
    if values.shape[1] not in (1, 3):
        raise FileError(f"acceleration has {values.shape[1]} axes.", where=where, remedy="One or three are expected.")
    fused = dft321(values) if values.shape[1] == 3 else values[:, 0]
    if acceleration.rate == SIGNAL_RATE_HZ:
        return fused[:count].copy()
    return resampled(acceleration.time, fused, np.arange(count) / SIGNAL_RATE_HZ)


def _force(signal: Signal | None, count: int, notes: list[str], where: str) -> tuple[Float, list[str]]:
    if signal is None:
        notes.append("no force was recorded: 1 N assumed")
        return np.ones(count), []
    normal = signal.values[:, -1]
    if signal.values.shape[1] > 1:
        notes.append("the last axis of force is taken as normal to the surface")
    if normal.mean() < 0.0:
        notes.append("force is negative on average: its sign is turned")
        normal = -normal
    return hand_series(signal.time, normal, 0.0, count), ["force"]


def _movement(signals: dict[str, Signal], count: int, notes: list[str], where: str) -> tuple[Float, Float, list[str]]:
    position, speed = signals.get("position"), signals.get("speed")
    direction, pace, known = straight_direction(count, 0.0), np.full(count, 0.1), []
    if position is not None and position.values.shape[1] >= 2:
        direction, pace = motion(hand_series(position.time, position.values[:, :2], 0.0, count))
        known = ["direction", "speed"]
    else:
        notes.append("no position in a plane was recorded: direction +x assumed")
    if speed is not None:
        along = speed.values[:, 0] if speed.values.shape[1] == 1 else np.linalg.norm(speed.values[:, :2], axis=1)
        pace = np.abs(hand_series(speed.time, along, 0.0, count))
        known = [*known, "speed"]
    elif not known:
        notes.append("no speed was recorded: 0.1 m/s assumed")
    return direction, pace, known
