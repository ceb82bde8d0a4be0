"""Contents of report.json: what was made, skipped or failed, and why.

Notes that refer to the Touch tab are completed with the command-line option of the same effect.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from hnf_core.files import escape_surrogates, write_text
from hnf_core.progress import add_work

SCHEMA = "hnf-touch-report-2"
REPORT_NAME = "report.json"


@dataclass(frozen=True)
class StrokeReport:
    """Entry in report.json of one stroke that was written.

    Attributes
    ----------
    routes : Mapping[str, str]
        Route by wavelength of the band; "learned" for a material that has a field of its own.
    fields : Mapping[str, str]
        Material → what its own field was trained on, "shared" for the shared field.
    fresh : bool
        True if the files of an earlier run are still valid.
    key : str
        Hash of all inputs of the signal.
    wav_hash : str
        Hash of the WAV file.
    warnings : sequence of str
        Reasons for a lower confidence; a fresh stroke keeps those of the earlier run.
    encoder : str
        Name of the encoder E of the tactile map, "" without a map.
    tactile_map_weights : str
        Hash of the weights of D_φ if the map was predicted, else "".
    picture : str
        File of the plot; "" if none is drawn.
    picture_key : str
        Hash of everything the plot shows besides the touch.
    likely : Mapping[str, float]
        The first three library materials that it could be, by probability; empty if one alone is felt.
    materials : sequence of Mapping
        What the surface was taken for, patch by patch in the order in which they are touched: `object`, `shader`,
        `library_material`, `confidence` in that choice alone (whereas `confidence` of the stroke is that of the entire
        signal), `reason`, `likely`, `routes`, and `time_share`, the patch's fraction of the contact.
    off_surface : float
        Fraction of its time, 0 to 1, that it presses beside its surface, where it is silent.
    objects : sequence of Mapping
        What was felt of each object, in the order in which they are touched: `object`, the `material`,
        `library_material` and `routes` of the patch that is touched longest, `confidence` in its part of the signal,
        the number of its `tokens`, and `time_share`, its fraction of the contact.
    """

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
    likely: Mapping[str, float] = field(default_factory=dict)
    fields: Mapping[str, str] = field(default_factory=dict)
    materials: Sequence[Mapping[str, Any]] = ()
    off_surface: float = 0.0
    objects: Sequence[Mapping[str, Any]] = ()


MAX_OFF_SURFACE = 0.1
"""Fraction of a stroke's time that it may press beside its surface without being reported as lost."""


def format_lost_note(stroke: str, surface: str, off_surface: float) -> str:
    """Return the note that a stroke presses beside its surface for too much of its time; "" if it does not."""
    if off_surface <= MAX_OFF_SURFACE:
        return ""
    return (
        f"stroke '{stroke}': for {off_surface:.0%} of its time it presses beside '{surface}' and is silent. Move its "
        "curve onto the surface; on one that deforms set Ride on Surface."
    )


@dataclass(frozen=True)
class Skipped:
    """Something that was left out, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class Failed:
    """A stroke or touch query that could not be done, and why."""

    stroke: str
    why: str


ReportedWork = Literal["close_ups", "renders", "rays", "network_calls", "tokens", "diffusion_calls"]
"""Kinds of work that a report lists, the names of the fields of `Counts`."""


@dataclass
class Counts:
    """Amount of work done: numbers that, unlike times, are the same on every computer.

    Attributes
    ----------
    close_ups : int
        Patches rendered.
    renders : int
        Renders of any kind, without the small ones that tell what a view hides or whether it is black.
    rays : int
        Rays and nearest-point queries.
    network_calls : int
        Evaluations of F_Θ, one per stroke.
    tokens : int
        Tokens encoded.
    diffusion_calls : int
        Patches whose relief was predicted by D_φ.
    """

    close_ups: int = 0
    renders: int = 0
    rays: int = 0
    network_calls: int = 0
    tokens: int = 0
    diffusion_calls: int = 0

    def add(self, kind: ReportedWork, amount: int = 1) -> None:
        """Add work to these counts and to those of `hnf_core.progress.count_work`."""
        setattr(self, kind, getattr(self, kind) + amount)
        add_work(kind, amount)


@dataclass
class Report:
    """Report of a run, written on the way, so that it is correct if the run is stopped.

    Attributes
    ----------
    scene : str
        Name of the scene file.
    metres_per_unit : float
        Length of a scene unit, which scales all heights and speeds [m].
    scale_source : str
        Where that length comes from.
    probes : list of dict
        Entry of every touch query, see docs/probe.md.
    files : list of str
        Files besides the scene's own that it was read with.
    source : str
        Hash of the scene's file and of `files` from which the baked .blend was made; "" if it is not made yet.
    left_over : list of str
        Files of an earlier run in the folder that belong to no stroke any more.
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
        """Add a warning, unless it is there already."""
        if text not in self.warnings:
            self.warnings.append(text)

    def as_json(self) -> str:
        """Return the report as JSON."""
        record = {"schema": SCHEMA, **asdict(self)}
        return escape_surrogates(json.dumps(_replace_non_finite(record), indent=1, ensure_ascii=False)) + "\n"

    def write(self, folder: Path) -> None:
        """Write report.json into a folder."""
        write_text(folder / REPORT_NAME, self.as_json())


WRITE_SHARE = 0.05
"""Share of a run's time that reports written on the way may take; one of a thousand strokes takes seconds."""


class ReportWriter:
    """Writes a run's report to a folder on the way, so that it is correct if the run is killed.

    A stroke or picture that the last report before that does not list is made again by the next run.

    Parameters
    ----------
    report : Report
        Report, which grows.
    folder : Path
        Folder to write it to.
    clock : callable, optional
        Function that returns the time [s].
    """

    def __init__(self, report: Report, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._report, self._folder, self._clock, self._due_s = report, folder, clock, -math.inf

    def write(self) -> None:
        """Write the report, unless reports would then take more than WRITE_SHARE of the time."""
        started_s = self._clock()
        if started_s < self._due_s:
            return
        self._report.write(self._folder)
        ended_s = self._clock()
        self._due_s = ended_s + (ended_s - started_s) / WRITE_SHARE


def _replace_non_finite(value: Any) -> Any:
    """Replace inf and NaN by None, as JSON has neither."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _replace_non_finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_replace_non_finite(entry) for entry in value]
    return value


OPTION_FOR_TAB_PLACE = {
    "Units in the Touch tab": "--scale METERS_PER_UNIT",
    "Feels in the Touch tab": "--material OBJECT[:SLOT]=NAME",
    "Materials in the Touch tab": "--height-as-authored",
}
"""Location in the Touch tab, as notes name it → command-line option with the same effect."""


def add_option_hint(note: str) -> str:
    """Append to a note the command-line option that has the effect of the setting it mentions, if there is one."""
    options = [option for location, option in OPTION_FOR_TAB_PLACE.items() if location in note]
    return f"{note} Here: {', '.join(options)}." if options else note
