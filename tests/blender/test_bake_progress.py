"""Progress of a bake of several strokes, and its results after a callback cancels or fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, touch

from hnf_blender.touch import report as report_module
from hnf_blender.touch import synthesise
from hnf_blender.touch.baked_stroke import BakedStroke
from hnf_blender.touch.report import Report
from hnf_blender.touch.session import StrokeJob, gather_jobs, make_scene_session
from hnf_blender.touch.synthesise import bake_strokes
from hnf_core.progress import Cancelled, Progress, ProgressBar
from hnf_core.touch_request import TouchQuery

SHORT_M = 0.008
NAMES = ["A", "B", "C"]


@pytest.fixture
def three_strokes() -> None:
    ridge_plate()
    for name in NAMES:
        line_stroke(name, length=SHORT_M)


def bake(folder: Path, progress: Callable[[Progress], None]) -> tuple[Report, list[str]]:
    """Bake the open scene into a report, also if it is stopped; the names of the strokes that were processed."""
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
    report, processed = Report("", 1.0, ""), []

    def on_stroke(job: StrokeJob, baked: BakedStroke, start_stage: Callable[[str], None]) -> None:
        start_stage("synthesis")
        processed.append(job.name)

    try:
        bake_strokes(session, gather_jobs(session).jobs, folder / "cache", report, on_stroke, progress)
    except Cancelled:
        processed.append("cancelled")
    return report, processed


def test_stages_come_in_order_and_end_with_saving(tmp_path, three_strokes) -> None:
    states: list[Progress] = []
    report, processed = bake(tmp_path, states.append)
    assert (report.failed, processed) == ([], NAMES)
    expected = [f"{name}{stage}" for name in NAMES for stage in ("", ": close-ups", ": synthesis")]
    assert list(dict.fromkeys(state.stage for state in states)) == [*expected, "saving"]
    fractions = [state.fraction for state in states]
    assert fractions == sorted(fractions)
    assert {state.total for state in states} == {len(NAMES) + 1}


def test_a_cancelled_bake_keeps_what_is_finished(tmp_path, three_strokes) -> None:
    def cancel_second(state: Progress) -> None:
        if state.stage == "B: close-ups":
            raise Cancelled

    report, processed = bake(tmp_path, cancel_second)
    assert processed == ["A", "cancelled"]
    assert [failed.stroke for failed in report.failed] == ["B", "C"]
    assert all("stopped" in failed.why for failed in report.failed)


def test_an_internal_error_in_one_stroke_spares_the_others(tmp_path, three_strokes, monkeypatch) -> None:
    bake_stroke = synthesise.bake_stroke

    def fail_second(stroke, *arguments, **keywords):
        if stroke.name == "B":
            raise ZeroDivisionError
        return bake_stroke(stroke, *arguments, **keywords)

    monkeypatch.setattr(synthesise, "bake_stroke", fail_second)
    states: list[Progress] = []
    report, processed = bake(tmp_path, states.append)
    assert processed == ["A", "C"]
    assert [failed.stroke for failed in report.failed] == ["B"]
    assert "internal error" in report.failed[0].why
    assert states[-1] == Progress("saving", 3, 4)


def test_the_command_updates_its_report_after_every_stroke(tmp_path, three_strokes, monkeypatch) -> None:
    scene, out, states, written = save_scene(tmp_path / "scene.blend"), tmp_path / "out", [], []

    def show(bar: ProgressBar, state: Progress) -> None:
        states.append(state)
        if state.stage in (*NAMES, "saving"):
            report = out / "report.json"
            written.append(report.read_text().count('"wav_hash"') if report.is_file() else 0)

    monkeypatch.setattr(ProgressBar, "show", show)
    monkeypatch.setattr(report_module, "WRITE_SHARE", np.inf)  # however long the machine takes for a report
    query = TouchQuery(PLATE, (0.01, 0.02))
    code, report = touch(scene, out)
    assert code == 0
    assert written == [0, 1, 2, 3]
    stages = [state.stage for state in states]
    assert stages.index("saving") < stages.index("A: picture")
    assert stages[-1] == "C: picture"  # what is heard is saved before what is seen
    states.clear()
    code, report = touch(scene, tmp_path / "other", "--at", query.name)
    assert code == 0
    assert [(state.stage, state.done, state.total, state.share) for state in states] == [
        (f"probe {query.name}", 0, 1, share) for share in (0.0, 0.0, 1.0)
    ]
    assert len(report["probes"]) == 1
