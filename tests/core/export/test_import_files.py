"""Import of files of other programs by their rules, with one FileError for any damage."""

from __future__ import annotations

import json
import struct
import tracemalloc
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_signals import ENVELOPES, OPTIONS, WORDS, texture, tone
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import FileError, UsageError
from hnf_core.export.convert import import_signal
from hnf_core.export.envelope import compute_envelope
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ImportOptions
from hnf_core.export.wav import write_wav

TABLE = b"time_s,acceleration_m_s2\n"
TEXTS = (*ENVELOPES, "android", "csv")
PLAIN = ImportOptions(full_scale_m_s2=10.0, range_hz=(50.0, 250.0), seed=3)


def written(folder: Path, word: str, seconds: float = 0.05) -> Path:
    path = folder / f"whole{FORMATS[word].suffix}"
    FORMATS[word].write(path, texture(seconds), OPTIONS)
    return path


def haptic(amplitude: Any, frequency: Any = None, **more: Any) -> dict[str, Any]:
    envelopes = {"amplitude": amplitude} | ({} if frequency is None else {"frequency": frequency})
    return {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "signals": {"continuous": {"envelopes": envelopes}},
        **more,
    }


def event(kind: str = "HapticContinuous", at: float = 0.0, intensity: float = 1.0, **more: Any) -> dict[str, Any]:
    parameters = [
        {"ParameterID": "HapticIntensity", "ParameterValue": intensity},
        {"ParameterID": "HapticSharpness", "ParameterValue": 0.5},
    ]
    return {"Event": {"Time": at, "EventType": kind, "EventParameters": parameters, **more}}


def curve(name: str, at: float, *points: tuple[float, float]) -> dict[str, Any]:
    rows = [{"Time": time, "ParameterValue": value} for time, value in points]
    return {"ParameterCurve": {"ParameterID": name, "Time": at, "ParameterCurveControlPoints": rows}}


def read(folder: Path, name: str, record: Any, options: ImportOptions = PLAIN) -> Any:
    path = folder / name
    path.write_text(json.dumps(record), "utf-8")
    return import_signal(path, options)


def level_at(signal: Any, time: float, range_hz: tuple[float, float] = (50.0, 250.0)) -> tuple[float, float]:
    envelope = compute_envelope(signal, range_hz)
    index = int(np.argmin(np.abs(envelope.time - time)))
    return float(envelope.amplitude[index]), float(envelope.frequency[index])


def test_a_haptic_file_of_another_program(tmp_path: Path) -> None:
    """Without metadata, frequency later than 0, a step (two points at one time), an unknown key: all allowed."""
    points = [(0.0, 0.2), (0.5, 0.2), (0.5, 0.8), (1.0, 0.8)]
    signal = read(
        tmp_path,
        "x.haptic",
        haptic(
            [{"time": time, "amplitude": value} for time, value in points],
            [{"time": 0.2, "frequency": 0.5}, {"time": 0.9, "frequency": 0.5}],
            something="new",
        ),
    )
    assert signal.duration_s == 1.0
    assert level_at(signal, 0.25) == (pytest.approx(2.0, rel=0.02), pytest.approx(150.0, rel=0.01))
    assert level_at(signal, 0.75)[0] == pytest.approx(8.0, rel=0.02)
    assert "the file states none" in signal.provenance["scale"]
    assert signal.seed == 3


def test_an_emphasis_is_heard(tmp_path: Path) -> None:
    points = [{"time": 0.0, "amplitude": 0.1}, {"time": 0.5, "amplitude": 0.1}, {"time": 1.0, "amplitude": 0.1}]
    calm = read(tmp_path, "x.haptic", haptic(points))
    points[1]["emphasis"] = {"amplitude": 0.9, "frequency": 1.0}  # type: ignore[assignment]
    loud = read(tmp_path, "x.haptic", haptic(points))
    assert np.abs(loud.samples).max() == pytest.approx(9.0, rel=0.01)
    away = np.abs(np.arange(len(calm.samples)) / 10_000.0 - 0.5) > 0.01
    np.testing.assert_array_equal(calm.samples[away], loud.samples[away])


