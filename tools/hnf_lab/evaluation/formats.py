"""Convert haptic files from every format to every other and tell what it costs: duration, level and clicks.

Clips are made up, or are the haptic files of a folder. Each is written in a format, then converted to the next as
`hnf export CLIP --format WORD` does; both files are rendered and compared. Of each pair the worst clip counts.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.errors import FileError, HnfError
from hnf_core.export.convert import convert_envelope
from hnf_core.export.formats import FORMATS, SUFFIXES, find_loader
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.export.provenance import EnvelopeFile, is_sidecar
from hnf_core.progress import Progress, ProgressCallback, ignore_progress

WORDS = tuple(word for word, form in FORMATS.items() if form.store is not None)
"""Formats that hold amplitude and frequency over time and are written."""
RATE_HZ = 10_000.0
CLICK_TOLERANCE_S = 5e-3
"""Distance within which a click is the same one [s]."""
POINTS, LEAST_GAP_S = 12, 0.03
"""Most control points of a made-up clip, and the least time between its clicks [s]."""


@dataclass(frozen=True)
class Cell:
    """Cost of converting from one format to another, the worst of all clips.

    Attributes
    ----------
    source, target : str
        Words of the formats.
    clips : int
        Clips that were converted.
    duration_ms : float
        Largest change of the duration [ms].
    level_db : float
        Largest change of the RMS of what the file plays [dB].
    clicks_in, clicks_out : int
        Clicks of all sources, and those of them that are within `CLICK_TOLERANCE_S` in the results.
    refused : list of str
        Clips that could not be converted, with the reason.
    """

    source: str
    target: str
    clips: int
    duration_ms: float
    level_db: float
    clicks_in: int
    clicks_out: int
    refused: list[str]


def make_clips(folder: Path, count: int, seed: int) -> list[Path]:
    """Write made-up `.haptic` files: levels and frequencies at uneven times, with two to four clicks on average."""
    folder.mkdir(parents=True, exist_ok=True)
    random, paths = np.random.default_rng(seed), []
    for number in range(count):
        points = int(random.integers(3, POINTS + 1))
        time = np.cumsum(np.r_[0.0, LEAST_GAP_S + random.exponential(0.1, points - 1)])
        level, tone = random.uniform(0.05, 0.8, points), random.uniform(0.05, 0.95, points)
        rows: list[dict[str, Any]] = [
            {"time": float(at), "amplitude": float(height)} for at, height in zip(time, level, strict=True)
        ]
        for row in rows[1:]:
            if random.random() < 0.5:
                row["emphasis"] = {
                    "amplitude": float(random.uniform(row["amplitude"], 1.0)), "frequency": float(random.random())
                }  # fmt: skip
        tones = [{"time": float(at), "frequency": float(share)} for at, share in zip(time, tone, strict=True)]
        record = {
            "version": {"major": 1, "minor": 0, "patch": 0},
            "signals": {"continuous": {"envelopes": {"amplitude": rows, "frequency": tones}}},
        }
        paths.append(folder / f"clip-{number:03d}.haptic")
        paths[-1].write_text(json.dumps(record), encoding="utf-8")
    return paths


def find_clips(folder: Path) -> list[Path]:
    """Return the haptic files under a folder, sorted; raise FileError if there is none."""
    found = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in SUFFIXES and find_loader(path) and path.is_file() and not is_sidecar(path)
    ]
    if not found:
        raise FileError(
            "holds no haptic file.", where=str(folder), remedy="Give a folder with .haptic, .ahap, .hjif or Android's."
        )
    return found


def measure_formats(
    clips: Sequence[Path],
    words: Sequence[str] = WORDS,
    progress: ProgressCallback = ignore_progress,
) -> list[Cell]:
    """Convert every clip to each format, and from there to each other; return a cell for each pair."""
    cells = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for row, source in enumerate(words):
            written = {path: _convert(path, source, folder / f"{number}-from") for number, path in enumerate(clips)}
            for column, target in enumerate(words):
                progress(Progress(f"{source} to {target}", row * len(words) + column, len(words) ** 2))
                cells.append(_measure_pair(source, target, written, folder))
    return cells


def format_matrix(cells: Sequence[Cell]) -> str:
    """Format the cells as a Markdown table, one row for each format that is converted from."""
    words = tuple(dict.fromkeys(cell.source for cell in cells))
    found = {(cell.source, cell.target): cell for cell in cells}
    lines = [f"| from \\ to | {' | '.join(words)} |", "|---" * (len(words) + 1) + "|"]
    for source in words:
        lines.append(f"| {source} | {' | '.join(_format_cell(found[source, target]) for target in words)} |")
    refused = dict.fromkeys(why for cell in cells for why in cell.refused)
    return "\n".join([*lines, *(["", "Refused:", *(f"* {why}" for why in refused)] if refused else [])])


def to_json(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return the cells as JSON values."""
    return [asdict(cell) for cell in cells]


