"""Haptic files mean the same after any way round: duration, level and clicks of the envelopes they hold."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hjif_rules import check_hjif
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hnf_core.errors import FileError
from hnf_core.export.convert import convert_envelope, import_signal
from hnf_core.export.envelope import EMPHASIS_DURATION_S, Emphasis, Envelope, render_envelope
from hnf_core.export.formats import FORMATS, find_loader
from hnf_core.export.haptic import encode_haptic, load_haptic
from hnf_core.export.options import ExportOptions, ImportOptions

CASES = Path(__file__).parents[4] / "shared" / "cases"
OPTIONS = ImportOptions(30.0)


def rms(signal) -> float:
    return float(np.sqrt(np.mean(np.square(signal.samples.astype(np.float64)))))


def compute_hidden_db(envelope: Envelope, signal) -> float:
    """Return by how much the tone under the clicks can change a level [dB]: an AHAP pauses it there and forgets it."""
    tone = render_envelope(replace(envelope, emphases=()), 10_000, 0).astype(np.float64)
    time = np.arange(len(tone)) / 10_000
    reach_s = 0.5 * EMPHASIS_DURATION_S + 1e-3
    is_hidden = np.any([np.abs(time - click.time_s) < reach_s for click in envelope.emphases] or [time < 0.0], axis=0)
    return float(10 * np.log10(1 + np.sum(tone[is_hidden] ** 2) / np.sum(signal.samples.astype(np.float64) ** 2)))


@st.composite
def haptic_files(draw) -> dict:
    """Return the JSON of a .haptic file: any rising times, levels, emphases and frequencies, as others write them."""
    count = draw(st.integers(2, 12))
    steps = draw(st.lists(st.sampled_from([0.0, 5e-6, 0.003, 0.02, 0.15, 0.4]), min_size=count, max_size=count))
    time = np.cumsum(steps)
    share = st.integers(0, 1000).map(lambda number: number / 1000)
    points = []
    for at in time.tolist():
        point = {"time": at, "amplitude": draw(share)}
        if draw(st.integers(0, 2)) == 0:
            level = draw(st.floats(max(point["amplitude"], 0.05), 1.0))
            point["emphasis"] = {"amplitude": level, "frequency": draw(share)}
        points.append(point)
    tones = [{"time": at, "frequency": draw(share)} for at in time.tolist()] if draw(st.booleans()) else []
    envelopes = {"amplitude": points, "frequency": tones}
    return {"version": {"major": 1, "minor": 0, "patch": 0}, "signals": {"continuous": {"envelopes": envelopes}}}


def make_haptic_file(*points: tuple[float, float, float]) -> dict:
    """Return the JSON of a .haptic file of (time, amplitude, amplitude of the click or 0)."""
    rows = [
        {"time": time, "amplitude": level} | ({"emphasis": {"amplitude": click, "frequency": 0.0}} if click else {})
        for time, level, click in points
    ]
    envelopes = {"amplitude": rows, "frequency": []}
    return {"version": {"major": 1, "minor": 0, "patch": 0}, "signals": {"continuous": {"envelopes": envelopes}}}


SIMULTANEOUS_CLICKS = make_haptic_file((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.02, 0.0, 1.0), (0.02, 0.0, 0.5))
CLICK_AFTER_A_RAMP = make_haptic_file((0.0, 0.0, 0.0), (0.02, 0.728, 0.0), (0.02, 0.0, 0.0), (0.02, 0.0, 0.5))
CLICK_BELOW_A_RISING_TONE = make_haptic_file((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.125), (0.02, 0.628, 0.0))

STEPS_AT_THE_END = make_haptic_file((0.02, 0.001, 0.0), (0.02, 0.001, 0.0), (0.02, 0.0, 0.0))
STEPS_AT_THE_END["signals"]["continuous"]["envelopes"]["frequency"] = [
    {"time": 0.02, "frequency": share} for share in (0.0, 0.001, 0.0)
]


def convert(source: Path, word: str, target: Path):
    clip = find_loader(source)(source, OPTIONS)
    options = ExportOptions(clip.origin.full_scale_m_s2, clip.origin.range_hz)
    return convert_envelope(clip, source, FORMATS[word], target, options)


WAYS = [
    ("ahap", "haptic"),
    ("haptic", "ahap"),
    ("ahap", "ahap", "haptic"),
    ("hjif", "haptic"),
    ("hjif", "ahap"),
    ("ahap", "hjif", "haptic"),
    ("hjif", "hjif", "haptic"),
    ("hjif", "ahap", "hjif"),
]


@settings(max_examples=100, deadline=None)
@example(SIMULTANEOUS_CLICKS, ("ahap", "haptic"))
@example(CLICK_AFTER_A_RAMP, ("ahap", "haptic"))
@example(CLICK_BELOW_A_RISING_TONE, ("ahap", "haptic"))
@example(SIMULTANEOUS_CLICKS, ("hjif", "haptic"))
@example(CLICK_AFTER_A_RAMP, ("hjif", "ahap"))
@example(CLICK_BELOW_A_RISING_TONE, ("ahap", "hjif", "haptic"))
@example(STEPS_AT_THE_END, ("hjif", "haptic"))
@example(make_haptic_file((0.0, 0.0, 0.5), (0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.02, 0.156, 0.0)), ("hjif", "ahap"))
@given(haptic_files(), st.sampled_from(WAYS))
def test_clicks_level_and_duration_survive(tmp_path_factory, record, way):
    folder = tmp_path_factory.mktemp("way")
    path = folder / "source.haptic"
    path.write_text(json.dumps(record))
    before = load_haptic(path, OPTIONS)
    if before.envelope.duration_s < 0.02:
        return
    source, first = path, before.render(10_000, 0, "x")
    for number, word in enumerate(way):
        target = folder / f"{number}{FORMATS[word].suffix}"
        convert(source, word, target)
        source = target
    after = find_loader(source)(source, OPTIONS)
    assert after.envelope.duration_s == pytest.approx(before.envelope.duration_s, abs=1e-3)
    level_before, level_after = rms(first), rms(after.render(10_000, 0, "x"))
    # The level of less than a period is a matter of its phase, which no format keeps.
    cycles = before.envelope.duration_s * float(before.envelope.frequency.min())
    if level_before > 0.01 and cycles >= 1.0:
        assert abs(20 * np.log10(level_after / level_before)) < 0.5 + compute_hidden_db(before.envelope, first)
    assert len(after.envelope.emphases) == len(before.envelope.emphases)
    for old, new in zip(before.envelope.emphases, after.envelope.emphases, strict=True):
        assert new.time_s == pytest.approx(old.time_s, abs=5e-3)


@pytest.mark.parametrize("way", [("ahap",), ("hjif",), ("hjif", "ahap"), ("ahap", "hjif")])
def test_levels_and_frequencies_of_clicks(tmp_path, way):
    clicks = tuple(Emphasis(0.1 + 0.05 * index, 3.0 + index, 100.0 + 50.0 * index) for index in range(10))
    envelope = Envelope(np.array([0.0, 1.0]), np.array([2.0, 1.0]), np.array([80.0, 300.0]), clicks)
    refined = Envelope(
        np.unique(np.append(np.linspace(0, 1, 201), [click.time_s for click in clicks])), *(2 * [None]), ()
    )
    time = refined.time
    envelope = Envelope(time, np.interp(time, [0, 1], [2.0, 1.0]), np.interp(time, [0, 1], [80.0, 300.0]), clicks)
    record, _ = encode_haptic(envelope, ExportOptions(30.0, (20.0, 1000.0)))
    (tmp_path / "a.haptic").write_text(json.dumps(record))
    source = tmp_path / "a.haptic"
    for word in way:
        convert(source, word, tmp_path / f"b.{word}")
        source = tmp_path / f"b.{word}"
    found = find_loader(source)(source, OPTIONS).envelope.emphases
    assert len(found) == len(clicks)
    for old, new in zip(clicks, found, strict=True):
        assert abs(20 * np.log10(new.amplitude / old.amplitude)) < 0.1
        assert new.frequency_hz == pytest.approx(old.frequency_hz, rel=0.02)


@pytest.mark.parametrize("word", ["haptic", "ahap"])
@pytest.mark.parametrize("level", [0.3, 1.0])
def test_rendered_clicks_are_found_again(tmp_path, word, level):
    points = [{"time": 0, "amplitude": 0}]
    times = (0.1, 0.4, 0.7, 1.0)
    points += [{"time": at, "amplitude": 0, "emphasis": {"amplitude": level, "frequency": 0.5}} for at in times]
    points.append({"time": 1.2, "amplitude": 0})
    record = {"version": {"major": 1}, "signals": {"continuous": {"envelopes": {"amplitude": points}}}}
    (tmp_path / "taps.haptic").write_text(json.dumps(record))
    signal = import_signal(tmp_path / "taps.haptic", OPTIONS)
    target = tmp_path / f"again{FORMATS[word].suffix}"
    FORMATS[word].write(target, signal, ExportOptions(30.0))
    found = FORMATS[word].load(target, OPTIONS).envelope.emphases
    assert [click.time_s for click in found] == pytest.approx(times, abs=5e-3)
    assert [click.amplitude for click in found] == pytest.approx([30.0 * level] * 4, rel=0.1)


@pytest.mark.parametrize("last", [0.0, 0.299, 0.3])
def test_a_click_at_the_end_is_whole(tmp_path, last):
    points = [{"time": 0.0, "amplitude": 0.1}] if last else []
    points += [{"time": last, "amplitude": 0.1, "emphasis": {"amplitude": 1, "frequency": 0.5}}]
    points += [{"time": max(last + 5e-6, 0.3 if last else 0.0), "amplitude": 0}]
    record = {"version": {"major": 1}, "signals": {"continuous": {"envelopes": {"amplitude": points}}}}
    (tmp_path / "end.haptic").write_text(json.dumps(record))
    signal = import_signal(tmp_path / "end.haptic", OPTIONS)
    assert signal.duration_s == pytest.approx(last + 0.5 * EMPHASIS_DURATION_S, abs=2e-4)
    assert np.abs(signal.samples).max() == pytest.approx(30.0, rel=0.01)


def make_curve(start: float, points: list[tuple[float, float]], origin: float) -> dict:
    rows = [{"Time": origin + at, "ParameterValue": value} for at, value in points]
    curve = {"ParameterID": "HapticIntensityControl", "Time": start, "ParameterCurveControlPoints": rows}
    return {"ParameterCurve": curve}


@given(st.lists(st.floats(0.05, 0.5), min_size=1, max_size=5))
def test_either_origin_of_control_points_means_the_same(tmp_path_factory, lengths):
    folder, edges = tmp_path_factory.mktemp("origin"), np.concatenate([[0.0], np.cumsum(lengths)]).tolist()
    event = {"Time": 0.0, "EventType": "HapticContinuous", "EventDuration": edges[-1], "EventParameters": []}
    read = []
    for name, of_pattern in (("apple", 0.0), ("studio", 1.0)):
        curves = [
            make_curve(start, [(0.0, 0.2), (stop - start, 0.9)], of_pattern * start) for start, stop in pairwise(edges)
        ]
        (folder / f"{name}.ahap").write_text(json.dumps({"Version": 1.0, "Pattern": [{"Event": event}, *curves]}))
        read.append(import_signal(folder / f"{name}.ahap", OPTIONS))
    np.testing.assert_allclose(read[0].samples, read[1].samples, atol=1e-3)
    if len(lengths) > 1:
        assert "from the start of the pattern" in read[1].provenance["assumed"]
        assert "from the start of their curve" in read[0].provenance["assumed"]


def write_json(path: Path, record: dict) -> Path:
    path.write_text(json.dumps(record))
    return path


def test_android_as_programs_call_it(tmp_path):
    default = import_signal(
        write_json(tmp_path / "d.json", {"timings": [0, 100, 50], "amplitudes": [0, -1, 0]}), OPTIONS
    )
    assert np.abs(default.samples).max() == pytest.approx(30.0, rel=1e-2)
    assert "default" in default.provenance["assumed"]
    pattern = import_signal(write_json(tmp_path / "p.json", {"timings": [0, 100, 50, 100], "repeat": -1}), OPTIONS)
    assert pattern.duration_s == pytest.approx(0.25)
    assert not pattern.samples[1010:1490].any()
    assert np.abs(pattern.samples[1510:]).max() > 29
    again = {"timings": [100, 50], "amplitudes": [255, 0], "repeat": 0}
    assert "once" in import_signal(write_json(tmp_path / "r.json", again), OPTIONS).provenance["assumed"]
    with pytest.raises(FileError):
        import_signal(write_json(tmp_path / "x.json", {"timings": [100], "amplitudes": [-0.5]}), OPTIONS)


def test_android_xml_of_every_kind(tmp_path):
    path = tmp_path / "e.xml"
    path.write_text(
        '<vibration-effect><basic-envelope-effect initialSharpness="0.3">'
        '<control-point intensity="0.5" sharpness="0.5" durationMs="100" />'
        '<control-point intensity="0.0" sharpness="0.5" durationMs="100" />'
        "</basic-envelope-effect></vibration-effect>"
    )
    envelope = find_loader(path)(path, OPTIONS).envelope
    assert envelope.duration_s == pytest.approx(0.2)
    assert np.interp(0.05, envelope.time, envelope.amplitude) == pytest.approx(7.5)
    path.write_text(
        '<vibration-effect><waveform-effect><waveform-entry amplitude="default" durationMs="40"/>'
        '<repeating><waveform-entry amplitude="51" durationMs="60"/></repeating></waveform-effect></vibration-effect>'
    )
    clip = find_loader(path)(path, OPTIONS)
    assert clip.envelope.duration_s == pytest.approx(0.1)
    assert "repeating" in clip.facts["assumed"]
    assert np.interp([0.02, 0.08], clip.envelope.time, clip.envelope.amplitude) == pytest.approx([30.0, 6.0])
    path.write_text('<vibration-effect><primitive-effect name="click" scale="0.5" delayMs="100"/></vibration-effect>')
    clicks = find_loader(path)(path, OPTIONS).envelope.emphases
    assert len(clicks) == 1
    assert clicks[0].amplitude == pytest.approx(15.0)
    path.write_text("<other/>")
    with pytest.raises(FileError, match="other"):
        find_loader(path)(path, OPTIONS)


def test_hjif_with_what_the_reference_software_leaves_out(tmp_path):
    frames = [{"relative_position": at, "amplitude_modulation": 0.5, "frequency_modulation": 100} for at in (0, 1000)]
    band = {"band_type": "VectorialWave", "effects": [{"effect_type": "Basis", "position": 0, "keyframes": frames}]}
    channels = [{"bands": [band]}, {"gain": 2.0, "bands": [band]}]
    tree = {"perceptions": [{"perception_modality": "Vibrotactile", "channels": channels[:1]}]}
    signal = import_signal(write_json(tmp_path / "a.hjif", tree), OPTIONS)
    assert signal.duration_s == pytest.approx(1.0, abs=1e-3)
    assert rms(signal) == pytest.approx(10.6, rel=0.01)
    tree["perceptions"][0]["channels"] = channels
    with pytest.raises(FileError, match="--channel"):
        import_signal(write_json(tmp_path / "b.hjif", tree), OPTIONS)
    second = import_signal(tmp_path / "b.hjif", ImportOptions(30.0, channel=2))
    assert rms(second) == pytest.approx(21.2, rel=0.01)
    tree["perceptions"][0] |= {"perception_modality": "Temperature", "channels": channels[:1]}
    with pytest.raises(FileError, match="Temperature"):
        import_signal(write_json(tmp_path / "c.hjif", tree), OPTIONS)


def write_hjif_bands(path: Path, *bands: dict, **channel) -> Path:
    """Write a .hjif of another program, with ticks of 1 ms."""
    perception = {"perception_modality": "Vibrotactile", "channels": [{"bands": list(bands), **channel}]}
    return write_json(path, {"perceptions": [perception]})


def make_hjif_band(kind: str, *keyframes: tuple, start: int = 0, shape: str = "Sine") -> dict:
    """Return a band of one effect; a keyframe is (tick, amplitude or None, frequency or None)."""
    names = ("relative_position", "amplitude_modulation", "frequency_modulation")
    rows = [{name: value for name, value in zip(names, row, strict=False) if value is not None} for row in keyframes]
    effect = {"effect_type": "Basis", "position": start, "base_signal": shape, "keyframes": rows}
    return {"band_type": kind, "effects": [effect]}


WAVE = make_hjif_band("VectorialWave", (0, 0.5, 100), (200, None, 200), (500, 0.25, None), start=100)
TRANSIENTS = make_hjif_band("Transient", (0, 1.0), (400, 0.5, 250), (800, 0.0), start=50)


def test_foreign_hjif_keeps_its_clicks_and_its_tone(tmp_path):
    path = write_hjif_bands(tmp_path / "a.hjif", WAVE, TRANSIENTS)
    clip = find_loader(path)(path, OPTIONS)
    envelope = clip.envelope
    assert [(click.time_s, click.amplitude) for click in envelope.emphases] == [(0.05, 30.0), (0.45, 15.0)]
    assert [click.frequency_hz for click in envelope.emphases] == pytest.approx([90.9, 250.0], rel=1e-3)
    assert np.interp([0.05, 0.35, 0.65], envelope.time, envelope.amplitude) == pytest.approx([0.0, 11.25, 0.0])
    assert np.interp([0.2, 0.5], envelope.time, envelope.frequency) == pytest.approx([150.0, 200.0])
    assert "the file states none" in clip.facts["assumed"]
    for word in ("haptic", "ahap"):
        convert(path, word, tmp_path / f"b.{word}")
        found = FORMATS[word].load(tmp_path / f"b.{word}", OPTIONS).envelope
        assert [click.time_s for click in found.emphases] == pytest.approx([0.05, 0.45], abs=5e-3)
        assert found.duration_s == pytest.approx(envelope.duration_s, abs=1e-3)


@pytest.mark.parametrize(
    "bands",
    [
        [make_hjif_band("Curve", *((at, 0.4 * (-1) ** at) for at in range(600)))],
        [WAVE, make_hjif_band("VectorialWave", (0, 0.5, 80), (600, 0.5, 80))],
        [make_hjif_band("VectorialWave", (0, 0.5, 100), (600, 0.5, 100), shape="Square")],
        [make_hjif_band("VectorialWave", (0, -0.5, 100), (600, 0.5, 100))],
    ],
    ids=["curve", "two at a time", "square", "negative"],
)
def test_what_is_no_single_sine_is_measured_beside_its_clicks(tmp_path, bands):
    path = write_hjif_bands(tmp_path / "a.hjif", *bands, TRANSIENTS, frequency_sampling=10_000)
    clip = find_loader(path)(path, OPTIONS)
    assert "measured" in clip.facts["assumed"]
    times = [click.time_s for click in clip.envelope.emphases]
    assert {0.05, 0.45} <= {round(time, 3) for time in times}
    plain = import_signal(write_hjif_bands(tmp_path / "b.hjif", *bands, frequency_sampling=10_000), OPTIONS)
    tone = render_envelope(replace(clip.envelope, emphases=()), 10_000, 0)
    energies = [float(np.sum(np.square(samples.astype(np.float64)))) for samples in (plain.samples, tone)]
    # The strength never exceeds the peak, so that a square wave comes back as a sine of its height: 3 dB less.
    lost_db = 3.0 if bands[0]["effects"][0]["base_signal"] == "Square" else 0.0
    assert 10 * np.log10(energies[0] / energies[1]) == pytest.approx(lost_db, abs=0.5)


def test_a_hjif_of_clicks_alone_and_one_of_nothing(tmp_path):
    path = write_hjif_bands(tmp_path / "a.hjif", TRANSIENTS)
    clip = find_loader(path)(path, OPTIONS)
    assert not clip.envelope.amplitude.any()
    assert clip.envelope.duration_s == pytest.approx(0.872, abs=2e-3)
    assert len(clip.envelope.emphases) == 2
    result = convert(path, "haptic", tmp_path / "a.haptic")
    assert len(FORMATS["haptic"].load(result.path, OPTIONS).envelope.emphases) == 2
    with pytest.raises(FileError, match="plays nothing"):
        find_loader(path)(write_hjif_bands(path), OPTIONS)


@settings(max_examples=40, deadline=None)
@given(haptic_files(), st.data())
def test_damaged_hjif_is_refused_or_read(tmp_path_factory, record, data):
    folder = tmp_path_factory.mktemp("damage")
    (folder / "a.haptic").write_text(json.dumps(record))
    if load_haptic(folder / "a.haptic", OPTIONS).envelope.duration_s < 0.02:
        return
    path = convert(folder / "a.haptic", "hjif", folder / "a.hjif").path
    check_hjif(json.loads(path.read_text()))
    changed = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.sampled_from(b'0919-.e"{}[],:'))
    path.write_bytes(changed)
    refusal = None
    try:
        clip = find_loader(path)(path, OPTIONS)
    except FileError as error:
        refusal = str(error)
    if refusal is not None:
        assert str(path) in refusal
        assert "\n" not in refusal
    else:
        assert np.isfinite(clip.envelope.amplitude).all()
        assert (np.diff(clip.envelope.time) > 0).all()
        assert clip.envelope.frequency.min() > 0


def test_a_long_hjif_is_of_effects_that_go_on(tmp_path):
    """An effect counts 65,535 ticks; the tone keeps its phase from one to the next."""
    record = make_haptic_file((0.0, 0.5, 0.0), (2.0, 0.5, 1.0), (29.0, 0.5, 1.0), (30.0, 0.5, 0.0))
    (tmp_path / "a.haptic").write_text(json.dumps(record))
    path = convert(tmp_path / "a.haptic", "hjif", tmp_path / "a.hjif").path
    tree = json.loads(path.read_text())
    check_hjif(tree)
    assert len(tree["perceptions"][0]["channels"][0]["bands"][0]["effects"]) > 5
    found = find_loader(path)(path, OPTIONS).envelope
    assert found.amplitude == pytest.approx(np.full(len(found.time), 15.0))
    assert [click.time_s for click in found.emphases] == [2.0, 29.0]
    tone = import_signal(path, OPTIONS).samples[3000:19_000].astype(np.float64)
    expected = 15.0 * np.sin(2.0 * np.pi * 510.0 * np.arange(3000, 19_000) / 10_000)
    np.testing.assert_allclose(tone, expected, atol=0.02)
    later = import_signal(path, OPTIONS).samples[200_000:280_000].astype(np.float64)
    np.testing.assert_allclose(
        later, 15.0 * np.sin(2.0 * np.pi * 510.0 * np.arange(200_000, 280_000) / 10_000), atol=0.1
    )


def test_what_a_click_loses_in_hjif_is_said(tmp_path):
    (tmp_path / "a.haptic").write_text(json.dumps(make_haptic_file((0.0, 0.2, 0.0), (0.1, 0.2, 1.0), (0.3, 0.2, 0.0))))
    result = convert(tmp_path / "a.haptic", "hjif", tmp_path / "a.hjif")
    assert any("two periods of 91 Hz" in sentence for sentence in result.dropped)
    assert not any("clicks: the format has none" in sentence for sentence in result.dropped)
    played = import_signal(tmp_path / "a.hjif", OPTIONS)
    assert np.abs(played.samples).max() == pytest.approx(36.0, rel=0.02)
    high = write_hjif_bands(tmp_path / "b.hjif", make_hjif_band("VectorialWave", (0, 0.5, 900), (500, 0.5, 900)))
    clip = find_loader(high)(high, ImportOptions(30.0, (20.0, 500.0)))
    result = convert_envelope(clip, high, FORMATS["haptic"], tmp_path / "b.haptic", ExportOptions(30.0, (20.0, 500.0)))
    assert any("Frequencies beyond 20 … 500 Hz" in sentence for sentence in result.dropped)


def test_clips_of_other_makers(tmp_path):
    dot = {"startTime": 0, "endTime": 100, "playbackType": "FADE_OUT", "pointList": [{"index": 1, "intensity": 0.5}]}
    path = {
        "playbackType": "NONE",
        "pointList": [{"x": "0", "intensity": "1.0", "time": 0}, {"intensity": 1, "time": 50}],
    }
    modes = {
        "Left": {"mode": "DOT_MODE", "dotMode": {"feedback": [dot]}},
        "Right": {"mode": "PATH_MODE", "pathMode": {"feedback": [path]}},
    }
    tact = {"project": {"tracks": [{"enable": True, "effects": [{"startTime": 200, "modes": modes}]}]}}
    envelope = find_loader(Path("x.tact"))(write_json(tmp_path / "x.tact", tact), OPTIONS).envelope
    assert envelope.duration_s == pytest.approx(0.3)
    assert np.interp([0.1, 0.22, 0.275], envelope.time, envelope.amplitude) == pytest.approx([0.0, 30.0, 3.75])
    keys = [{"m_time": 0, "m_value": 1.0}, {"m_time": 0.5, "m_value": 0.0}]
    hertz = [{"m_time": 0, "m_value": 65.0}, {"m_time": 0.5, "m_value": 165.0}]
    effect = {"m_amplitudeModulation": {"m_keyframes": keys}, "m_frequencyModulation": {"m_keyframes": hertz}}
    notes = [
        {"m_startingPoint": 0.0, "m_length": 0.5, "m_gain": 0.5, "m_hapticEffect": effect},
        {"m_startingPoint": 0.6, "m_length": 0.022, "m_gain": 1.0, "m_hapticEffect": {"m_type": 0}},
    ]
    haps = {"m_vibration": {"m_melodies": [{"m_mute": 0, "m_gain": 1.0, "m_notes": notes}]}, "m_gain": 1.0}
    envelope = find_loader(Path("x.haps"))(write_json(tmp_path / "x.haps", haps), OPTIONS).envelope
    assert np.interp(0.25, envelope.time, envelope.amplitude) == pytest.approx(7.5)
    assert np.interp(0.25, envelope.time, envelope.frequency) == pytest.approx(115.0)
    assert [click.time_s for click in envelope.emphases] == pytest.approx([0.611])


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not at hand")
@pytest.mark.parametrize("name", ["taps.haptic", "taps.ahap"])
def test_case_of_taps(tmp_path, name):
    source = CASES / "clicks-do-not-survive" / name
    for word in ("haptic", "ahap"):
        target = tmp_path / f"t{FORMATS[word].suffix}"
        convert(source, word, target)
        clicks = FORMATS[word].load(target, OPTIONS).envelope.emphases
        assert [click.time_s for click in clicks] == pytest.approx([0.1, 0.4, 0.7, 1.0], abs=5e-3)
        assert [click.amplitude for click in clicks] == pytest.approx([30.0] * 4, rel=0.1)
