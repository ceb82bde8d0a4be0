"""Corpus of models: every outcome is told from a run's own words and files, and real models go through."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hnf_core.errors import FileError
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ExportOptions
from hnf_core.signal import Signal
from hnf_lab.evaluation.corpus import find_models, format_corpus, judge_run, measure_corpus, measure_wav

RATE = 1000


def write_run(folder: Path, *strokes: np.ndarray, skipped=(), failed=()) -> Path:
    """Write a report.json with strokes of these samples [m/s²]."""
    folder.mkdir(parents=True)
    entries = []
    for number, samples in enumerate(strokes):
        signal = Signal(samples.astype(np.float32), float(RATE), 0, {})
        FORMATS["wav"].write(folder / f"{number}.wav", signal, ExportOptions())
        entries.append({"name": f"stroke {number}", "wav": f"{number}.wav"})
    report = {"strokes": entries, "skipped": list(skipped), "failed": list(failed)}
    (folder / "report.json").write_text(json.dumps(report))
    return folder


def tone(rms: float, silent: float = 0.0) -> np.ndarray:
    samples = np.sqrt(2.0) * rms * np.sin(2.0 * np.pi * 100.0 * np.arange(RATE) / RATE + 0.1)
    samples[: round(silent * RATE)] = 0.0
    return samples


@pytest.mark.parametrize(
    ("code", "errors", "kind", "why"),
    [
        (1, "note: it is large.\nhnf: a.glb: is glTF 1.0. Convert it.\n", "refused", "a.glb: is glTF 1.0. Convert it."),
        (1, "Traceback (most recent call last):\n  …\nKeyError: 'a'\n", "at fault", "a traceback: KeyError"),
        (-11, "", "at fault", "killed by signal 11"),
        (None, "", "out of time", ""),
        (0, "", "at fault", "exit code 0 and 0 lines: no word"),
        (1, "one line\nanother line\n", "at fault", "2 lines"),
    ],
)
def test_runs_without_a_report(tmp_path: Path, code, errors: str, kind: str, why: str) -> None:
    found = judge_run("a.glb", tmp_path, code, errors, 1.0)
    assert found.kind == kind
    assert why in found.why


def test_silence_and_level_are_measured_and_need_a_line(tmp_path: Path) -> None:
    silence, rms = measure_wav(write_run(tmp_path / "one", tone(2.0, silent=0.2)) / "0.wav")
    assert (silence, rms) == (pytest.approx(0.2), pytest.approx(2.0 * 0.8**0.5, rel=1e-3))
    folder = write_run(tmp_path / "two", tone(2.0), tone(3.0, silent=0.06), skipped=[{"name": "Text", "why": "empty"}])
    found = judge_run("a.glb", folder, 0, "", 1.0)
    assert (found.kind, found.strokes, found.skipped) == ("at fault", 2, ["Text: empty"])
    assert "stroke 1: silent for 6%" in found.why
    assert found.rms_m_s2 == pytest.approx(3.0 * 0.94**0.5, rel=1e-2)
    told = judge_run("a.glb", folder, 1, "hnf: stroke 'stroke 1': for 6% of its time it is silent.", 1.0)
    assert (told.kind, told.why) == ("touched", "")
    loud = judge_run("a.glb", write_run(tmp_path / "loud", tone(150.0)), 0, "", 1.0)
    assert (loud.kind, loud.why) == ("at fault", "stroke 0: 150 m/s² RMS")
    none = judge_run("a.glb", write_run(tmp_path / "none", failed=[{"why": "no light"}]), 1, "hnf: no light", 1.0)
    assert (none.kind, none.why) == ("refused", "no light")


def test_models_are_found_and_each_is_run_once(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    for name in ("b.glb", "deep/a.OBJ", "deep/meta.json", "deep/other.json", ".git/c.glb", "readme.md"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    assert [str(path.relative_to(folder)) for path in find_models(folder)] == ["b.glb", "deep/a.OBJ", "deep/meta.json"]
    ran = []

    def run(words, limit_s):
        ran.append((Path(words[4]).name, limit_s, words[-1]))
        if words[4].endswith("b.glb"):
            write_run(Path(words[6]), tone(1.0))
            return 0, ""
        return 1, f"hnf: {words[4]}: is | damaged. Export it again."

    outcomes = measure_corpus(folder, tmp_path / "out", limit_s=7.0, words=["--seed"], run=run)
    assert ran == [("b.glb", 7.0, "--seed"), ("a.OBJ", 7.0, "--seed"), ("meta.json", 7.0, "--seed")]
    text = format_corpus(outcomes)
    assert text.startswith("# 3 models: 1 touched, 2 refused, 0 out of time, 0 at fault")
    assert "is \\| damaged" in text
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="no model"):
        find_models(tmp_path / "empty")


def test_the_command_touches_a_plate_and_tells_of_the_rest(tmp_path: Path, capsys) -> None:
    pytest.importorskip("bpy")
    from hnf_blender.cli import main

    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "plate.obj").write_text("v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nf 1 2 3 4\n")
    (folder / "old.gltf").write_text('{"asset": {"version": "1.0"}}')
    words = ["eval", "corpus", str(folder), "--out", str(tmp_path / "out"), "--json", "--limit", "200"]
    assert main(words) == 0
    old, plate = json.loads(capsys.readouterr().out)
    assert (old["kind"], plate["kind"]) == ("refused", "touched")
    assert "glTF 1.0" in old["why"]
    assert plate["strokes"] == 1
    assert 0.0 < plate["rms_m_s2"] < 100.0
    assert "| plate.obj | touched | 1 |" in (tmp_path / "out" / "corpus.md").read_text()
    assert main(["eval", "corpus", str(folder / "plate.obj"), "--out", str(tmp_path)]) == 1
