"""What an earlier run left in a folder: the strokes that are still true, and the files that nothing owns any more."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from hnf_core.files import content_hash

from .jobs import StrokeJob
from .report import REPORT_NAME, SCHEMA, StrokeReport


class RerunReason(StrEnum):
    """What is not as an earlier run left it: nothing, its .blend, which is not there or was never saved, the scene's
    file, or which strokes there are."""

    NOTHING = ""
    UNFINISHED = "unfinished"
    CHANGED = "changed"
    STROKES = "strokes"


@dataclass(frozen=True)
class PreviousRun:
    """An earlier run by its report. scene: name of its file. source: hash of what its .blend was made from, "" = it has
    none, or does not say. left_over: files that no stroke owned even then."""

    strokes: tuple[StrokeReport, ...] = ()
    scene: str = ""
    source: str = ""
    orphaned_files: tuple[str, ...] = ()

    def find_fresh(self, jobs: Iterable[StrokeJob], folder: Path | None) -> dict[str, StrokeReport]:
        """Name of a job → the entry of an equal stroke whose signal is there, byte for byte as it was written. A job
        gets that of its own name, else one that no other takes, as after a rename: each file is one stroke's alone, or
        the picture of one would be drawn over the other's. folder: None = there is none."""
        if folder is None:
            return {}
        jobs, there = list(jobs), [each for each in _separate_shared_wavs(self.strokes) if _is_intact(each, folder)]
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

    def get_rerun_reason(self, jobs: Iterable[StrokeJob], source: str, blend: Path) -> RerunReason:
        """Why its .blend cannot stay: NOTHING where it was made from this source, with these strokes and no others."""
        if self.source == "" or not blend.is_file():
            return RerunReason.UNFINISHED
        if self.source != source:
            return RerunReason.CHANGED
        mine = {(stroke.key, stroke.name) for stroke in self.strokes}
        return RerunReason.NOTHING if mine == {(job.key, job.name) for job in jobs} else RerunReason.STROKES


def read_previous_run(folder: Path | None) -> PreviousRun:
    """Of the report in folder; nothing where there is none, or it cannot be read."""
    if folder is None:
        return PreviousRun()
    try:
        record = json.loads((folder / REPORT_NAME).read_text(encoding="utf-8"))
        if record["schema"] != SCHEMA:
            return PreviousRun()
        return PreviousRun(
            tuple(StrokeReport(**entry) for entry in record["strokes"]),
            str(record["scene"]),
            str(record.get("source", "")),
            tuple(map(str, record.get("left_over", ()))),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return PreviousRun()


def find_orphaned_files(
    previous: PreviousRun, folder: Path, scene: str, strokes: Iterable[StrokeReport], pending: Collection[str] = ()
) -> list[str]:
    """Names of files in folder that an earlier run of this scene left and none of its strokes owns now. strokes: of
    this run. awaited: names of strokes that it has not made yet, or cannot: theirs are not given up."""
    if previous.scene != scene:
        return []
    owned = {name for stroke in strokes for name in _get_file_names(stroke)}
    gone = [each for each in previous.strokes if each.name not in pending]
    named = {*previous.orphaned_files, *(name for stroke in gone for name in _get_file_names(stroke))}
    kept = {name for stroke in previous.strokes if stroke.name in pending for name in _get_file_names(stroke)}
    return sorted(name for name in named - owned - kept if Path(name).name == name and (folder / name).is_file())


def _separate_shared_wavs(strokes: Iterable[StrokeReport]) -> list[StrokeReport]:
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


def _get_file_names(stroke: StrokeReport) -> tuple[str, str]:
    return stroke.wav, stroke.picture


def _is_intact(entry: StrokeReport, folder: Path) -> bool:
    if Path(entry.wav).name != entry.wav:
        return False
    try:
        return content_hash((folder / entry.wav).read_bytes()) == entry.wav_hash and (folder / entry.picture).is_file()
    except OSError:
        return False
