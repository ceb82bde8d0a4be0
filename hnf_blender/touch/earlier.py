"""What an earlier run left in a folder: the strokes that are still true, and the files that nothing owns any more."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from hnf_core.files import content_hash

from .jobs import Job
from .report import REPORT_NAME, SCHEMA, StrokeReport


class Again(StrEnum):
    """What is not as an earlier run left it: nothing, its .blend, which is not there or was never saved, the scene's
    file, or which strokes there are."""

    NOTHING = ""
    UNFINISHED = "unfinished"
    CHANGED = "changed"
    STROKES = "strokes"


@dataclass(frozen=True)
class Earlier:
    """An earlier run by its report. scene: name of its file. source: hash of what its .blend was made from, "" = it has
    none, or does not say. left_over: files that no stroke owned even then."""

    strokes: tuple[StrokeReport, ...] = ()
    scene: str = ""
    source: str = ""
    left_over: tuple[str, ...] = ()

    def fresh(self, jobs: Iterable[Job], folder: Path | None) -> dict[str, StrokeReport]:
        """Name of a job → the entry of an equal stroke whose signal is there, byte for byte as it was written. A job
        gets that of its own name, else one that no other takes, as after a rename: each file is one stroke's alone, or
        the picture of one would be drawn over the other's. folder: None = there is none."""
        if folder is None:
            return {}
        jobs, there = list(jobs), [each for each in _apart(self.strokes) if _is_there(each, folder)]
        named = {(entry.key, entry.name): entry for entry in there}
        fresh = {job.name: named[job.key, job.name] for job in jobs if (job.key, job.name) in named}
        owned = {entry.name for entry in fresh.values()}
        free = [entry for entry in there if entry.name not in owned]
        for job in jobs:
            entry = next((each for each in free if each.key == job.key), None)
            if job.name not in fresh and entry is not None:
                fresh[job.name] = entry
                free.remove(entry)
        return fresh

    def has_name(self, name: str) -> bool:
        return any(stroke.name == name for stroke in self.strokes)

    def why_again(self, jobs: Iterable[Job], source: str, blend: Path) -> Again:
        """Why its .blend cannot stay: NOTHING where it was made from this source, with these strokes and no others."""
        if self.source == "" or not blend.is_file():
            return Again.UNFINISHED
        if self.source != source:
            return Again.CHANGED
        mine = {(stroke.key, stroke.name) for stroke in self.strokes}
        return Again.NOTHING if mine == {(job.key, job.name) for job in jobs} else Again.STROKES


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
    owned = {name for stroke in strokes for name in _files(stroke)}
    gone = [each for each in earlier.strokes if each.name not in awaited]
    named = {*earlier.left_over, *(name for stroke in gone for name in _files(stroke))}
    kept = {name for stroke in earlier.strokes if stroke.name in awaited for name in _files(stroke)}
    return sorted(name for name in named - owned - kept if Path(name).name == name and (folder / name).is_file())


def _apart(strokes: Iterable[StrokeReport]) -> list[StrokeReport]:
    """One entry for each WAV: older versions let equal strokes share one and draw their pictures over each other. The
    first keeps the files, and its picture is drawn anew."""
    entries = list(strokes)
    count = Counter(entry.wav for entry in entries)
    first = {entry.wav: entry for entry in reversed(entries)}
    return [
        replace(entry, picture_key="") if count[entry.wav] > 1 else entry
        for entry in entries
        if first[entry.wav] is entry
    ]


def _files(stroke: StrokeReport) -> tuple[str, str]:
    return stroke.wav, stroke.picture


def _is_there(known: StrokeReport, folder: Path) -> bool:
    if Path(known.wav).name != known.wav:
        return False
    try:
        return content_hash((folder / known.wav).read_bytes()) == known.wav_hash and (folder / known.picture).is_file()
    except OSError:
        return False