def _format_cell(cell: Cell) -> str:
    if not cell.clips:
        return "none"
    text = f"{_round_up(cell.duration_ms, 0.1):g} ms; {_round_up(cell.level_db, 0.01):g} dB"
    if not cell.clicks_in:
        return text
    part = f"{cell.clicks_out} of {cell.clicks_in}" if cell.clicks_out else "none"
    kept = "all" if cell.clicks_out == cell.clicks_in else part
    return f"{text}; {kept}"


def _round_up(value: float, step: float) -> float:
    """Round a loss up to a step, but for what is rounding itself; large ones to two digits."""
    if not math.isfinite(value) or value < 1e-3 * step:
        return value if not math.isfinite(value) else 0.0
    digits = max(step, 10.0 ** (math.floor(math.log10(value)) - 1))
    return round(math.ceil(value / digits - 1e-9) * digits, 6)


def _load(path: Path) -> EnvelopeFile:
    load = find_loader(path)
    assert load is not None
    return load(path, ImportOptions(rate_hz=RATE_HZ))


def _convert(source: Path, word: str, stem: Path) -> Path | str:
    """Convert a file to a format; return the new file, or why it was refused."""
    target = stem.with_suffix(FORMATS[word].suffix)
    try:
        clip = _load(source)
        options = ExportOptions(clip.origin.full_scale_m_s2, clip.origin.range_hz)
        convert_envelope(clip, source, FORMATS[word], target, options)
    except HnfError as error:
        return f"{source.name} as {word}: {error}"
    return target


def _measure_pair(source: str, target: str, written: dict[Path, Path | str], folder: Path) -> Cell:
    durations, levels, clicks_in, clicks_out, refused = [0.0], [0.0], 0, 0, []
    clips = 0
    for path, first in written.items():
        second = first if isinstance(first, str) else _convert(first, target, folder / "to")
        if isinstance(first, str) or isinstance(second, str):
            refused.append(str(second))
            continue
        before, after = _load(first), _load(second)
        clips += 1
        durations.append(1e3 * abs(after.envelope.duration_s - before.envelope.duration_s))
        rms = [each.render(RATE_HZ, 0, path.name).rms for each in (before, after)]
        if min(rms) > 0.0:
            levels.append(20.0 * abs(math.log10(rms[1] / rms[0])))
        elif max(rms) > 0.0:
            levels.append(math.inf)
        clicks_in += len(before.envelope.emphases)
        times = [click.time_s for click in after.envelope.emphases]
        clicks_out += _count_preserved([click.time_s for click in before.envelope.emphases], times)
    return Cell(source, target, clips, max(durations), max(levels), clicks_in, clicks_out, refused)


def _count_preserved(before: Sequence[float], after: Sequence[float]) -> int:
    """Count the clicks at times `before` that have one of their own in `after` within `CLICK_TOLERANCE_S`."""
    left, kept = list(after), 0
    for time in before:
        near = min(left, key=lambda each: abs(each - time), default=math.inf)
        if abs(near - time) <= CLICK_TOLERANCE_S:
            left.remove(near)
            kept += 1
    return kept