def test_curves_of_a_pattern_are_relative_to_their_own_start(tmp_path: Path) -> None:
    """Apple: a control point's time is relative to the start of its curve. Intensity multiplies, sharpness adds."""
    signal = read(
        tmp_path,
        "x.ahap",
        {
            "Version": 1.0,
            "Pattern": [
                event(EventDuration=2.0, intensity=0.8),
                curve("HapticIntensityControl", 1.0, (0.0, 1.0), (0.5, 0.5), (1.0, 0.5)),
                curve("HapticSharpnessControl", 0.0, (0.0, -0.5), (2.0, -0.5)),
            ],
        },
    )
    assert signal.duration_s == 2.0
    assert level_at(signal, 0.5)[0] == pytest.approx(10.0 * 0.8**2, rel=0.02)
    assert level_at(signal, 1.75) == (pytest.approx(10.0 * 0.4**2, rel=0.02), pytest.approx(50.0, rel=0.02))


def test_a_pattern_with_a_pause_clicks_and_strangers(tmp_path: Path) -> None:
    signal = read(
        tmp_path,
        "x.ahap",
        {
            "Version": 1,
            "Metadata": {"Project": "x"},
            "Pattern": [
                event(EventDuration=0.2),
                event(at=0.5, EventDuration=0.2),
                event("HapticTransient", at=0.35, intensity=0.7),
                {"Event": {"Time": 0.0, "EventType": "AudioCustom", "EventWaveformPath": "a.wav"}},
                curve("AudioVolumeControl", 0.0, (0.0, 1.0)),
                {"Parameter": {"ParameterID": "HapticIntensityControl", "ParameterValue": 0.1, "Time": 0.0}},
            ],
        },
    )
    size = np.abs(signal.samples)
    time = np.arange(len(size)) / 10_000.0
    assert signal.duration_s == pytest.approx(0.7)
    assert size[(time > 0.2001) & (time < 0.34)].max() == 0.0
    assert size[(time > 0.34) & (time < 0.36)].max() == pytest.approx(4.9, rel=0.01)
    assert size[(time > 0.5001)].max() == pytest.approx(10.0, rel=0.01)
    assert signal.provenance["ignored"] == "'Parameter'; curves of AudioVolumeControl; events of the type AudioCustom"


def test_an_android_waveform_steps(tmp_path: Path) -> None:
    signal = read(tmp_path, "x.json", {"timings": [100, 0, 50, 100], "amplitudes": [255, 9, 0, 51]})
    assert signal.duration_s == pytest.approx(0.25)
    size = np.abs(signal.samples)
    assert size[:1000].max() == pytest.approx(10.0, rel=0.01)
    assert size[1001:1500].max() == 0.0
    assert size[1501:].max() == pytest.approx(2.0, rel=0.01)
    assert level_at(signal, 0.05)[1] == pytest.approx(150.0, rel=0.02)


def test_a_plain_wav_needs_to_be_told_its_scale(tmp_path: Path) -> None:
    samples = struct.pack("<4h", 0, 16384, -16384, 32767)
    head = b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 1, 8000, 16_000, 2, 16) + b"data" + struct.pack("<I", 8)
    path = tmp_path / "x.wav"
    path.write_bytes(b"RIFF" + struct.pack("<I", len(head) + 8) + head + samples)
    with pytest.raises(FileError, match=r"states no unit.*--full-scale"):
        import_signal(path, ImportOptions())
    np.testing.assert_allclose(import_signal(path, PLAIN).samples, [0.0, 5.0, -5.0, 10.0], rtol=1e-4)
    assert import_signal(path, PLAIN).provenance["scale"] == "1 = 10 m/s² (told)"


