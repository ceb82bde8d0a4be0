"""A user's copy of the Penn Haptic Texture Toolkit: models, recordings and pictures, found in any arrangement."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ..errors import FileError
from .autoregressive import PROCESS_RATE_HZ, HattProcess
from .dataset import ActionRange, DataSet, compute_action_range
from .folders import find_files, read_head
from .hatt_models import TextureModel, read_texture_model
from .hatt_recordings import QUANTITIES, detect_quantity, read_signals
from .measured import assemble_recording
from .names import match_name, normalise_name
from .recording import Recording

IMAGE_SUFFIXES = (".bmp", ".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True)
class HattFolder(DataSet):
    """Models are known by what they hold (a modelSet), not by their place; of several for one material, the one at
    10 kHz counts. Other XML files are recordings where their name, their folder or their first lines name a quantity.
    """

    folder: Path

    @cached_property
    def _files(self) -> tuple[dict[str, Path], list[Path]]:
        """Material → model file; and every file that may be a recording."""
        models: dict[str, tuple[bool, Path]] = {}
        others: list[Path] = []
        for path in find_files(self.folder, (".xml",)):
            start = read_head(path).lower()
            if b"<modelset" not in start and not path.stem.lower().startswith("models_"):
                named = detect_quantity("/".join(path.relative_to(self.folder).parts))
                if named or detect_quantity(start.decode("latin-1")):
                    others.append(path)
                continue
            name = _normalise_spaces(re.sub(r"(?i)^models_", "", path.stem))
            rate = re.search(rb"<samplerate>\s*([0-9.]+)", start)
            full = rate is None or float(rate[1]) == PROCESS_RATE_HZ
            key = next((known for known in models if normalise_name(known) == normalise_name(name)), name)
            if key not in models or (full and not models[key][0]):
                models[key] = (full, path)
        return {name: path for name, (_, path) in models.items()}, others

    @cached_property
    def _strokes(self) -> dict[str, dict[str, list[Path]]]:
        """Material → stroke → the files of its quantities."""
        models, others = self._files
        out: dict[str, dict[str, list[Path]]] = {}
        for path in others:
            relative = path.relative_to(self.folder)
            bare = re.sub(rf"(?i)({'|'.join(QUANTITIES)})\w*?(?=_|\b|[A-Z])", "", path.stem)
            material = _match_material(bare, tuple(models))
            above = [part for part in relative.parts[:-1] if detect_quantity(part) is None]
            out.setdefault(material, {}).setdefault("/".join([*above, normalise_name(bare)]), []).append(path)
        return out

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
        """Of a model: from the least speed and force at which it sounds (axes and corners of its hull are the toolkit's
        own additions) to the hull's largest. Without one: what its recordings cover."""
        process = self.process(name)
        return compute_action_range(self.recordings(name)) if process is None else _get_hull_range(process.model)

    def image(self, name: str) -> Path | None:
        wanted = normalise_name(match_name(name, self.materials, str(self.folder)))
        pictures = {normalise_name(path.stem): path for path in reversed(find_files(self.folder, IMAGE_SUFFIXES))}
        return pictures.get(wanted + "square") or pictures.get(wanted)


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
    """The known material that the stem ends with (a number of the take may follow); else what stands behind the prefix
    and before _<number>, _train or _test."""
    plain = re.sub(r"(?i)_(train|test)\w*$", "", stem)
    for ending in (plain, re.sub(r"_\d+$", "", plain)):
        fitting = [name for name in known if normalise_name(ending).endswith(normalise_name(name))]
        if fitting:
            return max(fitting, key=len)
    rest = re.sub(r"_\d+$", "", plain)
    return _normalise_spaces(rest.partition("_")[2] or rest) or stem
