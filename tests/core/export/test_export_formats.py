"""Laws of every format in the table: round trips, silence, durations, scale, and files that fit their rules.

The rules are written down here a second time, from the published sources that docs/export.md names.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_signals import ENVELOPES, EXACT, FACTS, OPTIONS, WORDS, signal_of, texture, tone
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import FileError
from hnf_core.export.convert import export_signal, import_signal
from hnf_core.export.envelope import compute_envelope
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.export.provenance import get_sidecar_path
from hnf_core.export.wav import read_wav
from hnf_core.metrics.spectra import band_power
from hnf_core.signal import Signal

SAMPLES = hnp.arrays(np.float32, st.integers(2, 1500), elements=st.floats(-40.0, 40.0, width=32))
RATES = st.sampled_from([8000.0, 10_000.0, 44_100.0, 48_000.0])


def out(folder: Path, word: str, name: str = "x") -> Path:
    return folder / f"{name}{FORMATS[word].suffix}"


def back(path: Path, word: str, signal: Signal) -> Signal:
    return import_signal(path, ImportOptions(rate_hz=max(signal.sample_rate, 4000.0), seed=1), FORMATS[word])


def lofelt_accepts(record: dict[str, Any]) -> None:
    """`DataModel::validate` of NiceVibrations, core/datamodel/src/v1.rs, in float32 as it reads."""
    assert record["version"] == {"major": 1, "minor": 0, "patch": 0}
    texts = dict.fromkeys(("editor", "author", "source", "project", "description"), str)
    assert {name: type(value) for name, value in record["metadata"].items()} == {**texts, "tags": list}
    envelopes = record["signals"]["continuous"]["envelopes"]
    assert envelopes["amplitude"]
    for name in ("amplitude", "frequency"):
        times = np.array([point["time"] for point in envelopes[name]], dtype=np.float32)
        values = np.array([point[name] for point in envelopes[name]], dtype=np.float32)
        assert (times >= 0.0).all()
        assert (np.diff(times) > 0.0).all()
        assert (values >= 0.0).all()
        assert (values <= 1.0).all()
    for point in envelopes["amplitude"]:
        if "emphasis" in point:
            assert point["amplitude"] <= point["emphasis"]["amplitude"] <= 1.0
            assert 0.0 <= point["emphasis"]["frequency"] <= 1.0


def apple_accepts(record: dict[str, Any], duration_s: float) -> None:
    """Representing haptic patterns in AHAP files; CHHapticEvent.duration; CHHapticParameterCurve."""
    assert set(record) == {"Version", "Metadata", "Pattern"}
    assert record["Version"] == 1.0
    ends: dict[str, float] = {}
    covered, clicks = 0.0, [e["Event"]["Time"] for e in record["Pattern"] if "Event" in e and len(e["Event"]) == 3]
    for entry in record["Pattern"]:
        ((kind, body),) = entry.items()
        assert body["Time"] >= 0.0
        if kind == "Event":
            for each in body["EventParameters"]:
                assert each["ParameterID"] in ("HapticIntensity", "HapticSharpness")
                assert 0.0 <= each["ParameterValue"] <= 1.0
            if body["EventType"] == "HapticContinuous":
                assert 0.0 < body["EventDuration"] <= 30.0
                if body["Time"] != pytest.approx(covered, abs=1e-6):
                    assert 0.0 < body["Time"] - covered <= 0.0151
                    assert any(covered <= click <= body["Time"] for click in clicks)
                covered = body["Time"] + body["EventDuration"]
            else:
                assert body["EventType"] == "HapticTransient"
                assert "EventDuration" not in body
            continue
        assert kind == "ParameterCurve"
        assert body["ParameterID"] in ("HapticIntensityControl", "HapticSharpnessControl")
        points = body["ParameterCurveControlPoints"]
        assert 1 <= len(points) <= 16
        assert points[0]["Time"] == 0.0
        times = [point["Time"] for point in points]
        assert all(after > before for before, after in pairwise(times))
        assert all(0.0 <= point["ParameterValue"] <= 1.0 for point in points)
        assert body["Time"] == pytest.approx(ends.get(body["ParameterID"], 0.0), abs=2e-6)
        ends[body["ParameterID"]] = body["Time"] + times[-1]
    assert covered == pytest.approx(duration_s, abs=1e-6)
    assert set(ends) == {"HapticIntensityControl", "HapticSharpnessControl"}
    for end in ends.values():
        assert end == pytest.approx(duration_s, abs=3e-6)


def android_accepts(record: dict[str, Any], duration_s: float) -> None:
    """VibrationEffect.createWaveform(long[] timings, int[] amplitudes, int repeat)."""
    assert len(record["timings"]) == len(record["amplitudes"]) > 0
    assert record["repeat"] == -1
    assert all(type(each) is int and each > 0 for each in record["timings"])
    assert all(type(each) is int and 0 <= each <= 255 for each in record["amplitudes"])
    assert sum(record["timings"]) == round(1000.0 * duration_s)


@given(samples=SAMPLES, rate=RATES)
@example(samples=np.eye(1, 231, dtype=np.float32)[0], rate=48_000.0)  # a curve begins between two microseconds
@settings(max_examples=60, deadline=None)
def test_files_fit_their_published_rules(
    samples: np.ndarray, rate: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder, signal = tmp_path_factory.getbasetemp(), signal_of(np.tile(samples, 25), rate)
    for word in ("haptic", "ahap", "android"):
        FORMATS[word].write(out(folder, word), signal, OPTIONS)
    lofelt_accepts(json.loads(out(folder, "haptic").read_text("utf-8")))
    apple_accepts(json.loads(out(folder, "ahap").read_text("utf-8")), signal.duration_s)
    android_accepts(json.loads(out(folder, "android").read_text("utf-8")), signal.duration_s)


def test_long_patterns_are_cut_into_events_of_30_s(tmp_path: Path) -> None:
    signal = signal_of(np.tile(texture(1.0, 4000.0).samples, 65)[: 4000 * 64 + 7], 4000.0)
    path = out(tmp_path, "ahap")
    FORMATS["ahap"].write(path, signal, OPTIONS)
    record = json.loads(path.read_text("utf-8"))
    apple_accepts(record, signal.duration_s)
    lengths = [entry["Event"]["EventDuration"] for entry in record["Pattern"] if "Event" in entry]
    assert lengths == [30.0, 30.0, 4.00175]
    assert len(back(path, "ahap", signal).samples) == len(signal.samples)


@pytest.mark.parametrize("word", EXACT)
@given(samples=SAMPLES, rate=RATES, seed=st.integers(-(2**63), 2**63))
@settings(max_examples=40, deadline=None)
def test_exact_formats_give_back_every_bit(
    word: str, samples: np.ndarray, rate: float, seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    signal, path = signal_of(samples, rate, seed), out(tmp_path_factory.getbasetemp(), word)
    exported = export_signal(signal, FORMATS[word], path, OPTIONS)
    first = path.read_bytes()
    again = back(path, word, signal)
    assert again.samples.tobytes() == signal.samples.tobytes()
    assert (again.sample_rate, again.seed, dict(again.provenance)) == (rate, seed, FACTS)
    export_signal(again, FORMATS[word], path, OPTIONS)
    assert path.read_bytes() == first
    assert exported.loss is not None
    assert {band.change_db for band in exported.loss.bands} <= {0.0, None}


@pytest.mark.parametrize("word", ["wav8k", "wav48k"])
@given(samples=SAMPLES, rate=RATES, full_scale=st.floats(1.0, 400.0))
@settings(max_examples=30, deadline=None)
def test_copies_are_reversible_at_their_own_resolution(
    word: str, samples: np.ndarray, rate: float, full_scale: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path, options = out(tmp_path_factory.getbasetemp(), word), ExportOptions(full_scale)
    FORMATS[word].write(path, signal_of(samples, rate), options)
    first = path.read_bytes()
    again = read_wav(path)
    assert np.abs(again.samples).max(initial=0.0) <= full_scale * (1.0 + 1e-6)
    assert dict(again.provenance) == FACTS
    assert FORMATS[word].write(path, again, options)
    assert path.read_bytes() == first


def test_copies_are_within_half_a_step_where_they_keep_the_rate(tmp_path: Path) -> None:
    signal = texture(0.5, 8000.0)
    FORMATS["wav8k"].write(out(tmp_path, "wav8k"), signal, ExportOptions(30.0))
    again = read_wav(out(tmp_path, "wav8k"))
    assert np.abs(again.samples - signal.samples).max() <= 0.5001 * 30.0 / 32767


@pytest.mark.parametrize("word", ["wav8k", "wav48k"])
def test_scipy_reads_copies_as_16_bit(tmp_path: Path, word: str) -> None:
    wavfile = pytest.importorskip("scipy.io.wavfile")
    FORMATS[word].write(out(tmp_path, word), tone(160.0, 15.0), ExportOptions(30.0))
    rate, samples = wavfile.read(out(tmp_path, word))
    assert rate == {"wav8k": 8000, "wav48k": 48_000}[word]
    assert samples.dtype == np.int16
    assert np.abs(samples).max() == pytest.approx(32767 / 2, rel=2e-3)


def test_numpy_reads_tables_and_arrays(tmp_path: Path) -> None:
    signal = texture(0.1)
    for word in ("csv", "npz"):
        FORMATS[word].write(out(tmp_path, word), signal, OPTIONS)
    rows = np.loadtxt(out(tmp_path, "csv"), delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 0], np.arange(1000) / 10_000.0, atol=1e-12)
    np.testing.assert_array_equal(rows[:, 1].astype(np.float32), signal.samples)
    with np.load(out(tmp_path, "npz"), allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["samples"], signal.samples)


@pytest.mark.parametrize(("word", "highest"), [("wav48k", 4000.0), ("wav8k", 3000.0)])
@pytest.mark.parametrize("rate", [9000.0, 10_000.0, 44_100.0])
def test_copies_keep_the_energy_of_each_band(tmp_path: Path, word: str, highest: float, rate: float) -> None:
    signal = signal_of(3.0 * np.random.default_rng(5).standard_normal(int(rate)), rate)
    FORMATS[word].write(out(tmp_path, word), signal, ExportOptions(100.0))
    again = read_wav(out(tmp_path, word))
    edges = tuple(np.geomspace(10.0, highest, 12))
    change = 10.0 * np.log10(
        band_power(again.samples, again.sample_rate, edges) / band_power(signal.samples, rate, edges)
    )
    assert np.abs(change).max() < 0.1


@pytest.mark.parametrize("word", ENVELOPES)
def test_envelopes_come_back_within_two_errors(tmp_path: Path, word: str) -> None:
    """Export → import → export: rendered on a sine, an envelope is smoothed over 20 ms a second time."""
    signal, path, options = texture(2.0), out(tmp_path, word), ExportOptions(30.0, (60.0, 500.0))
    FORMATS[word].write(path, signal, options)
    once = back(path, word, signal)
    FORMATS[word].write(path, once, options)
    twice = back(path, word, signal)
    first, second = compute_envelope(once, (60.0, 500.0)), compute_envelope(twice, (60.0, 500.0))
    inside = slice(8, -8)
    peak = first.amplitude.max()
    away = np.abs(first.amplitude - second.amplitude)[inside] / peak
    assert np.sqrt(np.mean(np.square(away))) < 0.02
    assert away.max() < 0.12
    heard = first.amplitude > 0.2 * peak
    heard[:8] = heard[-8:] = False
    assert np.abs(first.frequency - second.frequency)[heard].mean() < 0.02 * 440.0
    assert twice.rms == pytest.approx(once.rms, rel=0.03)


@pytest.mark.parametrize("word", [*ENVELOPES, "android"])
@pytest.mark.parametrize("hertz", [70.0, 160.0, 400.0])
def test_a_tone_comes_back_as_that_tone(tmp_path: Path, word: str, hertz: float) -> None:
    signal, path = tone(hertz, 6.0, 1.0), out(tmp_path, word)
    FORMATS[word].write(path, signal, OPTIONS)
    again = back(path, word, signal)
    assert again.rms == pytest.approx(signal.rms, rel=0.03)
    envelope = compute_envelope(again, OPTIONS.range_hz)
    inside = (envelope.time > 0.1) & (envelope.time < 0.9)
    np.testing.assert_allclose(envelope.amplitude[inside], 6.0, rtol=0.03)
    np.testing.assert_allclose(envelope.frequency[inside], hertz, rtol=0.02)


@pytest.mark.parametrize("word", ENVELOPES)
def test_clicks_come_back_as_clicks(tmp_path: Path, word: str) -> None:
    samples = 0.1 * texture(1.5).samples
    for place in (4000, 9000):
        samples[place : place + 10] += 12.0
    signal, path = signal_of(samples), out(tmp_path, word)
    FORMATS[word].write(path, signal, OPTIONS)
    again = back(path, word, signal)
    first, second = (compute_envelope(each, OPTIONS.range_hz).emphases for each in (signal, again))
    assert [mark.time_s for mark in first] == pytest.approx([0.4, 0.9], abs=0.006)
    assert np.abs(again.samples).max() == pytest.approx(max(mark.amplitude for mark in first), rel=0.02)
    loud = np.flatnonzero(np.abs(again.samples) > 6.0) / again.sample_rate
    assert ((np.abs(loud - 0.4) < 0.015) | (np.abs(loud - 0.9) < 0.015)).all()
    assert len(second) in (0, 2)
    words = FORMATS[word].write(path, signal, ExportOptions(10.0))
    assert any(each.startswith("Clipped: 2 values") for each in words)


@pytest.mark.parametrize("word", WORDS)
def test_silence_stays_silence(tmp_path: Path, word: str) -> None:
    signal = signal_of(np.zeros(4321))
    exported = export_signal(signal, FORMATS[word], out(tmp_path, word), OPTIONS)
    again = back(out(tmp_path, word), word, signal)
    assert not again.samples.any()
    assert exported.loss is not None
    assert (exported.loss.after.rms, exported.loss.after.crest_db) == (0.0, None)


@pytest.mark.parametrize("word", WORDS)
@given(count=st.integers(50, 30_000), rate=RATES)
@settings(max_examples=15, deadline=None)
def test_durations_are_kept(word: str, count: int, rate: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    """To a sample; Android's to a millisecond, its unit."""
    signal, path = signal_of(np.tile([3.0, -2.0], count)[:count], rate), out(tmp_path_factory.getbasetemp(), word)
    FORMATS[word].write(path, signal, OPTIONS)
    again = back(path, word, signal)
    close = 0.5e-3 + 1.0 / again.sample_rate if word == "android" else 1.0 / again.sample_rate
    assert abs(again.duration_s - signal.duration_s) <= close


