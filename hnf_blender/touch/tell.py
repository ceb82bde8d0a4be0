"""What a run tells a person at the end: each result in a line, what to be careful of, and where to look, listen and go
on."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

from hnf_core.cli.program import get_command_prefix
from hnf_core.counted import pluralize
from hnf_core.touch_request import TouchRequest

from .options import add_option_hint
from .probe_report import format_query_line
from .report import REPORT_NAME, Report, StrokeReport


def print_summary(report: Report, request: TouchRequest) -> int:
    """The result for a person, or as JSON; notes and problems go to stderr, one line each. Returns the exit code."""
    folder = request.folder
    if request.as_json:
        print(report.as_json(), end="")
    else:
        for entry in report.probes:
            print(f"{format_query_line(entry)} → {folder / (entry['tactile_map'] or {}).get('picture', REPORT_NAME)}")
        for stroke in () if request.has_only_queries else report.strokes:
            print(format_stroke_line(stroke, folder))
    sys.stdout.flush()  # else the notes would come before what they are about
    if report.left_over:
        print(
            f"note: {', '.join(report.left_over)}: left by an earlier run, and of no stroke of this one. Nothing reads "
            "them; delete them if you do not need them.",
            file=sys.stderr,
        )
    for warning in report.warnings:
        print(f"note: {add_option_hint(warning)}", file=sys.stderr)
    for failed in report.failed:
        print(f"hnf: {failed.why}", file=sys.stderr)
    if not request.as_json:
        sys.stderr.flush()
        for line in format_closing(report, folder, with_strokes=not request.has_only_queries):
            print(line)
    return 1 if report.failed else 0


def format_stroke_line(stroke: StrokeReport, folder: Path) -> str:
    """One stroke in one line."""
    state = "  (up to date)" if stroke.fresh else ""
    return (
        f"{stroke.name}: {stroke.library_material}, {stroke.confidence:.0%} confidence, {stroke.duration_s:.2f} s, "
        f"{stroke.rms_m_s2:.3g} m/s² RMS → {folder / stroke.wav}{state}"
    )


def format_closing(report: Report, folder: Path, *, with_strokes: bool = True) -> list[str]:
    """What there is now, and what to do with it; nothing where nothing came of the run."""
    strokes = report.strokes if with_strokes else []
    if not strokes and not report.probes:
        return []
    things = [pluralize(len(strokes), "stroke")] if strokes else []
    things += [pluralize(len(report.probes), "place")] if report.probes else []
    lines = [f"Done: {' and '.join(things)} in {folder}. {_format_work(report)}"]
    lines += [f"  {head:<8} {text}" for head, text in _iter_next_steps(report, strokes, folder)]
    return lines


def _format_work(report: Report) -> str:
    """What it took, where that says something to a person; the counts stand in the report."""
    if report.counts.renders:
        return f"It took {pluralize(report.counts.renders, 'rendered image')}."
    if report.strokes and all(stroke.fresh for stroke in report.strokes):
        return "Nothing had changed, so that nothing was made again."
    return "Nothing had to be rendered."


def _iter_next_steps(report: Report, strokes: list[StrokeReport], folder: Path) -> Iterator[tuple[str, str]]:
    if strokes:
        loudest = max(strokes, key=lambda stroke: stroke.rms_m_s2)
        wav, ears = folder / loudest.wav, folder / f"{Path(loudest.wav).stem}-listen.wav"
        yield "Look at", str(folder / loudest.picture)
        yield (
            "Listen",
            shlex.join([*get_command_prefix(), "export", str(wav), "--format", "listen", "--out", str(ears)]),
        )
        if report.baked_blend:
            yield "Open", f"{folder / report.baked_blend} in Blender: the strokes are curves that you can edit"
    yield "Read", f"{folder / REPORT_NAME}: every figure"
