"""A user's own recordings: tables as people write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hnf_core.datasets.recording import find_doubts
from hnf_core.datasets.registry import open_dataset
from hnf_core.datasets.time_series import MIN_DURATION_S
from hnf_core.errors import FileError, MaterialError
from hnf_core.export.csv_npz import write_csv
from hnf_core.export.options import ExportOptions
from hnf_core.signal import Signal

SECONDS = 1.0
UNITS = {
    "time": {"s": 1.0, "ms": 1e3}, "a": {"m/s2": 1.0, "g": 1.0 / 9.80665, "mm/s2": 1e3},
    "force": {"N": 1.0, "mN": 1e3}, "speed": {"m/s": 1.0, "mm/s": 1e3, "cm/s": 1e2}, "x": {"m": 1.0, "mm": 1e3},
}  # fmt: skip


def tone(time, hz: float = 200.0):
    return 3.0 * np.sin(2.0 * np.pi * hz * time)


def columns(rate: float = 10_000.0, hz: float = 200.0) -> dict[str, np.ndarray]:
    time = np.arange(round(SECONDS * rate) + 1) / rate
    return {
        "time": time,
        "acceleration": tone(time, hz) + 9.81,
        "force": 1.0 + 0.3 * np.sin(2.0 * np.pi * 2.0 * time),
        "speed": 0.1 + 0.03 * np.cos(2.0 * np.pi * 3.0 * time),
    }


def write(path: Path, table: dict[str, np.ndarray], separator: str = ",") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [separator.join(f"{value:.10g}" for value in row) for row in np.stack(list(table.values()), axis=1)]
    path.write_text("\n".join([separator.join(table), *rows]), encoding="utf-8")
    return path


def only(folder: Path):
    data = open_dataset("own", folder)
    (name,) = data.materials
    (recording,) = data.recordings(name)
    return recording


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_units_order_case_and_separators_do_not_matter(tmp_path, data):
    table, titles = columns(), {}
    for name in data.draw(st.permutations(list(table))):
        unit = data.draw(st.sampled_from(list(UNITS["a" if name == "acceleration" else name])))
        form = data.draw(st.sampled_from(["{} [{}]", "{}({})", "{}_{}"]))
        written = unit.replace("/", "_") if form == "{}_{}" else unit
        title = form.format(data.draw(st.sampled_from([name, name.upper(), name.title()])), written)
        titles[title] = table[name] * UNITS["a" if name == "acceleration" else name][unit]
    write(tmp_path / "Oak" / "one.csv", titles, data.draw(st.sampled_from([",", ";", "\t"])))
    found = only(tmp_path)
    assert (found.material, found.sample_rate) == ("Oak", 10_000.0)
    assert found.known == {"force", "speed"}
    assert not any("unit" in note for note in found.notes)
    time = np.arange(len(found.samples)) / 1e4
    np.testing.assert_allclose(found.samples, tone(time), atol=5e-3)
    states = np.arange(len(found.action.force)) / 200.0
    inside = slice(10, -10)
    np.testing.assert_allclose(found.action.force[inside], (1.0 + 0.3 * np.sin(4 * np.pi * states))[inside], atol=0.01)
    np.testing.assert_allclose(found.action.speed[inside], (0.1 + 0.03 * np.cos(6 * np.pi * states))[inside], atol=1e-3)


@pytest.mark.parametrize("rate", [4000.0, 10_000.0, 25_600.0, 48_000.0, 51_200.0])
def test_any_rate_gives_the_touch_band_and_nothing_folds_into_it(tmp_path, rate):
    write(tmp_path / "Oak" / "low.csv", columns(rate, 300.0))
    low = only(tmp_path)
    inside = slice(200, -200)
    np.testing.assert_allclose(low.samples[inside], tone(np.arange(len(low.samples)) / 1e4, 300.0)[inside], atol=0.03)
    if rate > 20_000.0:
        write(tmp_path / "Oak" / "low.csv", columns(rate, 9700.0))  # would be heard at 300 Hz
        assert np.sqrt(np.mean(np.square(only(tmp_path).samples[inside]))) < 1e-3


def test_three_axes_are_fused_and_a_place_gives_the_direction(tmp_path):
    base = columns()
    time = base["time"]
    table = {
        "time": time, "ax": tone(time), "ay": 0.5 * tone(time, 330.0), "az": tone(time, 90.0) + 9.81,
        "x [mm]": 60.0 * time, "y [mm]": 80.0 * time,
    }  # fmt: skip
    write(tmp_path / "Oak" / "one.csv", table)
    found = only(tmp_path)
    assert found.known == {"direction", "speed"}
    np.testing.assert_allclose(found.action.speed[20:-20], 0.1, atol=1e-3)
    np.testing.assert_allclose(
        found.action.direction[20:-20], np.tile([0.6, 0.8], (len(found.action.speed) - 40, 1)), atol=0.01
    )
    assert np.mean(np.square(found.samples)) == pytest.approx(4.5 + 1.125 + 4.5, rel=0.02)
    assert any("ax in m/s²" in note for note in found.notes)
    assert any("force" in note for note in found.notes)


CASE = Path(__file__).resolve().parents[4] / "shared" / "cases" / "gap-in-recording"


@pytest.mark.skipif(not CASE.is_dir(), reason="the shared cases are not here")
def test_the_case_with_a_hole_gives_two_pieces_as_loud_as_it():
    pieces = open_dataset("own", CASE).recordings("material")
    assert len(pieces) == 2
    for piece in pieces:
        assert piece.duration_s == pytest.approx(0.15, abs=0.006)
        assert np.abs(piece.samples).max() <= 2.7
        assert np.sqrt(np.mean(np.square(piece.samples))) == pytest.approx(np.sqrt(2.0), rel=0.05)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 0.95), st.floats(0.0051, 0.2)), min_size=1, max_size=3), st.integers(0, 999))
def test_holes_cut_a_table_and_nothing_is_louder_than_it_was(tmp_path, holes, seed):
    table = columns(hz=160.0)
    table["acceleration"] += 0.05 * np.random.default_rng(seed).standard_normal(len(table["time"]))
    present = np.ones(len(table["time"]), dtype=bool)
    for start, length in holes:
        present &= (table["time"] < start) | (table["time"] > start + length)
    folder = tmp_path / str(seed)
    write(folder / "cloth" / "one.csv", {name: values[present] for name, values in table.items()})
    edges = np.flatnonzero(np.diff(np.concatenate([[0], present.astype(int), [0]])))
    lengths = [(high - 1 - low) / 1e4 for low, high in edges.reshape(-1, 2)]
    kept = sum(length >= MIN_DURATION_S for length in lengths)
    if kept == 0:
        with pytest.raises(FileError, match="cut it into pieces"):
            open_dataset("own", folder).recordings("cloth")
        return
    pieces = open_dataset("own", folder).recordings("cloth")
    assert len(pieces) == kept
    for piece in pieces:
        assert np.abs(piece.samples).max() < 3.5
        assert piece.action.speed.min() > 0.05
        assert piece.action.speed.max() < 0.15
        assert (len(lengths) > 1) == any("gap" in note for note in piece.notes)


def test_what_the_table_export_wrote_is_read(tmp_path):
    samples = tone(np.arange(10_000) / 1e4).astype(np.float32)
    path = tmp_path / "Oak" / "one.csv"
    path.parent.mkdir()
    write_csv(path, Signal(samples, 1e4, 0), ExportOptions())
    found = only(tmp_path)
    assert found.known == frozenset()
    np.testing.assert_allclose(found.samples, samples[: len(found.samples)], atol=1e-6)


def test_materials_are_folders_or_the_folder_itself(tmp_path):
    for place in ("Oak/a.csv", "Oak/b.csv", "Felt/takes/c.csv", "d.csv"):
        write(tmp_path / "mine" / place, columns())
    (tmp_path / "mine" / "Oak" / "look.jpg").write_bytes(b"\xff\xd8")
    data = open_dataset("own", tmp_path / "mine")
    assert data.materials == ("Oak", "mine", "takes")
    assert len(data.recordings("oak")) == 2
    assert data.image("oak") == tmp_path / "mine" / "Oak" / "look.jpg"
    assert data.image("mine") is None
    assert data.process("Oak") is None
    low, high = data.action_range("Oak").speed_m_s
    assert 0.07 < low < high < 0.13
    with pytest.raises(MaterialError, match="no material is called 'Pine'"):
        data.recordings("Pine")


def test_what_is_not_read_is_told(tmp_path):
    table = columns()
    write(tmp_path / "Oak" / "one.csv", {**table, "Speeds": table["speed"], "Temperature [C]": table["speed"]})
    notes = only(tmp_path).notes
    assert "columns not read: speeds, temperature" in notes
    assert "without a unit, so taken as: time in s, acceleration in m/s², force in N, speed in m/s" in notes


def without(name: str) -> dict[str, np.ndarray]:
    return {title: values for title, values in columns().items() if title != name}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (without("time"), "no column of time"),
        (without("acceleration"), "no column of acceleration"),
        ({**without("acceleration"), "ax": columns()["time"], "ay": columns()["time"]}, "neither one column nor three"),
        ({**columns(), "ax": tone(columns()["time"])}, "neither one column nor three"),
        ({**columns(), "x": columns()["time"]}, "of x and y one is missing"),
        ({**columns(), "Time [ms]": columns()["time"]}, "two columns of time"),
        ({**without("speed"), "speed [furlongs]": columns()["speed"]}, "no unit of speed known here"),
        ({name: values[::8] for name, values in columns().items()}, "1250 times a second only"),
        ({name: values[:400] for name, values in columns().items()}, "last 0.040 s only"),
        ({**without("time"), "time": columns()["time"][::-1]}, "time does not rise at sample 2"),
        ({**without("force"), "force": np.full(10_001, np.nan)}, "line 2: a value is not finite"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_used_says_why(tmp_path, table, words):
    path = write(tmp_path / "Oak" / "one.csv", table)
    with pytest.raises(FileError, match=words) as told:
        only(tmp_path)
    assert str(path) in str(told.value)


def test_an_empty_folder_says_what_belongs_into_it(tmp_path):
    with pytest.raises(FileError, match="no CSV table"):
        _ = open_dataset("own", tmp_path).materials


@pytest.mark.parametrize("rate", [2001.0, 2500.0, 8000.0])
def test_slow_sensors_keep_their_band_and_say_where_it_ends(tmp_path, rate):
    count = round(4.0 * rate) + 1
    table = {
        "time": np.arange(count) / rate,
        "acceleration": np.random.default_rng(0).normal(size=count),
        "force": np.ones(count),
        "speed": np.full(count, 0.1),
    }
    recording = only(write(tmp_path / "a" / "1.csv", table).parent)
    assert recording.measured_rate == pytest.approx(rate)
    power = np.abs(np.fft.rfft(recording.samples)) ** 2
    frequency = np.fft.rfftfreq(len(recording.samples), 1.0 / recording.sample_rate)
    expected = power.sum() / (rate / 2.0)
    for low in np.arange(100.0, 0.4 * rate, 200.0):
        level = 10.0 * np.log10(power[(frequency >= low) & (frequency < low + 200.0)].sum() / 200.0 / expected)
        assert abs(level) < 0.8
    assert power[frequency > 0.52 * rate].sum() < 1e-4 * power.sum()


@pytest.mark.parametrize("count", [20_000, 40_000, 40_001])
def test_the_slowest_rate_is_taken_at_any_length(tmp_path, count):
    table = {name: np.resize(values, count) for name, values in columns(2000.0).items()}
    table["time"] = np.arange(count) / 2000.0
    assert only(write(tmp_path / "a" / "1.csv", table).parent).duration_s == pytest.approx(count / 2000.0, abs=0.01)


def test_units_that_nobody_has_are_doubted(tmp_path):
    table = columns()
    fine = only(write(tmp_path / "a" / "1.csv", table).parent)
    assert not any("?" in doubt for doubt in find_doubts([fine]))
    table["speed"], table["acceleration"] = 1e3 * table["speed"], 1e6 * table["acceleration"]
    doubts = find_doubts([only(write(tmp_path / "b" / "1.csv", table).parent)])
    assert [doubt for doubt in doubts if "is its acceleration in m/s²?" in doubt] != []
    assert [doubt for doubt in doubts if "in mm?" in doubt] != []