@pytest.mark.parametrize("word", [word for word in WORDS if FORMATS[word].scaled])
@pytest.mark.parametrize("factor", [0.25, 8.0])
def test_a_signal_and_its_full_scale_may_be_scaled_together(tmp_path: Path, word: str, factor: float) -> None:
    signal, one, two = texture(0.6), out(tmp_path, word, "one"), out(tmp_path, word, "two")
    FORMATS[word].write(one, signal, ExportOptions(30.0))
    FORMATS[word].write(two, replace(signal, samples=signal.samples * np.float32(factor)), ExportOptions(30.0 * factor))
    first, second = back(one, word, signal), back(two, word, signal)
    np.testing.assert_allclose(second.samples, factor * first.samples, rtol=1e-5, atol=1e-5 * factor)


@pytest.mark.parametrize("word", ["wav8k", "wav48k", "haptic", "ahap", "android"])
def test_what_exceeds_full_scale_is_clipped_and_said(tmp_path: Path, word: str) -> None:
    signal, path = tone(160.0, 40.0), out(tmp_path, word)
    words = FORMATS[word].write(path, signal, ExportOptions(30.0))
    assert any(each.startswith("Clipped: ") and "30 m/s²" in each for each in words)
    assert np.abs(back(path, word, signal).samples).max() <= 30.0 * (1.0 + 1e-6)
    quiet = FORMATS[word].write(path, tone(160.0, 20.0), ExportOptions(30.0))
    assert not any(each.startswith("Clipped") for each in quiet)


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_and_the_old_file_stays(tmp_path: Path, word: str, bad: float) -> None:
    path = out(tmp_path, word)
    export_signal(tone(), FORMATS[word], path, OPTIONS)
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    samples = tone().samples.copy()
    samples[9] = bad
    with pytest.raises(FileError, match="finite"):
        export_signal(signal_of(samples), FORMATS[word], path, OPTIONS)
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before