def test_a_wav_of_this_project_is_not_scaled(tmp_path: Path) -> None:
    write_wav(tmp_path / "x.wav", tone())
    assert import_signal(tmp_path / "x.wav", PLAIN).samples.tobytes() == tone().samples.tobytes()


def test_a_table_of_another_laboratory(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("﻿time_s, acceleration_m_s2\r\n" + "\r\n".join(f"{i / 3000:.6f},{i}" for i in range(4000)), "utf-8")
    signal = import_signal(path, ImportOptions(seed=5))
    assert (signal.sample_rate, signal.seed, signal.samples[3999]) == (3000.0, 5, 3999.0)


@pytest.mark.parametrize(("first", "last"), [("0", "1e-320"), ("0", "1e-10"), ("0", "1e300"), ("-1.7e308", "1.7e308")])
def test_times_that_are_no_rate_are_refused_in_words(first: str, last: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"time_s,acceleration_m_s2\n{first},1\n{last},2\n")
    with pytest.raises(FileError, match=r"s apart\. Give times in seconds"):
        import_signal(path, ImportOptions())


def test_a_sidecar_of_other_bytes_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("time_s,acceleration_m_s2\n0,1\n0.1,2\n")
    (tmp_path / "x.csv.json").write_text('{"hash": "0", "seed": 9, "provenance": {}}')
    assert import_signal(path, ImportOptions(seed=5)).seed == 5


def test_unknown_suffixes_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"x\.mp3.*\.ahap"):
        import_signal(tmp_path / "x.mp3", PLAIN)


BROKEN_HAPTICS: list[tuple[Any, str]] = [
    ([], "no JSON object"),
    ({}, "'version' is missing"),
    (haptic([]) | {"version": {"major": 2}}, "version 2"),
    (haptic([]) | {"version": {"major": "1"}}, "'major' is no number"),
    (haptic([]) | {"signals": 3}, "'signals' is no object"),
    (haptic([]), "empty"),
    (haptic({}), "'amplitude' is no array"),
    (haptic([{"time": 0.0}]), "'amplitude' is missing"),
    (haptic([{"time": -0.1, "amplitude": 0.5}]), "'time' is -0.1"),
    (haptic([{"time": True, "amplitude": 0.5}]), "'time' is no number"),
    (haptic([{"time": 0.0, "amplitude": 1.5}]), "'amplitude' is 1.5"),
    (haptic([{"time": 0.0, "amplitude": 10**400}]), "beyond all measure"),
    (haptic([3]), "is no object"),
    (haptic([{"time": 1.0, "amplitude": 0.5}, {"time": 0.5, "amplitude": 0.5}]), "fall"),
    (haptic([{"time": 0.0, "amplitude": 0.5, "emphasis": {"amplitude": 0.4, "frequency": 0.1}}]), "weaker"),
    (haptic([{"time": 0.0, "amplitude": 0.5, "emphasis": {"amplitude": 0.6}}]), "'frequency' is missing"),
    (haptic([{"time": 0.0, "amplitude": 0.5, "emphasis": 1}]), "is no object"),
    (haptic([{"time": 0.0, "amplitude": 0.5}], [{"time": 0.0, "frequency": 2}]), "'frequency' is 2"),
    (haptic([{"time": 3e38, "amplitude": 0.5}]), "more than can be rendered"),
    (haptic([{"time": 1e9, "amplitude": 0.5}]), "more than can be rendered"),
]
BROKEN_AHAPS: list[tuple[Any, str]] = [
    ({}, "'Pattern' is missing"),
    ({"Pattern": 1}, "'Pattern' is no array"),
    ({"Pattern": []}, "no haptic event"),
    ({"Pattern": [1]}, "is no object"),
    ({"Pattern": [event()]}, "'EventDuration' is missing"),
    ({"Pattern": [event(EventDuration=31.0)]}, "'EventDuration' is 31"),
    ({"Pattern": [event(EventDuration=-1.0)]}, "'EventDuration' is -1"),
    ({"Pattern": [event(at=1e300, EventDuration=1.0)]}, "'Time' is"),
    ({"Pattern": [event(EventDuration=1.0, EventParameters=[4])]}, "is no object"),
    ({"Pattern": [event(EventDuration=1.0), curve("HapticIntensityControl", 0.0)]}, "no control points"),
    ({"Pattern": [event(EventDuration=1.0), curve("HapticIntensityControl", 0.0, (1, 1), (0, 1))]}, "fall"),
    ({"Pattern": [event(EventDuration=1.0)] * 20_001}, "more than 20000 events"),
]
BROKEN_ANDROIDS: list[tuple[Any, str]] = [
    ({"timings": [1], "amplitudes": [-0.5]}, "lies between -1 and 0"),
    ({"timings": [1, 2], "amplitudes": [1]}, "2 timings and 1 amplitudes"),
    ({"timings": [-1], "amplitudes": [1]}, "'timing' is -1"),
    ({"timings": [1], "amplitudes": [256]}, "'amplitude' is 256"),
    ({"timings": [1], "amplitudes": ["1"]}, "'amplitude' is no number"),
    ({"timings": [0], "amplitudes": [1]}, "all its timings are 0"),
    ({"timings": [10_000_000] * 9, "amplitudes": [1] * 9}, "more than can be rendered"),
    ({"timings": [5], "amplitudes": [1], "repeat": 1}, "'repeat' is 1"),
]


