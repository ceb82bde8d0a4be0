"""What an earlier run left in a folder: the strokes that are still true, and the files that nothing owns any more."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from hnf_core.files import content_hash

from .jobs import Job
from .report import REPORT_NAME, SCHEMA, StrokeReport


@dataclass(frozen=True)
class Earlier:
    """An earlier run by its report. scene: name of its file. source: hash of what its .blend was made from, "" = it has
    none, or does not say. left_over: files that no stroke owned even then."""

    strokes: tuple[StrokeReport, ...] = ()
    scene: str = ""
    source: str = ""
    left_over: tuple[str, ...] = ()

    def fresh(self, jobs: Iterable[Job], folder: Path | None) -> dict[str, StrokeReport]:
        """Name of a job → the entry of an equal stroke whose signal is there, byte for byte as it was written. Of
        several equal ones a job gets that of its own name. folder: None = there is none."""
        if folder is None:
            return {}
        by_key = {stroke.key: stroke for stroke in self.strokes}
        named = {(stroke.key, stroke.name): stroke for stroke in self.strokes}
        known = {job.name: named.get((job.key, job.name), by_key.get(job.key)) for job in jobs}
        return {name: entry for name, entry in known.items() if entry is not None and _is_there(entry, folder)}

    def has_name(self, name: str) -> bool:
        return any(stroke.name == name for stroke in self.strokes)

    def is_of(self, jobs: Iterable[Job], source: str) -> bool:
        """Was its .blend made from this source, with these strokes and no others?"""
        mine = {(stroke.key, stroke.name) for stroke in self.strokes}
        return self.source == source != "" and mine == {(job.key, job.name) for job in jobs}


def earlier_run(folder: Path | None) -> Earlier:
    """Of the report in folder; nothing where there is none, or it cannot be read."""
    if folder is None:
        return Earlier()
    try:
        record = json.loads((folder / REPORT_NAME).read_text(encoding="utf-8"))
        if record["schema"] != SCHEMA:
            return Earlier()
        return Earlier(
            tuple(StrokeReport(**entry) for entry in record["strokes"]),
            str(record["scene"]),
            str(record.get("source", "")),
            tuple(map(str, record.get("left_over", ()))),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return Earlier()


def left_over(
    earlier: Earlier, folder: Path, scene: str, strokes: Iterable[StrokeReport], awaited: Collection[str] = ()
) -> list[str]:
    """Names of files in folder that an earlier run of this scene left and none of its strokes owns now. strokes: of
    this run. awaited: names of strokes that it has not made yet, or cannot: theirs are not given up."""
    if earlier.scene != scene:
        return []
    now = list(strokes)
    keys, owned = {stroke.key for stroke in now}, {name for stroke in now for name in _files(stroke)}
    gone = [each for each in earlier.strokes if each.key not in keys and each.name not in awaited]
    named = {*earlier.left_over, *(name for stroke in gone for name in _files(stroke))}
    kept = {name for stroke in earlier.strokes if stroke.name in awaited for name in _files(stroke)}
    return sorted(name for name in named - owned - kept if Path(name).name == name and (folder / name).is_file())


def _files(stroke: StrokeReport) -> tuple[str, str]:
    return stroke.wav, stroke.picture


def _is_there(known: StrokeReport, folder: Path) -> bool:
    if Path(known.wav).name != known.wav:
        return False
    try:
        return content_hash((folder / known.wav).read_bytes()) == known.wav_hash and (folder / known.picture).is_file()
    except OSError:
        return False
