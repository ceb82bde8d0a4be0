"""Notes of an import: made-up values, assumptions, and losses of the earlier export."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_signals import ENVELOPES, OPTIONS, WORDS, texture
from test_export_cli import hnf

from hnf_core.export.convert import import_signal
from hnf_core.export.fidelity import describe_sidecar_loss
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ImportOptions
from hnf_core.export.wav import write_wav
from hnf_core.signal import Signal

RENDERED = (*ENVELOPES, "android")
PLAIN = ImportOptions(full_scale_m_s2=10.0, range_hz=(50.0, 250.0))
LATE = [{"time": 0.5, "amplitude": 0.5}, {"time": 1.0, "amplitude": 0.5}]


@pytest.fixture
def wav(tmp_path: Path) -> Path:
    write_wav(tmp_path / "in.wav", texture(0.4))
    return tmp_path / "in.wav"


def haptic(amplitude: Any, **frequency: Any) -> dict[str, Any]:
    return {"version": {"major": 1}, "signals": {"continuous": {"envelopes": {"amplitude": amplitude, **frequency}}}}


def event(kind: str, *given: str, **more: Any) -> dict[str, Any]:
    parameters = [{"ParameterID": name, "ParameterValue": 0.3} for name in given]
    return {"Event": {"Time": 0.0, "EventType": kind, "EventParameters": parameters, **more}}


@pytest.mark.parametrize(
    ("name", "record", "why"),
    [
        ("x.haptic", haptic(LATE[1:]), "150 Hz, the middle of the range, since the file gives no frequency"),
        ("x.haptic", haptic(LATE, frequency=[]), "a strength of 5 m/s² before the first point, at 0.5 s"),
        ("x.json", {"timings": [50], "amplitudes": [9]}, "150 Hz, the middle of the range"),
        (
            "x.ahap",
            {"Pattern": [
                {"Event": {"Time": 0.0, "EventType": "HapticTransient"}},
                event("HapticContinuous", "HapticIntensity", "HapticSharpness", EventDuration=1.0),
                event("HapticContinuous", "HapticIntensity", EventDuration=1.0),
            ]},
            "an intensity of 1 for 1 of 3 events; a sharpness of 0.5 for 2 of 3 events",
        ),
    ],
)  # fmt: skip
def test_what_the_file_leaves_open_is_named(tmp_path: Path, name: str, record: Any, why: str) -> None:
    path = tmp_path / name
    path.write_text(json.dumps(record), "utf-8")
    assert why in import_signal(path, PLAIN).provenance["assumed"]


@pytest.mark.parametrize("word", RENDERED)
def test_a_file_of_this_project_leaves_nothing_open(tmp_path: Path, word: str) -> None:
    """Nor does it pass on what was assumed of the file that its own signal came from."""
    path, told = tmp_path / f"x{FORMATS[word].suffix}", {"assumed": "much", "ignored": "more", "stroke": "rub"}
    FORMATS[word].write(path, Signal(texture(0.3).samples, 10_000.0, 1, told), OPTIONS)
    again = import_signal(path, PLAIN).provenance
    assert (again.get("assumed"), again.get("ignored"), again["stroke"]) == (None, None, "rub")


@pytest.mark.parametrize("word", WORDS)
def test_what_holds_no_samples_brings_none_in(
    tmp_path: Path, wav: Path, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A WAV that was just rendered equals itself: that says nothing of the file it was rendered from."""
    out, rendered = tmp_path / f"x{FORMATS[word].suffix}", word in RENDERED
    assert hnf("export", wav, "--format", word, "--out", out) == 0
    capsys.readouterr()
    assert hnf("import", out, "--out", tmp_path / "y.wav", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["loss"]["exact"] == (not rendered)
    assert record["waveform"] == ("made up" if rendered else "as stored")
    assert hnf("import", out, "--out", tmp_path / "y.wav") == 0
    shown = capsys.readouterr().out
    assert ("is made up" in shown) == rendered
    assert ("Every sample reads back" in shown) == (not rendered)


def test_export_losses_are_reported_if_the_sidecar_still_matches(
    tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = tmp_path / "x.haptic", ("import", tmp_path / "x.haptic", "--out", tmp_path / "y.wav")
    assert hnf("export", wav, "--format", "haptic", "--out", out, "--json") == 0
    lost = json.loads(capsys.readouterr().out)["loss"]
    assert hnf(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["export_loss"] == lost
    assert hnf(*words) == 0
    lines = capsys.readouterr().out.splitlines()
    peak = 20.0 * np.log10(lost["after"]["peak"] / lost["before"]["peak"])
    (told,) = (line for line in lines if "x.haptic.json" in line)
    assert told.endswith(f"the peak by {peak:+.1f} dB. It says:")
    assert lines[lines.index(told) + 1] == f"- {lost['dropped'][0]}"
    out.write_text(out.read_text("utf-8") + "\n", "utf-8")
    assert hnf(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["export_loss"] is None


def test_a_gain_is_no_loss_and_what_stayed_is_no_change(
    tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.wav"
    assert hnf("export", wav, "--format", "listen", "--out", out) == 0
    capsys.readouterr()
    assert hnf("import", out, "--out", tmp_path / "y.wav") == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("- Of its export, x.wav.json says:")
    assert lines[at + 1].startswith("- One gain for the whole file")


@pytest.mark.parametrize(
    ("rms", "peak", "words"),
    [
        (0.5, 0.5, "changed the level by -6.0 dB and the peak by -6.0 dB. It says:"),
        (1.001, 0.5, "changed the peak by -6.0 dB. It says:"),
        (0.5, 0.999, "changed the level by -6.0 dB. It says:"),
        (1.001, 0.999, "Of its export, x.json says:"),
        (0.0, 0.0, "Of its export, x.json says:"),
    ],
)
def test_only_what_changed_is_told_as_changed(rms: float, peak: float, words: str) -> None:
    levels = {"before": {"rms": 1.0, "peak": 1.0}, "after": {"rms": rms, "peak": peak}}
    head, *rest = describe_sidecar_loss({"exact": False, **levels, "dropped": ["Its seed."]}, "x.json")
    assert head.endswith(words)
    assert rest == ["Its seed."]


@pytest.mark.parametrize("loss", [3, {}, {"exact": 1}, {"exact": False, "before": {"rms": "x"}}, {"exact": False}])
def test_a_damaged_sidecar_tells_nothing(
    tmp_path: Path, wav: Path, loss: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.haptic"
    assert hnf("export", wav, "--format", "haptic", "--out", out) == 0
    beside = tmp_path / "x.haptic.json"
    beside.write_text(json.dumps(json.loads(beside.read_text("utf-8")) | {"loss": loss}), "utf-8")
    capsys.readouterr()
    assert hnf("import", out, "--out", tmp_path / "y.wav") == 0
    assert "x.haptic.json" not in capsys.readouterr().out