@pytest.mark.parametrize(
    ("name", "record", "why"),
    [
        (name, record, why)
        for name, broken in (("x.haptic", BROKEN_HAPTICS), ("x.ahap", BROKEN_AHAPS), ("x.json", BROKEN_ANDROIDS))
        for record, why in broken
    ],
)
def test_every_breach_is_named(tmp_path: Path, name: str, record: Any, why: str) -> None:
    with pytest.raises(FileError) as caught:
        read(tmp_path, name, record)
    assert why in caught.value.what
    assert caught.value.where.endswith(name)
    assert caught.value.remedy


@pytest.mark.parametrize("word", TEXTS)
@pytest.mark.parametrize(
    "data",
    [
        b"", b"\x00" * 50, b"\xff\xfe{\x00}\x00", b"NaN", b'{"a": NaN}', b'{"a": Infinity}', b"[" * 100_000,
        b'{"a":' * 100_000, b'{"a": ' + b"9" * 6000 + b"}", b"\x80abc", b"null", b"a,b\n1,2\n3,4\n", TABLE,
        TABLE + b"1,nan\n2,3", TABLE + b"1,1\n1,1\n", TABLE + b"1,1\n2,2\n9,3", TABLE + b"1,1,1\n2,2,2\n",
        TABLE + b"1,x\n", TABLE + b"0,1e39\n1,1\n", TABLE + b"0,1\n1,1,1\n",
    ],
)  # fmt: skip
def test_what_is_no_such_file_is_refused(tmp_path: Path, word: str, data: bytes) -> None:
    path = tmp_path / f"x{FORMATS[word].suffix}"
    path.write_bytes(data)
    with pytest.raises(FileError):
        import_signal(path, PLAIN)


