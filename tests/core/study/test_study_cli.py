"""`hnf study`, run as a person does: made, run on a device with keys, interrupted, gone on with, and evaluated."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hatt_files import model_xml
from ptys import needs_pty
from study_builders import write_methods, write_noise

from hnf_core.action.action import read_action_csv
from hnf_core.cli.main import main
from hnf_core.export.wav import read_wav

ROOT = Path(__file__).resolve().parents[3]


def hnf(*words: object) -> int:
    return main(["study", *map(str, words)], lambda _: 0)


@pytest.fixture
def study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Two methods on two stimuli of 50 ms, twice: four trials."""
    methods = [f"--method={name}={folder}" for name, folder in write_methods(tmp_path, ("alpha", "beta")).items()]
    assert hnf("make", tmp_path / "study", *methods, "--question", "Which is softer?") == 0
    told = capsys.readouterr().out
    assert "4 stimuli, 4 trials a participant: Which is softer?" in told
    assert "takes 97 trials of each two methods: 25 participants" in told
    return tmp_path / "study"


def read_rows(study: Path, participant: str) -> list[dict[str, str]]:
    return list(csv.DictReader((study / "responses" / f"{participant}.csv").open(newline="")))


@needs_pty
def test_a_session_goes_on_where_it_stopped(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the virtual device; the input is no terminal, so that a line stands for a key."""
    run = ("run", study, "--participant", "p01", "--to", "virtual")
    monkeypatch.setattr(sys, "stdin", io.StringIO("1\nx\nr\n2\nq\n"))
    assert hnf(*run) == 0
    told = capsys.readouterr().out
    assert told.count("Which is softer?") == 4
    assert "2 trials left" in told
    assert [(row["trial"], row["response"], row["plays"]) for row in read_rows(study, "p01")] == [
        ("1", "first", "1"), ("2", "second", "2"),
    ]  # fmt: skip
    monkeypatch.setattr(sys, "stdin", io.StringIO("1\n"))  # and then it ends
    assert hnf(*run) == 0
    assert "1 trial left" in capsys.readouterr().out
    monkeypatch.setattr(sys, "stdin", io.StringIO("2\n"))
    assert hnf(*run) == 0
    assert "All trials of p01 are done." in capsys.readouterr().out
    rows = read_rows(study, "p01")
    assert [row["trial"] for row in rows] == ["1", "2", "3", "4"]
    assert {row["limited_samples"] for row in rows} == {"0"}
    assert hnf("evaluate", study) == 0
    assert "alpha chosen over beta" in capsys.readouterr().out
    assert hnf("evaluate", study, "--json", "--detect", 75) == 0
    results = json.loads(capsys.readouterr().out)
    assert (results["trials"], results["power"]["trials_needed"], len(results["by_stimulus"])) == (4, 35, 2)


@needs_pty
def test_what_is_too_strong_is_announced_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [write_noise(tmp_path / f"{seed}.wav", seed, rms=20.0) for seed in (1, 2)]
    assert hnf("make", tmp_path / "study", "--pair", *paths, "--repeats", 1) == 0
    capsys.readouterr()

    def run(participant: str, *gain: str) -> tuple[str, int]:
        """What is said, and how many samples were limited."""
        monkeypatch.setattr(sys, "stdin", io.StringIO("1\n"))
        assert hnf("run", tmp_path / "study", "--participant", participant, "--to", "virtual", *gain) == 0
        (row,) = read_rows(tmp_path / "study", participant)
        return capsys.readouterr().err, int(row["limited_samples"])

    told, limited = run("loud")
    assert limited > 0
    fits = re.search(r"--gain (-[\d.]+) fits", told)[1]
    told, fewer = run("fits", f"--gain={fits}")
    assert told == ""
    assert fewer < limited


@needs_pty
def test_a_terminal_takes_single_keys_and_ctrl_c_keeps_the_rest(study: Path) -> None:
    """A real terminal: keys without Enter; keys pressed while a stimulus plays count for nothing."""
    import pty
    import select

    command = "import sys; from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], None))"
    words = ["study", "run", str(study), "--participant", "p02", "--to", "virtual"]
    parent, child = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", command, *words], cwd=ROOT, stdin=child, stdout=child, stderr=child,
        start_new_session=True,
    )  # fmt: skip
    os.close(child)
    shown = ""

    def read_until(text: str) -> None:
        nonlocal shown
        until = time.monotonic() + 120.0
        while text not in shown:
            assert time.monotonic() < until, shown
            if select.select([parent], [], [], 0.1)[0]:
                shown += os.read(parent, 4096).decode("utf-8", "replace")
        shown = shown.partition(text)[2]

    try:
        read_until("first …")
        os.write(parent, b"2")  # too early
        read_until("stop here]")
        os.write(parent, b"1")
        read_until("Trial 2 of 4")
        read_until("stop here]")
        os.kill(process.pid, signal.SIGINT)
        read_until("What was finished before is kept.")
        assert process.wait(60) == 1
    finally:
        process.kill()
        process.wait(60)
        os.close(parent)
    assert [row["response"] for row in read_rows(study, "p02")] == ["first"]


def test_the_page_is_written(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("page", study, "--out", study / "page.html", "--full-scale", 40) == 0
    assert "stands for 40 m/s²" in capsys.readouterr().out
    assert (study / "page.html").stat().st_size > 10_000


def test_a_key_kept_elsewhere_is_found(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (study / "key.json").rename(study.parent / "away.json")
    assert hnf("evaluate", study) == 1
    assert "--key" in capsys.readouterr().err
    assert hnf("evaluate", study, "--key", study.parent / "away.json") == 1
    assert "no responses yet" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("run", "{study}", "--participant", "../p", "--to", "virtual"), 2, "participant"),
        (("run", "{study}", "--participant", "p", "--to", "file:x.wav"), 2, "nobody feels a file"),
        (("run", "{study}", "--participant", "p", "--to", "moon"), 2, "moon"),
        (("run", "{study}", "--participant", "p", "--to", "virtual", "--gain", "nan"), 2, "gain"),
        (("run", "{study}x", "--participant", "p", "--to", "virtual"), 1, "hnf study make"),
        (("evaluate", "{study}", "--detect", "50"), 1, "no responses yet"),
        (("page", "{study}", "--out", "{study}"), 1, "is a folder"),
        (("make", "{study}", "--method", "a={study}/.."), 2, "two methods"),
        (("make", "{study}x"), 2, "--pair"),
        (("make", "{study}x", "--pair", "a.wav", "b.wav", "--method", "a=b"), 2, "--pair"),
        (("make", "{study}x", "--pair", "a.wav", "b.wav", "--against", "a"), 2, "--against"),
        (("make", "{study}x", "--method", "a"), 2, "NAME=FOLDER"),
        (("make", "{study}x", "--method", "a={study}", "--method", "a={study}"), 2, "two methods are called 'a'"),
        (("make", "{study}x", "--pair", "a.wav", "b.wav", "--detect", "50"), 2, "no number of trials"),
        (("make", "{study}x", "--pair", "a.wav", "b.wav", "--repeats", "0"), 2, "--repeats"),
        (("make", "{study}x", "--pair", "a.wav", "b.wav", "--abx", "--reference", "c.wav"), 2, "--abx"),
        (("stimuli", "{study}x", "--recordings", "moon", "{study}", "--textures", "a"), 2, "moon"),
        (("stimuli", "{study}x", "--recordings", "own", "{study}", "--textures", "a", "--seconds", "0"), 2, "--seco"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(words, code: int, told: str, study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf(*(word.format(study=study) for word in words)) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("hnf: ")
    assert told in error
    assert not Path(f"{study}x").exists()


def write_own_recording(path: Path) -> None:
    """Three seconds at 5 kHz; the hand moves from the first second on, at 100 mm/s and 1 N."""
    path.parent.mkdir(parents=True)
    time_s, rng = np.arange(15_000) / 5000.0, np.random.default_rng(3)
    speed = np.where(time_s < 1.0, 0.0, 0.1)
    acceleration = rng.normal(0.0, 1.0, len(time_s)) * (time_s >= 1.0)
    table = np.stack([time_s, acceleration, np.full(len(time_s), 1.0), speed], axis=1)
    np.savetxt(path, table, "%.6f", ",", header="time,acceleration,force,speed", comments="")


def test_stimuli_of_a_data_set_are_two_methods_of_one_stroke(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_own_recording(tmp_path / "own" / "cork" / "1.csv")
    words = ("--recordings", "own", tmp_path / "own", "--textures", "cork=cork", "--seconds", 1)
    assert hnf("stimuli", tmp_path / "in", *words) == 0
    recorded, ours = (read_wav(tmp_path / "in" / name / "cork.wav") for name in ("recorded", "ours"))
    assert len(recorded.samples) == len(ours.samples) == 10_000
    assert recorded.rms == pytest.approx(1.0, rel=0.1)
    assert ours.rms > 0.0
    action = read_action_csv(tmp_path / "in" / "actions" / "cork.csv")
    assert action.duration_s == pytest.approx(1.25)
    assert action.speed.mean() == pytest.approx(0.1, rel=0.05)
    assert action.force.mean() == pytest.approx(1.0, rel=0.05)
    methods = [f"--method={name}={tmp_path / 'in' / name}" for name in ("recorded", "ours")]
    assert hnf("make", tmp_path / "study", *methods, "--match-level") == 0
    assert hnf("stimuli", tmp_path / "in", *words[:-1], 30) == 2
    assert "lasts 30.25 s" in capsys.readouterr().err


def test_a_model_stands_for_a_texture_without_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hatt").mkdir()
    (tmp_path / "hatt" / "Models_Cork.xml").write_text(model_xml())
    words = ("--recordings", "hatt", tmp_path / "hatt", "--textures", "Cork", "--seconds", 1)
    assert hnf("stimuli", tmp_path / "in", *words) == 0
    assert "Cork: there are no recordings, so the data set's model stands for them" in capsys.readouterr().err
    assert read_wav(tmp_path / "in" / "recorded" / "cork.wav").rms > 0.0
