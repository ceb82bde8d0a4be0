"""The command `hnf actuators` and actuator profiles as files."""

from __future__ import annotations

import json
import struct
import wave
from pathlib import Path

import numpy as np
import pytest
from responses import of_gains

from hnf_core.actuators.measure.frequency_response import Resonator
from hnf_core.actuators.profile import GENERIC, ActuatorProfile, load_profile, read_profile, write_profile
from hnf_core.cli.main import main
from hnf_core.errors import FileError, UsageError
from hnf_core.export.wav import read_wav, write_wav
from hnf_core.signal import Signal


def no_blender(_arguments: object) -> int:
    raise AssertionError("no scene here")


def hnf(*words: object) -> int:
    return main([str(word) for word in words], no_blender)


def measured_profile() -> ActuatorProfile:
    frequency = np.geomspace(20.0, 900.0, 50)
    response = of_gains(frequency, Resonator(80.0, 0.3, 1.0).evaluate(frequency))
    return ActuatorProfile("mine", "Mine – é", "a test", (25.0, 800.0), 12.5, 0.3, 7.0, response)


def test_the_list_names_profiles_and_the_virtual_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("actuators") == 0
    text = capsys.readouterr().out
    assert "virtual" in text
    assert GENERIC.name in text
    assert hnf("actuators", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert {"devices", "missing", "profiles"} == set(record)
    assert record["profiles"][0]["limits"]["full_scale_m_s2"] == 30.0


def test_the_virtual_actuator_is_measured_and_made_up_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "p.json"
    assert hnf("actuators", "measure", "--to", "virtual", "--seconds", 3, "--out", out, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["resonator"]["resonance_hz"] == pytest.approx(59.55, rel=0.05)
    assert record["largest_error_before_db"] > 9.0
    assert record["largest_error_after_db"] < 1.0
    assert read_profile(out).limits.full_scale_m_s2 == pytest.approx(record["full_scale_m_s2"])


def test_two_files_do_instead_of_a_device(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    played, recorded, out = tmp_path / "s.wav", tmp_path / "r.wav", tmp_path / "p.json"
    assert hnf("actuators", "sweep", "--out", played, "--seconds", 3) == 0
    signal = read_wav(played)
    size = 2 * len(signal.samples)
    gain = Resonator(120.0, 0.2, 0.5).evaluate(np.fft.rfftfreq(size, 1.0 / signal.sample_rate))
    got = np.fft.irfft(np.fft.rfft(signal.samples, size) * gain, size)[: len(signal.samples)]
    write_wav(recorded, Signal(got.astype(np.float32), signal.sample_rate, 0))
    capsys.readouterr()
    assert hnf("actuators", "measure", "--played", played, "--response", recorded, "--out", out, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["resonator"]["resonance_hz"] == pytest.approx(120.0, rel=0.01)
    assert record["largest_error_after_db"] < 1.0
    softly = tmp_path / "soft.wav"
    write_wav(softly, Signal(np.asarray(signal.samples * 0.05, dtype=np.float32), signal.sample_rate, 0))
    assert hnf("actuators", "report", softly, "--profile", out, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["limited_samples_after"] == 0
    bands = report["bands"]
    assert max(abs(band["after_db"]) for band in bands) < 1.0 < max(abs(band["before_db"]) for band in bands)


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--to", "virtual", "--played", "x.wav"),
        ("--played", "x.wav"),
        ("--to", "serial:/dev/null"),
        ("--to", "file:x.wav", "--input", "audio"),
        ("--to", "osc:127.0.0.1:9000", "--input", "audio"),
        ("--to", "virtual", "--level", "7"),
        ("--to", "virtual", "--sensitivity", "-1"),
    ],
)
def test_words_that_do_not_fit_together_are_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    out = tmp_path / "p.json"
    assert hnf("actuators", "measure", *words, "--out", out) == 2
    assert not out.exists()


def test_a_profile_comes_back_as_it_was(tmp_path: Path) -> None:
    path, profile = tmp_path / "p.json", measured_profile()
    write_profile(path, profile)
    found = load_profile(str(path))
    assert (found.name, found.title, found.source, found.range_hz) == ("mine", "Mine – é", "a test", (25.0, 800.0))
    assert (found.peak_m_s2, found.sustained, found.thermal_s) == (12.5, 0.3, 7.0)
    assert found.response is not None
    assert profile.response is not None
    for name in ("frequency_hz", "gain_db", "phase_rad", "coherence"):
        np.testing.assert_allclose(getattr(found.response, name), getattr(profile.response, name), atol=1e-5)
    again = tmp_path / "q.json"
    write_profile(again, found)
    assert again.read_bytes() == path.read_bytes()


def spoilt(**changes: object) -> str:
    record = {"schema": 1, "name": "x", "title": "x", "source": "x", "range_hz": [20, 500], "peak_m_s2": 3}
    return json.dumps(record | changes)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", "nonsense", "[" * 100_000, spoilt(schema=2), spoilt(name=3), spoilt(peak_m_s2="3"),
        spoilt(peak_m_s2=-3), spoilt(peak_m_s2=True), spoilt(range_hz=[500, 20]), spoilt(range_hz=[1, 2, 3]),
        spoilt(surprise=1), spoilt(response={}), spoilt(sustained=float("nan")),
        spoilt(response={"frequency_hz": [1], "gain_db": [1], "phase_rad": [1], "coherence": [1], "delay_s": 0}),
        spoilt(response={"frequency_hz": "12", "gain_db": [1], "phase_rad": [1], "coherence": [1], "delay_s": 0}),
    ],
)  # fmt: skip
def test_what_is_no_profile_is_refused_by_name(text: str, tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=r"p\.json"):
        read_profile(path)


def test_a_missing_or_binary_or_huge_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    with pytest.raises(FileError):
        load_profile(str(path))
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError):
        read_profile(path)
    path.write_bytes(b" " * 5_000_000)
    with pytest.raises(FileError, match="MB"):
        read_profile(path)
    with pytest.raises(UsageError, match=GENERIC.name):
        load_profile("nobody")


def test_a_measured_profile_is_made_up_for_on_the_way_unless_raw(tmp_path: Path) -> None:
    profile, wav = tmp_path / "p.json", tmp_path / "s.wav"
    write_profile(profile, measured_profile())
    time = np.arange(5000) / 10_000.0
    write_wav(wav, Signal(np.sin(2 * np.pi * 40.0 * time).astype(np.float32), 10_000.0, 0))
    levels = {}
    for name, words in {"made up": (), "raw": ("--raw",)}.items():
        out = tmp_path / f"{name}.wav"
        assert hnf("stream", wav, "--to", f"file:{out}", "--profile", profile, *words) == 0
        levels[name] = float(np.sqrt(np.mean(np.square(read_wav(out).samples[2000:4000]))))
    response = measured_profile().response
    assert response is not None
    missing = -float(response.gain_db_at(40.0))
    assert 20.0 * np.log10(levels["made up"] / levels["raw"]) == pytest.approx(missing, abs=0.7)


def test_a_report_tells_only_of_bands_that_were_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tone = np.sin(2.0 * np.pi * 100.0 * np.arange(10_000) / 10_000.0).astype(np.float32)
    write_wav(tmp_path / "tone.wav", Signal(tone, 10_000.0, 0))
    assert hnf("actuators", "report", tmp_path / "tone.wav", "--profile", GENERIC.name, "--json") == 0
    bands = json.loads(capsys.readouterr().out)["bands"]
    (heard,) = (band for band in bands if band["before_db"] is not None)
    assert heard["low_hz"] < 100.0 < heard["high_hz"]
    assert abs(heard["before_db"]) < 0.1


def test_report_and_stream_use_the_same_unit_for_a_unitless_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At rates and lengths where its coil warms: which unit was taken decides what is limited at all."""
    tone = np.rint(32767.0 * np.sin(2.0 * np.pi * 200.0 * np.arange(80_000) / 10_000.0)).astype("<i2")
    with wave.open(str(tmp_path / "one.wav"), "wb") as file:
        file.setparams((1, 2, 10_000, len(tone), "NONE", ""))
        file.writeframes(tone.tobytes())
    assert hnf("stream", tmp_path / "one.wav", "--to", f"file:{tmp_path / 'out.wav'}", "--json") == 0
    played = json.loads(capsys.readouterr().out)
    words = ("actuators", "report", tmp_path / "one.wav", "--profile", GENERIC.name)
    assert hnf(*words, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["limited_samples_before"] == played["limited_samples"] > 1000
    assert told["unit"] == played["unit"] == "without a unit: its 1.0 is played as 30 m/s², full scale"
    assert hnf(*words) == 0
    assert f"one.wav: {told['unit']}, largest 29.9 m/s²" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("largest", "unit"),
    [(0.99, "without a unit: its 1.0 is played as 30 m/s², full scale"), (1.01, "without a unit, taken as m/s²")],
)
def test_which_unit_was_taken_is_told_and_why(
    largest: float, unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """29 dB lie between the two."""
    _float_wav(tmp_path / "x.wav", largest * np.sin(0.1 * np.arange(2000)))
    assert hnf("stream", tmp_path / "x.wav", "--to", f"file:{tmp_path / 'out.wav'}", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["unit"].startswith(unit)
    assert told["peak"] == pytest.approx(largest if largest < 1.0 else largest / 30.0, abs=0.002)
    assert largest < 1.0 or "since it goes beyond 1" in told["unit"]


def test_an_export_marks_the_default_full_scale_as_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "x.wav", Signal(np.sin(0.1 * np.arange(2000)).astype(np.float32), 10_000.0, 0))
    words = ("export", tmp_path / "x.wav", "--format", "haptic", "--out", tmp_path / "x.haptic")
    assert hnf(*words, "--profile", "eai-c-mf") == 0
    assert "1 is 30 m/s², an assumption: 'eai-c-mf' does not state" in capsys.readouterr().out
    for scale, assumed in ((("--profile", "eai-c-mf"), True), ((), True), (("--full-scale", 30), False)):
        assert hnf(*words, *scale, "--json") == 0
        record = json.loads(capsys.readouterr().out)
        assert (record["full_scale_m_s2"], record["full_scale_assumed"]) == (30.0, assumed)


@pytest.mark.parametrize(
    ("samples", "why"),
    [
        (np.zeros(0), "has no samples"),
        (np.zeros(2000), "is silent"),
        (np.array([0.5, -0.5]), "has nothing from 180 to 280 Hz, or is too short (2 samples)"),
        (np.sin(2.0 * np.pi * 0.002 * np.arange(10_000)), "has nothing from 180 to 280 Hz"),
    ],
)
def test_a_report_of_nothing_says_why(
    samples: np.ndarray, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And not a table of dashes. The last one hums at 20 Hz, far below that actuator."""
    write_wav(tmp_path / "x.wav", Signal(samples.astype(np.float32), 10_000.0, 0))
    assert hnf("actuators", "report", tmp_path / "x.wav", "--profile", "eai-c-mf") == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert why in told.err


def _float_wav(path: Path, samples: np.ndarray) -> None:
    """10 kHz, and no word of a unit."""
    data = samples.astype("<f4").tobytes()
    form = struct.pack("<HHIIHH", 3, 1, 10_000, 40_000, 4, 32)
    body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(data)) + data
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)


