"""Tables of touch and acceleration as people, sensors and Excel write them: one reader for all verbs."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.action.action import read_action_csv
from hnf_core.actuators.stream_targets import AudioTarget, parse_target
from hnf_core.errors import FileError, StrokeError, UsageError
from hnf_core.export.csv_npz import read_csv
from hnf_core.export.options import ImportOptions
from hnf_core.export.wav import decode_wav, decode_wav_channels

TITLES = {
    "plain": ("time_s", "direction_rad", "speed_m_s", "force_n", 1.0, 1.0),
    "case": ("Time_s", "Direction_rad", "Speed_m_s", "Force_N", 1.0, 1.0),
    "units": ("time [s]", "direction [rad]", "speed [mm/s]", "force [N]", 1.0, 1000.0),
    "round": ("Time (ms)", "Direction (rad)", "Speed (mm/s)", "Force (N)", 1000.0, 1000.0),
}


@given(
    st.sampled_from(sorted(TITLES)),
    st.sampled_from([",", ";", "\t"]),
    st.sampled_from(["", "\ufeff"]),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["", "# "]),
)
def test_one_table_however_it_is_written(tmp_path_factory, kind, separator, mark, newline, comment):
    *titles, time_scale, speed_scale = TITLES[kind]
    if kind == "plain" and (separator != "," or comment):
        titles[0] = "Time_s"
    rows = [[0.01 * index * time_scale, 0.3, 0.1 * speed_scale, 1.0] for index in range(50)]
    lines = [comment + separator.join(titles), *(separator.join(f"{cell:.6g}" for cell in row) for row in rows)]
    if separator == ";":
        lines[1:] = [line.replace(".", ",") for line in lines[1:]]
    path = tmp_path_factory.mktemp("table") / "t.csv"
    path.write_bytes((mark + newline.join(lines) + newline).encode())
    action = read_action_csv(path)
    assert action.duration_s == pytest.approx(0.49, abs=6e-3)
    np.testing.assert_allclose(action.speed, 0.1, rtol=1e-5)
    np.testing.assert_allclose(action.force, 1.0)


def test_noise_below_zero_is_no_force_and_more_is_refused(tmp_path):
    path = tmp_path / "t.csv"
    rows = [f"{0.01 * index:g},0.3,0.1,{-0.003 if index < 5 else 1.0:g}" for index in range(50)]
    path.write_text("\n".join(["time_s,direction_rad,speed_m_s,force_n", *rows]))
    said: list[str] = []
    action = read_action_csv(path, warn=said.append)
    assert "5 forces" in said[0]
    assert action.force.min() == 0.0
    path.write_text(path.read_text().replace("-0.003", "-0.5"))
    with pytest.raises(StrokeError, match="force at line 2 is negative"):
        read_action_csv(path)


def test_positions_give_direction_and_speed(tmp_path):
    rows = [f"{0.01 * index:g},{0.6 * index:g},{0.8 * index:g},1" for index in range(50)]
    (tmp_path / "t.csv").write_text("\n".join(["time [s],x [mm],y [mm],force [N]", *rows]))
    action = read_action_csv(tmp_path / "t.csv")
    np.testing.assert_allclose(action.speed, 0.1, rtol=1e-6)
    np.testing.assert_allclose(action.direction[0], [0.6, 0.8], atol=1e-6)


def test_signal_table_of_other_programs_and_doubted_milliseconds(tmp_path):
    rows = [f"{0.1 * index:.1f};{np.sin(index):.4f}".replace(".", ",") for index in range(200)]
    head = "time [ms];acceleration [m/s²]"
    (tmp_path / "t.csv").write_bytes("\n".join([head, *rows]).encode("cp1252"))
    assert read_csv(tmp_path / "t.csv", ImportOptions()).sample_rate == pytest.approx(10_000.0)
    rows = [row.replace(";", " ").replace(",", ".").replace(" ", ",") for row in rows]
    (tmp_path / "ms.csv").write_text("\n".join(["time_s,acceleration_m_s2", *rows]))
    assert "milliseconds" in read_csv(tmp_path / "ms.csv", ImportOptions()).provenance["doubt"]


SAMPLES = np.arange(-800, 800, dtype="<i2")
FORMAT = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 2, 8000, 32000, 4, 16)


@given(
    st.sampled_from([0, 0xFFFFFFFF, 0x7FFFF000, 0x80000000 - 44, 3200]),
    st.sampled_from([b"RIFF", b"RF64", b"BW64"]),
    st.sampled_from([b"", b"LIST" + struct.pack("<I", 12) + b"INFOICMT" + struct.pack("<I", 500)]),
    st.binary(max_size=40),
)
def test_samples_are_read_whatever_the_header_says_of_sizes(size, kind, before, after):
    data = SAMPLES.tobytes()
    long = b"ds64" + struct.pack("<IQQQI", 28, 0, len(data), 0, 0) if kind != b"RIFF" else b""
    if kind != b"RIFF":
        size = 0xFFFFFFFF
    body = b"WAVE" + long + FORMAT + before + b"data" + struct.pack("<I", size) + data
    total = len(body) if size == 3200 else 0xFFFFFFFF
    after = b"TAG" + after if size == 3200 or kind != b"RIFF" else b""
    file = kind + struct.pack("<I", total) + body + after
    left, right = decode_wav_channels(file, Path("x.wav"))
    np.testing.assert_array_equal(left.samples, (SAMPLES[::2] / 32768).astype(np.float32))
    np.testing.assert_array_equal(right.samples, decode_wav(file, Path("x.wav"), 2).samples)
    with pytest.raises(FileError, match="no channel 3"):
        decode_wav(file, Path("x.wav"), 3)


@given(st.binary(max_size=300), st.integers(0, 200), st.integers(0, 255))
def test_damage_is_refused_or_read_and_nothing_else(tail, at, value):
    file = bytearray(b"RIFF" + struct.pack("<I", 4000) + b"WAVE" + FORMAT + b"data" + struct.pack("<I", 300) + tail)
    file[at % len(file)] = value
    with suppress(FileError):
        decode_wav_channels(bytes(file), Path("x.wav"))


def test_audio_targets_map_channels():
    assert parse_target("audio:DualSense:3,4") == AudioTarget("DualSense", (3, 4))
    assert parse_target("audio:DualSense:3,4").text == "audio:DualSense:3,4"
    assert parse_target("audio:2:3") == AudioTarget(2, (3,))
    assert parse_target("audio:2") == AudioTarget(2)
    with pytest.raises(UsageError):
        parse_target("audio:2:3,3")