@pytest.mark.parametrize("word", WORDS)
def test_equal_signals_give_equal_bytes(tmp_path: Path, word: str) -> None:
    for name in ("one", "two"):
        FORMATS[word].write(out(tmp_path, word, name), texture(0.3), OPTIONS)
    assert out(tmp_path, word, "one").read_bytes() == out(tmp_path, word, "two").read_bytes()


@pytest.mark.parametrize("word", WORDS)
def test_the_sidecar_says_what_numbers_stand_for(tmp_path: Path, word: str) -> None:
    path = out(tmp_path, word)
    export_signal(texture(0.3), FORMATS[word], path, ExportOptions(12.5))
    record = json.loads(get_sidecar_path(path).read_text("utf-8"))
    assert (record["file"], record["format"], record["units"], record["seed"]) == (path.name, word, "m/s^2", 7)
    assert record["provenance"] == FACTS
    assert record.get("full_scale") == (12.5 if FORMATS[word].scaled else None)
    assert len(record["loss"]["bands"]) == 10


def test_origin_travels_inside_the_file_where_it_has_a_place(tmp_path: Path) -> None:
    for word in ("haptic", "ahap", "android"):
        path = out(tmp_path, word)
        FORMATS[word].write(path, texture(0.3), ExportOptions(12.5, (50.0, 400.0)))
        again = import_signal(path, ImportOptions(full_scale_m_s2=99.0))
        assert {name: again.provenance[name] for name in ("stroke", "material", "field")} == {
            name: FACTS[name] for name in ("stroke", "material", "field")
        }
        assert again.provenance["scale"] == "1 = 12.5 m/s², 0 … 1 = 50 … 400 Hz (stated in the file)"


