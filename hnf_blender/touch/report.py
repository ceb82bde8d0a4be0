"""report.json: what was made, what it cost, what was skipped, what failed, and why.

Words of the command line: what notes ask to be done in the Touch tab, as options.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hnf_core.files import write_text

SCHEMA = "hnf-touch-report-1"
REPORT_NAME = "report.json"


@dataclass(frozen=True)
class StrokeReport:
    """One delivered stroke. routes: band wavelength → route. key: hash of everything the signal follows from.
    warnings: what lowered the confidence of the synthesis; a fresh stroke keeps its own. encoder: make of E that
    described the map, "" without one. tactile_map_weights: hash of D_φ's where the map was predicted, else "".
    picture_key: hash of what the picture shows beside the touch."""

    name: str
    object: str
    material: str
    library_material: str
    routes: Mapping[str, str]
    resolved_wavelength_m: float | None
    height_source: str
    height_peak_to_peak_m: float | None
    wav: str
    picture: str
    duration_s: float
    rms_m_s2: float
    confidence: float
    probe: str
    seed: int
    fresh: bool
    key: str
    wav_hash: str
    warnings: Sequence[str] = ()
    encoder: str = ""
    tactile_map_weights: str = ""
    picture_key: str = ""


@dataclass(frozen=True)
class Skipped:
    what: str
    why: str


@dataclass(frozen=True)
class Failed:
    stroke: str
    why: str


@dataclass
class Counts:
    """Work done, not time: patches looked at (close_ups), renders of any kind, rays and nearest-point queries, F_Θ
    calls (network_calls), tokens encoded, patches whose relief D_φ estimated (diffusion_calls)."""

    close_ups: int = 0
    renders: int = 0
    rays: int = 0
    network_calls: int = 0
    tokens: int = 0
    diffusion_calls: int = 0


@dataclass
class Report:
    """Grows during a run; written after every stroke, so that a stopped run leaves a true account.

    metres_per_unit: length of a scene unit, which every height and speed is scaled by; scale_source: who said so.
    probes: an entry for each place that was looked at, as docs/probe.md says it. files: those beside the scene's own
    that it was read with. source: hash of the scene's own and of those, as the baked .blend was made from them, "" =
    it is not made yet. left_over: files of an earlier run in the folder that no stroke owns any more.
    """

    scene: str
    metres_per_unit: float
    scale_source: str
    strokes: list[StrokeReport] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    timings: dict[str, float] = field(default_factory=dict)
    skipped: list[Skipped] = field(default_factory=list)
    failed: list[Failed] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    baked_blend: str = ""
    probes: list[dict[str, Any]] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    source: str = ""
    left_over: list[str] = field(default_factory=list)

    def add_warning(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def as_json(self) -> str:
        record = {"schema": SCHEMA, **asdict(self)}
        return json.dumps(_replace_non_finite(record), indent=1, ensure_ascii=False) + "\n"

    def write(self, folder: Path) -> None:
        write_text(folder / REPORT_NAME, self.as_json())


def _replace_non_finite(value: Any) -> Any:
    """JSON has no inf and no NaN: they become null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _replace_non_finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_replace_non_finite(entry) for entry in value]
    return value


OPTION_FOR_TAB_PLACE = {
    "Units in the Touch tab": "--scale METRES_PER_UNIT",
    "Feels in the Touch tab": "--material OBJECT[:SLOT]=NAME",
}
"""A place in the tab, as notes name it → the option that says the same."""


def add_option_hint(note: str) -> str:
    """The note, and the option that does what it asks for, where there is one."""
    options = [option for place, option in OPTION_FOR_TAB_PLACE.items() if place in note]
    return f"{note} Here: {', '.join(options)}." if options else note
