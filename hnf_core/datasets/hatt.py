"""Reader of the Penn Haptic Texture Toolkit (HaTT): models, recordings and photographs, in any arrangement of folders.

Recordings are XML files of acceleration, force, position and speed, one quantity per file or all in one. Their tags
differ from copy to copy, so the tree is searched: an element with many <value> children, or many numbers in its text,
is an array named by its tag; SampleRate and …Units elements apply to it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..tables import MAX_MEASURABLE, is_measurable, is_number, parse_unit_factor
from .data_files import find_files, read_head, read_xml
from .hatt_models import PROCESS_RATE_HZ, HattProcess, TextureModel, read_texture_model
from .recording import ActionRange, DataSet, Recording, compute_action_range, match_name, normalise_name
from .time_series import SIGNAL_RATE_HZ, MeasuredSignal, assemble_recording

Float = NDArray[np.float64]

QUANTITIES = {"accel": "acceleration", "force": "force", "speed": "speed", "veloc": "speed", "position": "position"}
"""Words in tags and names, and the quantities that they mean."""
_DEFAULT_UNITS = {"acceleration": "m/s^2", "force": "N", "speed": "mm/s", "position": "mm"}
MIN_ARRAY_LENGTH = 4
"""Least number of values of a signal; fewer are a setting."""
_TOOLKIT_REMEDY = "Get the file again from the toolkit."


def detect_quantity(text: str) -> str | None:
    """Return acceleration, force, speed or position if a word for it is in the text, else None."""
    lower = text.lower()
    return next((quantity for word, quantity in QUANTITIES.items() if word in lower), None)


def read_signals(path: Path) -> list[MeasuredSignal]:
    """Read all signals (acceleration, force, position, speed) in one XML file.

    Raises FileError if there are none, or their numbers are no signal.
    """
    root, where = read_xml(path), str(path)
    settings = {e.tag.lower(): (e.text or "").strip() for e in root.iter() if len(e) == 0 and (e.text or "").strip()}
    rate, rate_note = _read_rate(settings, where)
    values_by_quantity: dict[str, list[tuple[str, Float]]] = {}
    for names, element in _walk(root, ()):
        values = _read_array(element, f"{where}, {element.tag}")
        quantity = detect_quantity("/".join(names)) or detect_quantity(path.stem) or detect_quantity(path.parent.name)
        if values is None or quantity is None or "tangent" in element.tag.lower():
            continue
        values_by_quantity.setdefault(quantity, []).append((_detect_axis(element.tag), values))
    if not values_by_quantity:
        raise FileError(
            "no signal of acceleration, force, speed or position is in it.",
            where=where,
            remedy="Expected elements such as Accel, ForceNormal or Speed with one value per sample.",
        )
    return [
        _build_signal(quantity, arrays, settings, rate, where, rate_note)
        for quantity, arrays in values_by_quantity.items()
    ]


def _walk(element: Element, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Element]]:
    """Yield every XML element below and including `element`, with the tags on the path to it."""
    names = (*above, element.tag)
    yield names, element
    for child in element:
        if child.tag.lower() != "value":
            yield from _walk(child, names)


def _read_rate(settings: dict[str, str], where: str) -> tuple[float, tuple[str, ...]]:
    text = settings.get("samplerate", "")
    if not text:
        return SIGNAL_RATE_HZ, ("SampleRate is missing: taken as 10 kHz",)
    match = re.fullmatch(r"([0-9.eE+]+)\s*([a-zA-Z]*)", text)
    try:
        rate = float(match[1]) * parse_unit_factor("rate", match[2] or "Hz", where) if match else 0.0
    except ValueError:
        rate = 0.0
    if not 10.0 <= rate <= 1e6:
        raise FileError(f"{text!r} is no sample rate.", where=f"{where}, SampleRate", remedy=_TOOLKIT_REMEDY)
    return rate, ()


def _read_array(element: Element, where: str) -> Float | None:
    """Return the numbers in an XML element (n,), or (n, k) if every value has k numbers; None if it is no array."""
    children = [child.text for child in element if child.tag.lower() == "value"]
    rows = [(text or "").replace(",", " ").split() for text in children]
    if not rows and len(element) == 0:
        words = (element.text or "").replace(",", " ").split()
        if len(words) < MIN_ARRAY_LENGTH or not is_number(words[0]):
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


def _detect_axis(tag: str) -> str:
    if "normal" in tag.lower():
        return "normal"
    match = re.search(r"(?:^|[a-z_])([XYZ])(?:$|_)|_([xyz])$|^([xyz])$", tag)
    return next((group.lower() for group in match.groups() if group), "") if match else ""


def _build_signal(
    quantity: str, parts: list[tuple[str, Float]], settings: dict[str, str], rate: float, where: str,
    notes: tuple[str, ...],
) -> MeasuredSignal:  # fmt: skip
    tags = {"acceleration": ("accelunits", "accelerationunits"), "force": ("forceunits",),
            "speed": ("speedunits", "velocityunits"), "position": ("positionunits",)}[quantity]  # fmt: skip
    unit = next((settings[tag] for tag in tags if tag in settings), "")
    if not unit:
        notes = (*notes, f"units of {quantity} are missing: taken as {_DEFAULT_UNITS[quantity]}")
    factor = parse_unit_factor(quantity, unit or _DEFAULT_UNITS[quantity], f"{where}, {tags[0]}")
    lengths = {len(values) for _, values in parts}
    if len(lengths) != 1:
        raise FileError(f"axes of {quantity} of {sorted(lengths)} samples.", where=where, remedy=_TOOLKIT_REMEDY)
    if quantity == "force" and any(axis == "normal" for axis, _ in parts):
        parts = [part for part in parts if part[0] == "normal"]
    parts = sorted(parts, key=lambda part: part[0])
    columns = [values if values.ndim == 2 else values[:, None] for _, values in parts]
    names = [axis for axis, values in parts for _ in range(1 if values.ndim == 1 else values.shape[1])]
    return MeasuredSignal(quantity, tuple(names), factor * np.concatenate(columns, axis=1), rate, where, notes)


IMAGE_SUFFIXES = (".bmp", ".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True)
class HattFolder(DataSet):
    """A user's copy of the Penn Haptic Texture Toolkit, read as a data set.

    Models are recognised by their content (a modelSet); of several for one material, the one with a 10 kHz sample rate
    is used. Other XML files are recordings if their name, folder or first lines name a quantity.
    """

    folder: Path

    @cached_property
    def _files(self) -> tuple[dict[str, Path], list[Path]]:
        """Model file of each material, and all files that may be recordings."""
        models: dict[str, tuple[bool, Path]] = {}
        recordings: list[Path] = []
        for path in find_files(self.folder, (".xml",)):
            start = read_head(path).lower()
            if b"<modelset" not in start and not path.stem.lower().startswith("models_"):
                quantity = detect_quantity("/".join(path.relative_to(self.folder).parts))
                if quantity or detect_quantity(start.decode("latin-1")):
                    recordings.append(path)
                continue
            name = _normalise_spaces(re.sub(r"(?i)^models_", "", path.stem))
            rate = re.search(rb"<samplerate>\s*([0-9.]+)", start)
            is_full_rate = rate is None or float(rate[1]) == PROCESS_RATE_HZ
            key = next((known for known in models if normalise_name(known) == normalise_name(name)), name)
            if key not in models or (is_full_rate and not models[key][0]):
                models[key] = (is_full_rate, path)
        return {name: path for name, (_, path) in models.items()}, recordings

    @cached_property
    def _strokes(self) -> dict[str, dict[str, list[Path]]]:
        """Recording files by material and stroke: one file per quantity, or one for all."""
        models, recordings = self._files
        strokes_by_material: dict[str, dict[str, list[Path]]] = {}
        for path in recordings:
            relative = path.relative_to(self.folder)
            base_name = re.sub(rf"(?i)({'|'.join(QUANTITIES)})\w*?(?=_|\b|[A-Z])", "", path.stem)
            material = _match_material(base_name, tuple(models))
            parents = [part for part in relative.parts[:-1] if detect_quantity(part) is None]
            strokes_by_material.setdefault(material, {}).setdefault(
                "/".join([*parents, normalise_name(base_name)]), []
            ).append(path)
        return strokes_by_material

    @cached_property
    def materials(self) -> tuple[str, ...]:
        names = tuple(sorted({*self._files[0], *self._strokes}))
        if not names:
            raise FileError(
                "neither texture models (XML files with a modelSet) nor recordings are in it.",
                where=str(self.folder),
                remedy="Give the toolkit's folder, the one with Models10000Hz, or the XML files themselves.",
            )
        return names

    def recordings(self, name: str) -> list[Recording]:
        known = match_name(name, self.materials, str(self.folder))
        strokes = self._strokes.get(known, {})
        return [
            assemble_recording([signal for path in paths for signal in read_signals(path)], known, str(paths[0]))
            for _, paths in sorted(strokes.items())
        ]

    def process(self, name: str) -> HattProcess | None:
        known = match_name(name, self.materials, str(self.folder))
        path = self._files[0].get(known)
        return None if path is None else HattProcess(replace(read_texture_model(path), material=known))

    def action_range(self, name: str) -> ActionRange:
        """Return the range of speed and force in a material's model or, without one, in its recordings.

        A model's range starts at the least speed and force at which it is not silent (its silent points at speed or
        force 0 were added by the toolkit), and ends at its largest.
        """
        process = self.process(name)
        return compute_action_range(self.recordings(name)) if process is None else _get_hull_range(process.model)

    def image(self, name: str) -> Path | None:
        key = normalise_name(match_name(name, self.materials, str(self.folder)))
        images = {normalise_name(path.stem): path for path in reversed(find_files(self.folder, IMAGE_SUFFIXES))}
        return images.get(key + "square") or images.get(key)


def _get_hull_range(model: TextureModel) -> ActionRange:
    sounding = model.variances > 0.0
    if not sounding.any():
        raise FileError("every variance is 0: it is silent.", where=model.source, remedy="Get the file again.")
    return ActionRange(
        speed_m_s=(float(model.speeds[sounding].min()), model.max_speed),
        force_n=(float(model.forces[sounding].min()), model.max_force),
    )


def _normalise_spaces(name: str) -> str:
    return " ".join(name.replace("_", " ").split())


def _match_material(stem: str, known: tuple[str, ...]) -> str:
    """Return the known material that a file's stem ends with, not counting a take number at the end.

    Otherwise return the text between the prefix and _<number>, _train or _test.
    """
    base = re.sub(r"(?i)_(train|test)\w*$", "", stem)
    for candidate in (base, re.sub(r"_\d+$", "", base)):
        matches = [name for name in known if normalise_name(candidate).endswith(normalise_name(name))]
        if matches:
            return max(matches, key=len)
    remainder = re.sub(r"_\d+$", "", base)
    return _normalise_spaces(remainder.partition("_")[2] or remainder) or stem