def test_every_format_says_how_it_is_checked(tmp_path: Path) -> None:
    """Of this very file nothing is claimed but that it was read again."""
    for word in WORDS:
        assert len(FORMATS[word].what) > 20
        said = export_signal(texture(0.1), FORMATS[word], out(tmp_path, word), OPTIONS).to_json()["checked"]
        assert said.startswith(
            "This file was read again by hnf. Files of this writer are checked in the tests against "
        )
        assert FORMATS[word].checked in said


@pytest.mark.parametrize("word", sorted({*ENVELOPES, "csv", "hjif"}))
def test_what_could_not_be_read_again_is_not_written(word: str, tmp_path: Path) -> None:
    """An hour is refused at once, by name, and the earlier file stays."""
    path = out(tmp_path, word)
    path.write_text("earlier", encoding="utf-8")
    with pytest.raises(FileError, match=path.name):
        export_signal(signal_of(np.zeros(36_000_000, np.float32)), FORMATS[word], path, OPTIONS)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {path.name: b"earlier"}


@pytest.mark.parametrize("word", ["wav", "hjif", "csv", "npz"])
@pytest.mark.parametrize(("peak", "rate"), [(3.4e38, 10_000.0), (1e-40, 10_000.0), (1.0, 1.0)])
def test_extremes_come_back_to_the_bit(word: str, peak: float, rate: float, tmp_path: Path) -> None:
    samples = (peak * np.sin(0.1 * np.arange(3000))).astype(np.float32)
    exported = export_signal(signal_of(samples, rate), FORMATS[word], out(tmp_path, word), OPTIONS)
    assert exported.loss.exact


@pytest.mark.parametrize("word", WORDS)
@settings(max_examples=25, deadline=None)
@given(
    samples=SAMPLES,
    rate=RATES,
    low=st.floats(1.0, 100.0),
    octaves=st.floats(0.05, 8.0),
    full_scale=st.floats(1e-3, 1e4),
)
@example(  # all of it above a range whose end has many digits
    samples=np.resize(np.float32([9, -9]), 500), rate=48_000.0, low=3.252858289320251, octaves=4.5773, full_scale=30.0
)
def test_what_is_written_can_be_read_whatever_the_scale(
    word: str, samples: np.ndarray, rate: float, low: float, octaves: float, full_scale: float,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    """Or is refused before: no file is left that its own reader does not take."""
    path = out(tmp_path_factory.getbasetemp(), word, "scaled")
    path.unlink(missing_ok=True)
    options = ExportOptions(full_scale, (low, low * 2.0**octaves))
    try:
        export_signal(signal_of(samples, rate), FORMATS[word], path, options)
    except FileError:
        assert not path.exists()