@pytest.mark.parametrize("word", WORDS)
def test_every_truncation_is_noticed(tmp_path: Path, word: str) -> None:
    """A CSV cut within a row's last digits, or after one, is still a table."""
    whole = written(tmp_path, word).read_bytes()
    path = tmp_path / f"cut{FORMATS[word].suffix}"
    for cut in range(0, len(whole) - (1 if word in TEXTS else 0), max(1, len(whole) // 300)):
        path.write_bytes(whole[:cut])
        try:
            import_signal(path, PLAIN)
        except FileError:
            continue
        assert word == "csv"


@pytest.mark.parametrize("word", WORDS)
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_damage_gives_a_file_error_or_a_finite_signal(
    word: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.getbasetemp()
    whole = bytearray(written(folder, word, 0.02).read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = folder / f"damaged{FORMATS[word].suffix}"
    path.write_bytes(bytes(whole))
    try:
        signal = import_signal(path, PLAIN)
    except FileError:
        return
    assert np.isfinite(signal.samples).all()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize("word", [*ENVELOPES, "android"])
@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_any_damaged_value_gives_a_file_error_or_finite_signal(
    word: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.getbasetemp()
    record = json.loads(written(folder, word, 0.02).read_text("utf-8"))
    place: Any = record
    while True:
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else list(range(len(place)))))
        if not (isinstance(place[key], dict | list) and place[key]) or data.draw(st.booleans()):
            place[key] = data.draw(JSON)
            break
        place = place[key]
    path = folder / f"odd{FORMATS[word].suffix}"
    path.write_text(json.dumps(record), "utf-8")
    try:
        signal = import_signal(path, PLAIN)
    except FileError:
        return
    assert np.isfinite(signal.samples).all()


def archive(**arrays: bytes) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as made:
        for name, data in arrays.items():
            made.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def npy(head: str, body: bytes = b"") -> bytes:
    text = head.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + body


@pytest.mark.parametrize(
    "samples",
    [
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,), }", bytes(8)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,), }", bytes(8)),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"\x80\x04K\x01."),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }", bytes(8)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }", struct.pack("<2f", 0.0, np.nan)),
        npy("__import__('os')", bytes(8)),
        npy("{'descr': '<f4", bytes(8)),
        npy("{'descr': '<f4', 'shape': 1 / 0}", bytes(8)),
        b"no array",
    ],
)
def test_arrays_that_are_not_what_they_say_are_refused(tmp_path: Path, samples: bytes) -> None:
    path = tmp_path / "x.npz"
    whole = written(tmp_path, "npz").read_bytes()
    with zipfile.ZipFile(BytesIO(whole)) as made:
        others = {name: made.read(f"{name}.npy") for name in ("sample_rate_hz", "seed", "origin")}
    path.write_bytes(archive(samples=samples, **others))
    tracemalloc.start()
    try:
        with pytest.raises(FileError):
            import_signal(path, PLAIN)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("order", "<>")
def test_text_of_an_archive_that_is_no_text_is_refused(tmp_path: Path, order: str) -> None:
    path = tmp_path / "x.npz"
    whole = written(tmp_path, "npz").read_bytes()
    with zipfile.ZipFile(BytesIO(whole)) as made:
        others = {name: made.read(f"{name}.npy") for name in ("samples", "sample_rate_hz", "origin")}
    for number, said in ((ord("7"), None), (0x110000, FileError), (0xFFFFFFFF, FileError)):
        head = f"{{'descr': '{order}U1', 'fortran_order': False, 'shape': (), }}"
        path.write_bytes(archive(seed=npy(head, struct.pack(f"{order}I", number)), **others))
        if said is None:
            assert import_signal(path, PLAIN).seed == 7
            continue
        with pytest.raises(said, match="damaged, or no archive"):
            import_signal(path, PLAIN)


@pytest.mark.parametrize("word", WORDS)
def test_what_cannot_be_read_is_named(tmp_path: Path, word: str) -> None:
    with pytest.raises(FileError, match="gone"):
        import_signal(tmp_path / f"gone{FORMATS[word].suffix}", PLAIN)
    (tmp_path / f"folder{FORMATS[word].suffix}").mkdir()
    with pytest.raises(FileError, match="folder"):
        import_signal(tmp_path / f"folder{FORMATS[word].suffix}", PLAIN)


def test_what_has_no_end_fills_no_memory() -> None:
    if not Path("/dev/zero").is_char_device():
        pytest.skip("no /dev/zero on this system")
    for word in ("haptic", "ahap", "android"):
        with pytest.raises(FileError, match="no end"):
            import_signal(Path("/dev/zero"), PLAIN, FORMATS[word])
