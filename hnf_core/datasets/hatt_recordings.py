"""HaTT recordings: XML files of acceleration, force, position and speed, one quantity a file or all in one.

Their tags differ from copy to copy, so the tree is walked: an element with many <value> children, or with many numbers
in its text, is an array under its tag; SampleRate and …Units beside it are heeded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from .measured import MeasuredSignal
from .safe_xml import read_xml
from .series import SIGNAL_RATE_HZ
from .written_units import MAX_MEASURABLE, is_measurable, parse_unit_factor

Float = NDArray[np.float64]

QUANTITIES = {"accel": "acceleration", "force": "force", "speed": "speed", "veloc": "speed", "position": "position"}
_DEFAULT_UNITS = {"acceleration": "m/s^2", "force": "N", "speed": "mm/s", "position": "mm"}
MIN_ARRAY_LENGTH = 4
"""Fewer numbers than this in one element are a setting, not a signal."""
_TOOLKIT_REMEDY = "Get the file again from the toolkit."


def detect_quantity(text: str) -> str | None:
    """acceleration, force, speed or position, where a word of one is in the text."""
    lower = text.lower()
    return next((quantity for word, quantity in QUANTITIES.items() if word in lower), None)


def read_signals(path: Path) -> list[MeasuredSignal]:
    """All quantities of one file. Raises FileError where there is none, or its numbers are no signal."""
    root, where = read_xml(path), str(path)
    settings = {e.tag.lower(): (e.text or "").strip() for e in root.iter() if len(e) == 0 and (e.text or "").strip()}
    rate, rate_note = _read_rate(settings, where)
    found: dict[str, list[tuple[str, Float]]] = {}
    for names, element in _walk(root, ()):
        values = _read_array(element, f"{where}, {element.tag}")
        quantity = detect_quantity("/".join(names)) or detect_quantity(path.stem) or detect_quantity(path.parent.name)
        if values is None or quantity is None or "tangent" in element.tag.lower():
            continue
        found.setdefault(quantity, []).append((_detect_axis(element.tag), values))
    if not found:
        raise FileError(
            "no signal of acceleration, force, speed or position is in it.",
            where=where,
            remedy="Expected elements such as Accel, ForceNormal or Speed with one value per sample.",
        )
    return [_build_signal(quantity, parts, settings, rate, where, rate_note) for quantity, parts in found.items()]


def _walk(element: Element, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Element]]:
    names = (*above, element.tag)
    yield names, element
    for child in element:
        if child.tag.lower() != "value":
            yield from _walk(child, names)


def _read_rate(settings: dict[str, str], where: str) -> tuple[float, tuple[str, ...]]:
    written = settings.get("samplerate", "")
    if not written:
        return SIGNAL_RATE_HZ, ("SampleRate is missing: taken as 10 kHz",)
    match = re.fullmatch(r"([0-9.eE+]+)\s*([a-zA-Z]*)", written)
    try:
        rate = float(match[1]) * parse_unit_factor("rate", match[2] or "Hz", where) if match else 0.0
    except ValueError:
        rate = 0.0
    if not 10.0 <= rate <= 1e6:
        raise FileError(f"{written!r} is no sample rate.", where=f"{where}, SampleRate", remedy=_TOOLKIT_REMEDY)
    return rate, ()


def _read_array(element: Element, where: str) -> Float | None:
    """(n,) or (n, k) where every value holds k numbers; None where the element is no array."""
    children = [child.text for child in element if child.tag.lower() == "value"]
    rows = [(text or "").replace(",", " ").split() for text in children]
    if not rows and len(element) == 0:
        words = (element.text or "").replace(",", " ").split()
        if len(words) < MIN_ARRAY_LENGTH or not _is_number(words[0]):
            return None
        rows = [[word] for word in words]
    if len(rows) < MIN_ARRAY_LENGTH:
        return None
    widths = {len(row) for row in rows}
    if len(widths) != 1 or 0 in widths:
        raise FileError(f"its values hold {sorted(widths)} numbers each.", where=where, remedy=_TOOLKIT_REMEDY)
    try:
        values = np.array([[float(word) for word in row] for row in rows])
    except ValueError as error:
        raise FileError(f"{error}.", where=where, remedy=_TOOLKIT_REMEDY) from error
    if not is_measurable(values).all():
        bad = int(np.argmin(is_measurable(values).all(axis=1))) + 1
        raise FileError(f"value {bad} is not finite or beyond {MAX_MEASURABLE:g}.", where=where, remedy=_TOOLKIT_REMEDY)
    return values[:, 0] if values.shape[1] == 1 else values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _detect_axis(tag: str) -> str:
    if "normal" in tag.lower():
        return "normal"
    last = re.search(r"(?:^|[a-z_])([XYZ])(?:$|_)|_([xyz])$|^([xyz])$", tag)
    return next((group.lower() for group in last.groups() if group), "") if last else ""


def _build_signal(
    quantity: str, parts: list[tuple[str, Float]], settings: dict[str, str], rate: float, where: str,
    notes: tuple[str, ...],
) -> MeasuredSignal:  # fmt: skip
    tags = {"acceleration": ("accelunits", "accelerationunits"), "force": ("forceunits",),
            "speed": ("speedunits", "velocityunits"), "position": ("positionunits",)}[quantity]  # fmt: skip
    written = next((settings[tag] for tag in tags if tag in settings), "")
    if not written:
        notes = (*notes, f"units of {quantity} are missing: taken as {_DEFAULT_UNITS[quantity]}")
    factor = parse_unit_factor(quantity, written or _DEFAULT_UNITS[quantity], f"{where}, {tags[0]}")
    lengths = {len(values) for _, values in parts}
    if len(lengths) != 1:
        raise FileError(f"axes of {quantity} of {sorted(lengths)} samples.", where=where, remedy=_TOOLKIT_REMEDY)
    if quantity == "force" and any(axis == "normal" for axis, _ in parts):
        parts = [part for part in parts if part[0] == "normal"]
    parts = sorted(parts, key=lambda part: part[0])
    columns = [values if values.ndim == 2 else values[:, None] for _, values in parts]
    names = [axis for axis, values in parts for _ in range(1 if values.ndim == 1 else values.shape[1])]
    return MeasuredSignal(quantity, tuple(names), factor * np.concatenate(columns, axis=1), rate, where, notes)
