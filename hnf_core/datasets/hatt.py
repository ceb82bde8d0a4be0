"""A user's copy of the Penn Haptic Texture Toolkit: models, recordings and pictures, found in any arrangement."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ..errors import FileError
from .autoregressive import PROCESS_RATE_HZ, HattProcess
from .dataset import ActionRange, DataSet
from .folders import files_below, opening
from .hatt_models import TextureModel, read_texture_model
from .names import match_name, plain_name
from .recording import Recording

PICTURES = (".bmp", ".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True)
class HattFolder(DataSet):
    """Models are known by what they hold (a modelSet), not by their place. Where a material has several, the one at
    10 kHz counts."""

    folder: Path

    @cached_property
    def _models(self) -> dict[str, Path]:
        """Material → file; those at 10 kHz replace others."""
        found: dict[str, tuple[bool, Path]] = {}
        for path in files_below(self.folder, (".xml",)):
            start = opening(path).lower()
            if b"<modelset" not in start and not path.stem.lower().startswith("models_"):
                continue
            name = " ".join(re.sub(r"(?i)^models_", "", path.stem).replace("_", " ").split())
            rate = re.search(rb"<samplerate>\s*([0-9.]+)", start)
            full = rate is None or float(rate[1]) == PROCESS_RATE_HZ
            key = next((known for known in found if plain_name(known) == plain_name(name)), name)
            if key not in found or (full and not found[key][0]):
                found[key] = (full, path)
        return {name: path for name, (_, path) in sorted(found.items())}

    @cached_property
    def materials(self) -> tuple[str, ...]:
        names = tuple(self._models)
        if not names:
            raise FileError(
                "no texture models (XML files with a modelSet) are in it.",
                where=str(self.folder),
                remedy="Give the toolkit's folder, the one with Models10000Hz, or the XML files themselves.",
            )
        return names

    def model(self, name: str) -> TextureModel:
        """Raises FileError where the file is damaged, MaterialError for an unknown name."""
        known = match_name(name, self.materials, str(self.folder))
        return replace(read_texture_model(self._models[known]), material=known)

    def recordings(self, name: str) -> list[Recording]:
        match_name(name, self.materials, str(self.folder))
        return []

    def process(self, name: str) -> HattProcess:
        return HattProcess(self.model(name))

    def action_range(self, name: str) -> ActionRange:
        """From the least speed and force at which the texture sounds in the recordings behind the model (axes and
        corners of its hull are the toolkit's own additions) to the hull's largest."""
        model = self.model(name)
        sounding = model.variances > 0.0
        if not sounding.any():
            raise FileError("every variance is 0: it is silent.", where=model.source, remedy="Get the file again.")
        return ActionRange(
            speed_m_s=(float(model.speeds[sounding].min()), model.max_speed),
            force_n=(float(model.forces[sounding].min()), model.max_force),
        )

    def image(self, name: str) -> Path | None:
        wanted = plain_name(match_name(name, self.materials, str(self.folder)))
        pictures = {plain_name(path.stem): path for path in reversed(files_below(self.folder, PICTURES))}
        return pictures.get(wanted + "square") or pictures.get(wanted)
