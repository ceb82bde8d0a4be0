"""`hnf export` and `hnf import`, by their words."""

from __future__ import annotations

import json
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_signals import FACTS, WORDS, texture, tone

from hnf_core.cli.main import main
from hnf_core.export.formats import FORMATS
from hnf_core.export.wav import read_wav, write_wav
from hnf_core.metrics.spectra import OCTAVE_EDGES_HZ


def hnf(*words: Any) -> int:
    def no_blender(arguments: Any) -> int:
        raise AssertionError("this needs no Blender")

    return main([str(word) for word in words], no_blender)


@pytest.fixture
def wav(tmp_path: Path) -> Path:
    write_wav(tmp_path / "in.wav", texture(0.4))
    return tmp_path / "in.wav"


@pytest.mark.parametrize("word", WORDS)
def test_out_and_in_again(tmp_path: Path, wav: Path, word: str, capsys: pytest.CaptureFixture[str]) -> None:
    out, again = tmp_path / f"out{FORMATS[word].suffix}", tmp_path / "again.wav"
    assert hnf("export", wav, "--format", word, "--out", out, "--full-scale", 20, "--json") == 0
    printed = capsys.readouterr()
    record = json.loads(printed.out)
    assert ("have no say" in printed.err) == (not FORMATS[word].scaled)
    assert (record["format"], record["file"]) == (word, str(out))
    assert record["full_scale_m_s2"] == (20.0 if FORMATS[word].scaled else None)
    assert record["loss"]["before"]["duration_s"] == pytest.approx(0.4)
    assert [band["low_hz"] for band in record["loss"]["bands"]] == pytest.approx(list(OCTAVE_EDGES_HZ))
    assert record["loss"]["dropped"] == record["dropped"]
    assert hnf("import", out, "--out", again, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    signal = read_wav(again)
    assert told["rms_m_s2"] == pytest.approx(signal.rms, rel=1e-6)
    assert signal.rms == pytest.approx(texture(0.4).rms, rel=0.05)
    assert signal.duration_s == pytest.approx(0.4)
    assert signal.provenance["stroke"] == FACTS["stroke"]
    assert signal.rms == pytest.approx(record["loss"]["after"]["rms"], rel=0.02)


def test_the_report_is_a_short_table(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("export", wav, "--format", "haptic", "--out", tmp_path / "x.haptic") == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert "1 = 30 m/s²" in lines[0]
    assert [line.split("  ")[0].strip() for line in lines[2:8]] == [
        "duration", "sample rate", "level (RMS)", "peak", "crest factor", "dynamics, 5–95 %",
    ]  # fmt: skip
    assert any(line.startswith("177–354 Hz") for line in lines)
    assert lines[-1].startswith("- ")
    assert len(lines) < 25
    assert max(map(len, lines[1:])) < 125
    assert shown.err == ""


def test_what_came_in_is_told_by_level_and_octave(
    tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf("export", wav, "--format", "ahap", "--out", tmp_path / "x.ahap", "--json") == 0
    left = {band["low_hz"]: band["after_db"] for band in json.loads(capsys.readouterr().out)["loss"]["bands"]}
    assert hnf("import", tmp_path / "x.ahap", "--out", tmp_path / "y.wav", "--json") == 0
    loss = json.loads(capsys.readouterr().out)["loss"]
    assert not loss["exact"]
    came = {band["low_hz"]: band["after_db"] for band in loss["bands"]}
    loudest = max(came, key=lambda low: came[low] or -200.0)
    assert came[loudest] == pytest.approx(left[loudest], abs=0.3)
    assert hnf("import", tmp_path / "x.ahap", "--out", tmp_path / "y.wav") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("Rendered from strength and frequency over time, and its waveform is made up: 0.4000 s")
    assert any(line.startswith("- carrier: a sine") for line in lines)
    assert next(line for line in lines if line.startswith("177–354 Hz")).endswith(" dB")


def test_clipping_is_said_on_the_error_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "in.wav", tone(160.0, 50.0))
    assert hnf("export", tmp_path / "in.wav", "--format", "wav8k", "--out", tmp_path / "x.wav") == 0
    shown = capsys.readouterr()
    assert "Clipped: " in shown.out
    assert "--full-scale" in shown.err
    assert "level (RMS)       35.4 m/s²" in shown.out


def test_a_profile_gives_full_scale_and_range(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("export", wav, "--format", "haptic", "--out", tmp_path / "x.haptic", "--json")
    assert hnf(*words, "--profile", "eai-c-mf") == 0
    assert json.loads(capsys.readouterr().out)["range_hz"] == [180.0, 280.0]
    sidecar = tmp_path / "x.haptic.json"
    assert json.loads(sidecar.read_text("utf-8"))["full_scale_assumed"] is True
    assert hnf(*words, "--profile", "eai-c-mf", "--range", 100, 300) == 0
    assert json.loads(capsys.readouterr().out)["range_hz"] == [100.0, 300.0]
    own = tmp_path / "own.json"
    profile = {"schema": 1, "name": "own", "title": "Own", "source": "me", "range_hz": [40, 400], "peak_m_s2": 12}
    own.write_text(json.dumps(profile), "utf-8")
    assert hnf(*words, "--profile", own) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["full_scale_m_s2"], record["range_hz"]) == (12.0, [40.0, 400.0])
    assert "full_scale_assumed" not in json.loads(sidecar.read_text("utf-8"))


def test_the_earlier_file_survives_what_fails(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.haptic"
    assert hnf("export", wav, "--format", "haptic", "--out", out) == 0
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    bad = tmp_path / "x.wav"
    bad.write_bytes(wav.read_bytes()[:-3])
    before["x.wav"] = bad.read_bytes()
    assert hnf("export", bad, "--format", "haptic", "--out", out) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before


def test_what_is_read_is_not_written_over(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = wav.read_bytes()
    link = tmp_path / "link.wav"
    link.symlink_to(wav)
    for out in (wav, link):
        assert hnf("export", wav, "--format", "wav8k", "--out", out) == 2
        assert hnf("import", wav, "--full-scale", 30, "--out", out) == 2
        assert "is the file that is read" in capsys.readouterr().err
    assert wav.read_bytes() == before


def test_a_wav_without_a_unit_is_brought_in_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain, own = tmp_path / "plain.wav", tmp_path / "own.wav"
    data = (8000 * np.sin(np.arange(800) * 0.1)).astype("<i2").tobytes()
    head = b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 1, 8000, 16_000, 2, 16) + b"data" + struct.pack("<I", len(data))
    plain.write_bytes(b"RIFF" + struct.pack("<I", len(head) + len(data)) + head + data)
    words = ("export", "--format", "haptic", "--out", tmp_path / "x.haptic")
    assert hnf(*words, plain) == 1
    assert "hnf import plain.wav --full-scale 30" in capsys.readouterr().err
    assert hnf("import", plain, "--out", own) == 1
    assert hnf("import", plain, "--full-scale", 30, "--out", own) == 0
    assert hnf(*words, own) == 0


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--format", "mp3", "--out", "x"), "there is no format 'mp3'"),
        (
            ("--format", "csv", "--out", "x.csv", "--scene", "x.blend"),
            "no place for --scene. Those that have: hjif, glb",
        ),
        (("--format", "haptic", "--out", "x.haptic", "--full-scale", "-1"), "fits no device"),
        (("--format", "haptic", "--out", "x.haptic", "--full-scale", "nan"), "fits no device"),
        (("--format", "haptic", "--out", "x.haptic", "--range", "500", "50"), "is no range"),
        (("--format", "haptic", "--out", "x.haptic", "--profile", "none"), "there is no actuator 'none'"),
        (("--format", "haptic", "--out", "x.haptic", "--profile", "eai-c-mf", "--full-scale", "3"), "not allowed"),
    ],
)
def test_wrong_words_are_refused(
    tmp_path: Path, wav: Path, words: tuple[str, ...], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf("export", wav, *words) == 2
    assert why in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["in.wav"]


def test_import_refuses_what_it_cannot_do(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("import", tmp_path / "x.mp3", "--out", tmp_path / "y.wav") == 2
    assert hnf("import", wav, "--rate", "2.5", "--out", tmp_path / "y.wav") == 2
    assert hnf("import", wav, "--full-scale", "0", "--out", tmp_path / "y.wav") == 2
    assert hnf("import", tmp_path / "gone.ahap", "--out", tmp_path / "y.wav") == 1
    assert "gone.ahap" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["in.wav"]


def test_seeds_draw_the_carrier_and_rates_are_kept(tmp_path: Path, wav: Path) -> None:
    out = tmp_path / "x.haptic"
    assert hnf("export", wav, "--format", "haptic", "--out", out) == 0
    made = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        path = tmp_path / f"{name}.wav"
        assert hnf("import", out, "--out", path, "--seed", seed, "--rate", 8000) == 0
        made.append(read_wav(path))
    assert made[0].samples.tobytes() == made[1].samples.tobytes() != made[2].samples.tobytes()
    assert (made[0].sample_rate, made[0].seed, made[2].seed) == (8000.0, 1, 2)


def test_other_programs_go_by_the_suffix(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for word in FORMATS:
        assert hnf("export", wav, "--format", word, "--out", tmp_path / f"clip.{word}x") == 2
        assert f"Give --out clip{FORMATS[word].suffix}" in capsys.readouterr().err
    assert hnf("export", wav, "--format", "haptic", "--out", tmp_path / "clip.HAPTIC") == 0
    (tmp_path / "clip.HAPTIC").rename(tmp_path / "clip.txt")
    assert hnf("import", tmp_path / "clip.txt", "--out", tmp_path / "y.wav") == 2
    assert hnf("import", tmp_path / "clip.txt", "--format", "haptic", "--out", tmp_path / "y.mp3") == 2
    assert hnf("import", tmp_path / "clip.txt", "--format", "haptic", "--out", tmp_path / "y.wav") == 0


def test_nobody_chose_full_scale(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("export", wav, "--format", "haptic", "--out", tmp_path / "x.haptic")
    assert hnf(*words) == 0
    assert "--profile" in capsys.readouterr().out
    assert hnf(*words, "--full-scale", 30) == 0
    assert "--profile" not in capsys.readouterr().out


def test_what_is_lossless_is_told_in_a_sentence(tmp_path: Path, wav: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for word in ("wav", "hjif", "csv", "npz"):
        assert hnf("export", wav, "--format", word, "--full-scale", 30, "--out", tmp_path / f"x.{word}") == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[1].startswith("Every sample reads back as it was: ")
        assert all(line.startswith("- ") for line in lines[2:])


@pytest.mark.skipif(os.name == "nt", reason="file names there are no bytes")
@pytest.mark.parametrize("word", WORDS)
def test_names_that_are_no_text_are_written_and_read(tmp_path: Path, word: str) -> None:
    wav, folder = tmp_path / "in.wav", Path(os.fsdecode(os.fsencode(tmp_path) + b"/g\xe9"))
    folder.mkdir()
    name = os.fsdecode(b"rub---left-\xe9")
    signal = replace(texture(0.2), provenance={**FACTS, "stroke": name})
    write_wav(wav, signal)
    out = folder / f"out{FORMATS[word].suffix}"
    assert hnf("export", wav, "--format", word, "--out", out, "--full-scale", 20) == 0
    assert hnf("import", out, "--out", tmp_path / "again.wav") == 0
    assert read_wav(tmp_path / "again.wav").provenance["stroke"].startswith("rub---left-")


def test_a_channel_of_three_is_imported(tmp_path: Path) -> None:
    axes = tmp_path / "axes.wav"
    words = ("synth", "--material", "cork", "--stroke", "left-right-soft", "--axes", "--out", axes)
    assert hnf(*words) == 0
    for channel in (1, 2, 3):
        assert hnf("import", axes, "--channel", channel, "--out", tmp_path / f"{channel}.wav") == 0
    levels = [read_wav(tmp_path / f"{channel}.wav").rms for channel in (1, 2, 3)]
    assert len(set(levels)) == 3
