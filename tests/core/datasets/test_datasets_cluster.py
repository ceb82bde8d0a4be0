"""The Cluster database: irregular samples in g with gravity, direction from positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets.cluster_database import get_family
from hnf_core.datasets.recording import Recording
from hnf_core.datasets.registry import open_dataset
from hnf_core.errors import FileError, MaterialError
from hnf_core.metrics.spectra import welch

SECONDS = 1.0
STEM = "102_45_40_500_0"


def table(header: str, *columns) -> str:
    return header + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)) + "\n"


def irregular(start: float = 0.0) -> np.ndarray:
    steps = np.random.default_rng(2).uniform(0.7, 1.3, round(6000 * SECONDS)) / 6000.0
    return start + np.cumsum(steps) - steps[0]


def accel(tone_hz=200.0, header="time,X,Y,Z", scale=1.0) -> str:
    time = irregular()
    return table(header, time, 0 * time, scale * 0.5 * np.sin(2 * np.pi * tone_hz * time), scale * (1.0 + 0 * time))


def force(start=0.0) -> str:
    time = np.arange(0.0, SECONDS, 1e-3)
    return table("time,force", start + time, 0.5 + 0.1 * np.sin(2 * np.pi * 3 * time) + 0.2 * np.sin(900 * time))


def position(angle=np.pi / 4, speed_mm=40.0) -> str:
    time = np.arange(0.0, SECONDS, 0.01)
    return table("time,X,Y", time, 3 + speed_mm * np.cos(angle) * time, 5 + speed_mm * np.sin(angle) * time)


def write(folder: Path, stem: str = STEM, root: str = "sensor_data", **files) -> None:
    """files: text per quantity; None leaves the file out."""
    for quantity, text in ({"accel": accel(), "force": force(), "position": position()} | files).items():
        if text is not None:
            path = folder / root / quantity / stem.partition("_")[0] / f"{stem}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")


def read_all(folder: Path, **files) -> list[Recording]:
    write(folder, **files)
    return open_dataset("cluster", folder).recordings("102")


def read(folder: Path, **files) -> Recording:
    return read_all(folder, **files)[0]


def test_units_rates_and_gravity(tmp_path):
    recording = read(tmp_path)
    assert recording.sample_rate == 10_000.0
    assert recording.known == {"direction", "speed", "force"}
    assert "gravity removed" in recording.notes[0]
    frequency, density = welch(recording.samples, 10_000.0)
    assert frequency[np.argmax(density)] == 200.0
    # a sine of 0.5 g has the power 0.125 g²: irregular sampling and resampling leave it
    assert np.mean(np.square(recording.samples)) == pytest.approx(0.125 * 9.80665**2, rel=0.02)
    assert abs(recording.samples.mean()) < 0.02


@pytest.mark.parametrize("tone", [50.0, 400.0, 800.0])
def test_the_touch_band_survives_resampling(tmp_path, tone):
    power = np.mean(np.square(read(tmp_path, accel=accel(tone)).samples))
    assert 10.0 * np.log10(power / (0.125 * 9.80665**2)) == pytest.approx(0.0, abs=0.5)


def test_direction_speed_and_force_come_from_their_sensors(tmp_path):
    action = read(tmp_path).action
    angle = np.arctan2(action.direction[:, 1], action.direction[:, 0])
    np.testing.assert_allclose(angle, np.pi / 4, atol=1e-3)
    np.testing.assert_allclose(action.speed, 0.04, rtol=0.01)
    # the hand's 3 Hz stays, the sensor's 143 Hz goes
    expected = 0.5 + 0.1 * np.sin(2 * np.pi * 3 * action.time)
    np.testing.assert_allclose(action.force[10:-10], expected[10:-10], atol=5e-3)


def test_what_no_file_tells_is_taken_from_the_name_and_said(tmp_path):
    recording = read(tmp_path, force=None, position=None)
    assert recording.known == frozenset()
    assert recording.action.force[0] == 0.5
    assert recording.action.speed[0] == pytest.approx(0.04)
    np.testing.assert_allclose(recording.action.direction[0], [np.sqrt(0.5)] * 2)
    assert any("45°" in note for note in recording.notes)
    assert any("0.5 N assumed" in note for note in recording.notes)


def test_units_in_the_header_count(tmp_path):
    plain = read(tmp_path)
    headed = read(
        tmp_path, accel=accel(header="Time (s);x (m/s^2);y (m/s^2);z (m/s^2)".replace(";", ","), scale=9.80665)
    )
    np.testing.assert_allclose(headed.samples, plain.samples, rtol=1e-5, atol=1e-6)


def test_a_gap_cuts_the_recording(tmp_path):
    lines = accel().splitlines()
    first, second = read_all(tmp_path, accel="\n".join(lines[:2000] + lines[2600:]))
    assert any(note.startswith("cut at 1 gap of up to 10") and note.endswith("piece 1 of 2") for note in first.notes)
    assert any(note.endswith("piece 2 of 2") for note in second.notes)
    (whole,) = read_all(tmp_path)
    assert first.duration_s + second.duration_s < whole.duration_s - 0.08
    for piece in (first, second):
        assert np.abs(piece.samples).max() <= 1.02 * np.abs(whole.samples).max()
        assert np.mean(np.square(piece.samples)) == pytest.approx(np.mean(np.square(whole.samples)), rel=0.03)
    assert not any("gap" in note for note in whole.notes)


def test_a_clock_that_runs_on_for_years_costs_no_memory(tmp_path):
    lines = force().splitlines()
    recording = read(tmp_path, force="\n".join([*lines, "1e9,0.5"]))
    assert recording.action.force.mean() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("root", ["sensor_data", "", "copy/of/sensor_data"])
def test_the_folder_is_understood_wherever_it_starts(tmp_path, root):
    write(tmp_path, root=root)
    write(tmp_path, stem="12_0_20_1000_1", root=root)
    (tmp_path / "images" / "images_scan_area").mkdir(parents=True)
    (tmp_path / "images" / "images_scan_area" / "img102.jpg").write_bytes(b"\xff\xd8")
    data = open_dataset("cluster", tmp_path)
    assert data.materials == ("wood 12", "cloth 102")
    assert data.image("cloth_102") == tmp_path / "images/images_scan_area/img102.jpg"
    assert data.image("12") is None
    assert data.process("12") is None
    assert data.recordings("Cloth 102")[0].material == "cloth 102"
    low, high = data.action_range("102").force_n
    assert 0.35 < low < 0.45 < 0.55 < high < 0.65


def test_families_are_those_of_the_publication():
    assert [get_family(each) for each in (0, 37, 38, 49, 65, 74, 79, 82, 87, 102, 117)] == [
        "wood", "wood", "stone", "polymer", "metal", "glass", "composite", "ceramic", "biodegradable", "cloth", "cloth",
    ]  # fmt: skip
    assert get_family(118) == "material"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"accel": ""}, "column time is missing"),
        ({"accel": "time,X,Y,Z\n"}, "no rows"),
        ({"accel": "time,X,Y\n0,1,2\n"}, "column Z is missing"),
        ({"accel": accel()[:2001]}, "last|missing or no number"),
        ({"accel": accel().replace("\n", "\nnan", 1)}, "line 2: a (value is not finite|cell)"),
        ({"accel": accel(header="time,X (miles),Y (miles),Z (miles)")}, "miles.*acceleration"),
        ({"accel": accel(header="time,X (g),Y (g),Z (m/s2)")}, "different units"),
        ({"accel": accel(header="time (ms),X,Y,Z")}, "together last"),
        ({"accel": table("time,X,Y,Z", *[np.arange(50) * 0.02] * 4)}, "sampled 50 times"),
        ({"accel": "time,X,Y,Z\n" + "0,0,0,1\n" * 9}, "time does not rise at sample 2"),
        ({"accel": "time,X,Y,Z\n0,0,0,1\n1e-4,0,0,1\n"}, "only 2 samples"),
        ({"force": force(start=100.0)}, "together last"),
        ({"position": "time,X,Y\n0,east,0\n"}, "line 2"),
        ({"accel": accel().replace("\n0,", "\n1e200,", 1)}, "line 2: a value is not finite or beyond"),
        ({"force": "\0\1\2"}, "not a text file"),
    ],
    ids=str,
)
def test_a_bad_file_is_refused(tmp_path, files, message):
    with pytest.raises(FileError, match=rf"{STEM}\.csv.*({message})"):
        read(tmp_path, **files)


def test_unknown_names_and_empty_folders_are_refused(tmp_path):
    with pytest.raises(FileError, match="no accel/<id>"):
        _ = open_dataset("cluster", tmp_path).materials
    write(tmp_path)
    data = open_dataset("cluster", tmp_path)
    with pytest.raises(MaterialError, match="cloth 102"):
        data.recordings("../../102")
    with pytest.raises(MaterialError, match="cloth 102"):
        data.process("103")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000), st.binary(min_size=1, max_size=5))
def test_damage_anywhere_is_a_recording_or_a_file_error(tmp_path_factory, place, junk):
    folder = tmp_path_factory.getbasetemp() / "damaged-cluster"
    data = accel().encode()[:60_000].rpartition(b"\n")[0]
    write(folder, position=None, force=None)
    place %= len(data)
    path = folder / "sensor_data/accel/102" / f"{STEM}.csv"
    path.write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        recording = open_dataset("cluster", folder).recordings("102")[0]
    except FileError:
        return
    assert np.isfinite(recording.samples).all()