@pytest.mark.parametrize("words", [("--low", "0"), ("--low", "500", "--high", "100"), ("--sensitivity", "50")])
def test_files_that_do_not_fit_the_words_are_refused(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    played, out = tmp_path / "s.wav", tmp_path / "p.json"
    assert hnf("actuators", "sweep", "--out", played, "--seconds", 1) == 0
    assert hnf("actuators", "measure", "--played", played, "--response", played, "--out", out, *words) == 2
    assert "this is no frequency response" not in capsys.readouterr().err
    assert not out.exists()


def test_a_sensitivity_that_no_actuator_has_writes_no_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    played, recorded, out = tmp_path / "s.wav", tmp_path / "r.wav", tmp_path / "p.json"
    assert hnf("actuators", "sweep", "--out", played, "--seconds", 1) == 0
    counts = np.rint(read_wav(played).samples / 10.0 * 32767.0).astype(np.int16)
    with wave.open(str(recorded), "wb") as file:
        file.setparams((1, 2, 10_000, len(counts), "NONE", ""))
        file.writeframes(counts.tobytes())
    words = ("actuators", "measure", "--played", played, "--response", recorded, "--out", out)
    assert hnf(*words, "--sensitivity", 1e8) == 2
    assert "Check --sensitivity" in capsys.readouterr().err
    assert not out.exists()
    assert hnf(*words, "--sensitivity", 10.0) == 0
    assert read_profile(out).limits.full_scale_m_s2 == pytest.approx(30.0, rel=0.01)
    assert "no resonance in between" in capsys.readouterr().out, "a wire has none"
