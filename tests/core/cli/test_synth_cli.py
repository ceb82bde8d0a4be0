"""`hnf synth` and its action table."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from hnf_core.action.action import action_from_table, read_action_csv
from hnf_core.cli.main import main
from hnf_core.cli.synth import is_long
from hnf_core.errors import FileError, StrokeError
from hnf_core.export.wav import read_wav
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.weights import save_field
from hnf_core.material.library import load_library
from hnf_core.material.ranking import find_material

HEADER = "time_s,direction_rad,speed_m_s,force_n\n"


def hnf(*words):
    def no_blender(arguments):
        raise AssertionError("synth needs no Blender")

    return main([str(word) for word in words], no_blender)


@pytest.fixture
def material():
    return load_library()[0].name


def test_a_primitive_becomes_a_wav(tmp_path, capsys, material):
    out = tmp_path / "x.wav"
    assert hnf("synth", "--material", material, "--stroke", "left-right-soft", "--out", out, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    signal = read_wav(out)
    assert record["rms_m_s2"] == pytest.approx(signal.rms, rel=1e-6)
    assert record["duration_s"] == pytest.approx(signal.duration_s)
    assert signal.sample_rate == 10_000
    assert signal.provenance["material"] == material
    assert signal.provenance["probe"] == "pen"
    assert 0.01 < signal.rms < 100.0


def test_the_same_words_write_the_same_bytes(tmp_path, material):
    paths = [tmp_path / name for name in ("a.wav", "b.wav", "c.wav")]
    for path, seed in zip(paths, (3, 3, 4), strict=True):
        assert hnf("synth", "--material", material, "--stroke", "rub-slow", "--seed", seed, "--out", path) == 0
    first, second, third = (path.read_bytes() for path in paths)
    assert first == second
    assert first != third


@pytest.mark.parametrize(
    ("words", "name"), [("Paper Plate", "kraft-paper"), ("Carpet 2", "loop-carpet"), ("Old denim jeans", "denim")]
)
def test_words_take_the_best_ranked_material_and_say_so(tmp_path, capsys, words, name):
    one, other = tmp_path / "one.wav", tmp_path / "other.wav"
    assert hnf("synth", "--material", words, "--stroke", "rub-slow", "--out", one, "--json") == 0
    printed = capsys.readouterr()
    record = json.loads(printed.out)
    assert record["material"] == name
    assert f"{words!r}: {name} is taken" in record["warnings"][0]
    assert record["warnings"][0] in printed.err
    assert hnf("synth", "--material", name, "--stroke", "rub-slow", "--out", other) == 0
    assert one.read_bytes() == other.read_bytes()
    assert "is taken" not in capsys.readouterr().err


@pytest.mark.parametrize("words", ["oakwod", "xyzzy", "Object.001"])
def test_words_that_name_no_material_are_refused(tmp_path, capsys, words):
    assert hnf("synth", "--material", words, "--stroke", "rub-slow", "--out", tmp_path / "x.wav") == 1
    assert "no library material is called" in capsys.readouterr().err
    assert not (tmp_path / "x.wav").exists()


def test_every_library_name_is_itself():
    for material in load_library():
        assert find_material(material.name) == (material, None)


def test_rate_and_probe_are_obeyed(tmp_path, material):
    paths = {probe: tmp_path / f"{probe}.wav" for probe in ("pen", "finger")}
    for probe, path in paths.items():
        words = ("--stroke", "left-right-soft", "--rate", "8000", "--probe", probe, "--out", path)
        assert hnf("synth", "--material", material, *words) == 0
        assert read_wav(path).sample_rate == 8000
        assert read_wav(path).provenance["probe"] == probe
    assert paths["pen"].read_bytes() != paths["finger"].read_bytes()


def test_an_action_table_on_any_grid(tmp_path, material):
    table = tmp_path / "action.csv"
    rows = [(0.0, 0.0, 0.0, 0.0), (0.11, 0.1, 0.1, 1.0), (0.2, 0.1, 0.1, 1.0), (0.57, 0.2, 0.1, 1.0), (0.6, 0.2, 0, 0)]
    table.write_text(HEADER + "\n".join(",".join(str(cell) for cell in row) for row in rows))
    out = tmp_path / "x.wav"
    assert hnf("synth", "--material", material, "--action", table, "--out", out) == 0
    assert read_wav(out).duration_s == pytest.approx(0.6, abs=0.006)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--material", "no-such-stuff", "--stroke", "rub-slow"), 1),
        (("--material", "MATERIAL", "--stroke", "no-such-stroke"), 2),
        (("--stroke", "rub-slow"), 2),
        (("--material", "MATERIAL"), 2),
        (("--material", "MATERIAL", "--stroke", "rub-slow", "--rate", "0"), 2),
        (("--material", "MATERIAL", "--stroke", "rub-slow", "--rate", "nan"), 2),
        (("--material", "MATERIAL", "--stroke", "rub-slow", "--seed", "-1"), 2),
        (("--material", "MATERIAL", "--stroke", "rub-slow", "--seed", str(2**63)), 2),
        (("--material", "MATERIAL", "--stroke", "rub-slow", "--seed", "²"), 2),
        (("--material", "MATERIAL", "--action", "missing.csv"), 1),
        (("--weights", "missing.safetensors", "--stroke", "rub-slow"), 1),
    ],
)
def test_wrong_words_are_told_apart_from_failures(tmp_path, capsys, material, words, code):
    words = [material if word == "MATERIAL" else word for word in words]
    assert hnf("synth", *words, "--out", tmp_path / "x.wav") == code
    assert capsys.readouterr().err.strip()
    assert not (tmp_path / "x.wav").exists()


@pytest.mark.parametrize("seed", ["-1", str(2**63), "1.0"])
@pytest.mark.parametrize(
    "words",
    [
        ("stream", "in.wav", "--to", "osc:127.0.0.1:9"),
        ("import", "in.wav", "--out", "out.wav"),
        ("train", "tactile-map", "--data", "pairs", "--out", "map.safetensors"),
        ("train", "field", "--data", "hatt", "--material", "Cork", "--out", "field.safetensors"),
    ],
    ids=lambda words: words[1] if words[0] == "train" else words[0],
)
def test_every_verb_takes_the_same_seeds(words, seed, capsys):
    assert hnf(*words, f"--seed={seed}") == 2
    assert f"--seed {seed}: not a whole number from 0 to 2^63" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("rate", "words"),
    [("10000001", "10000001: not within 1 to 10000000"), ("0.5", "not within 1"), ("9999.5", "whole number")],
)
def test_a_rate_is_refused_for_what_is_wrong_with_it(tmp_path, capsys, material, rate, words):
    options = ("--stroke", "rub-slow", "--rate", rate, "--out", tmp_path / "x.wav")
    assert hnf("synth", "--material", material, *options) == 2
    assert words in capsys.readouterr().err


def test_what_no_wav_can_hold_is_refused_before_anything_is_made(tmp_path, capsys, material, monkeypatch):
    """Two minutes at 10 MHz are 1.2e9 samples, though the stroke is not a long one: it took 6.5 GB."""
    table = tmp_path / "a.csv"
    table.write_text(HEADER + "0,0,0.1,1\n119,0,0.1,1\n")
    monkeypatch.setattr("hnf_core.field.render.prepare_stroke", lambda *_, **__: pytest.fail("it is made"))
    monkeypatch.setattr("hnf_core.cli.synth.synthesise", lambda *_, **__: pytest.fail("it is made"))
    words = ("--material", material, "--action", table, "--rate", "1e7", "--out", tmp_path / "x.wav")
    assert hnf("synth", *words) == 1
    assert "more than a WAV can hold" in capsys.readouterr().err


def test_a_signal_is_cut_into_portions_by_its_samples_too():
    assert [is_long(*each) for each in ((119.0, 1e4), (121.0, 1e4), (119.0, 48e3), (119.0, 1e6), (1.0, 1e7))] == [
        False, True, False, True, False,
    ]  # fmt: skip


def test_weights_of_no_single_material_say_so(tmp_path, capsys):
    from hnf_core.field.weights import DEFAULT_WEIGHTS

    assert hnf("synth", "--weights", DEFAULT_WEIGHTS, "--stroke", "rub-slow", "--out", tmp_path / "x.wav") == 1
    assert "--material" in capsys.readouterr().err


def test_weights_of_one_material_bring_it_along(tmp_path):
    import dataclasses

    from hnf_core.field.weights import load_field, save_field

    entry = load_library()[0]
    own = json.dumps({"name": "mine", "token": entry.token.tolist(), "mechanics": dataclasses.asdict(entry.mechanics)})
    field = load_field()
    weights = tmp_path / "own.safetensors"
    save_field(weights, dataclasses.replace(field, metadata={**field.metadata, "material": own}))
    out = tmp_path / "x.wav"
    assert hnf("synth", "--weights", weights, "--stroke", "rub-slow", "--out", out) == 0
    assert read_wav(out).provenance["material"] == "mine"


def test_an_exported_material_gives_the_same_signal(tmp_path, material):
    kept, named, filed = tmp_path / "mine.hnf", tmp_path / "named.wav", tmp_path / "filed.wav"
    assert hnf("materials", "--export", material, "--out", kept) == 0
    assert hnf("synth", "--material", material, "--stroke", "rub-slow", "--out", named) == 0
    assert hnf("synth", "--material", kept, "--stroke", "rub-slow", "--out", filed) == 0
    assert filed.read_bytes() == named.read_bytes()


def test_a_material_file_selects_the_field_of_its_encoder(tmp_path, material):
    from hnf_core.field.weights import EVERY_ENCODER_WEIGHTS
    from hnf_core.material.hnf_file import from_library, write_hnf
    from hnf_core.material.library import get_material
    from hnf_core.material.token import ENCODER_NAMES

    if not EVERY_ENCODER_WEIGHTS.is_file():
        pytest.skip("this package is without the field of every encoder")
    ours = from_library(get_material(material))
    written = {}
    for name in ENCODER_NAMES:
        kept, written[name] = tmp_path / f"{name}.hnf", tmp_path / f"{name}.wav"
        write_hnf(kept, replace(ours, encoder=name))
        assert hnf("synth", "--material", kept, "--stroke", "left-right-soft", "--out", written[name]) == 0
    assert len({path.read_bytes() for path in written.values()}) == len(ENCODER_NAMES) > 1


@pytest.mark.parametrize("content", [None, b"", b"not a material"])
def test_a_file_that_is_no_material_is_refused_by_name(tmp_path, capsys, content):
    kept = tmp_path / "mine.hnf"
    if content is not None:
        kept.write_bytes(content)
    assert hnf("synth", "--material", kept, "--stroke", "rub-slow", "--out", tmp_path / "x.wav") == 1
    assert "mine.hnf" in capsys.readouterr().err
    assert not (tmp_path / "x.wav").exists()


def test_position_is_the_integral_of_speed():
    time = np.array([0.0, 0.3, 1.0])
    action = action_from_table(time, np.zeros(3), np.array([0.0, 0.3, 0.1]), np.ones(3))
    assert action.position[-1] == pytest.approx(0.5 * 0.3 * 0.3 + 0.5 * 0.4 * 0.7, rel=1e-12)
    np.testing.assert_allclose(np.gradient(action.position, 1 / 200.0)[5:-5], action.speed[5:-5], atol=2e-3)


@pytest.mark.parametrize("rate", [1000.0, 10_000.0])
def test_a_vibration_in_a_fine_table_does_not_fold_to_a_tone(rate):
    time = np.arange(0.0, 2.0, 1.0 / rate)
    slow, fast = np.sin(2 * np.pi * 5 * time), np.sin(2 * np.pi * 150 * time)
    force = 1.0 + 0.2 * slow + 0.2 * fast
    action = action_from_table(time, np.zeros(len(time)), np.ones(len(time)), force)
    middle = (action.time > 0.1) & (action.time < 1.9)
    left = action.force[middle] - 1.0 - 0.2 * np.sin(2 * np.pi * 5 * action.time[middle])
    assert np.abs(left).max() < 0.02
    np.testing.assert_allclose(action.speed, 1.0, rtol=1e-12)
    np.testing.assert_allclose(action.position, action.time, atol=1e-9)


def test_direction_turns_the_short_way():
    action = action_from_table(np.array([0.0, 1.0]), np.array([np.pi - 0.1, -np.pi + 0.1]), np.ones(2), np.ones(2))
    assert np.all(action.direction[:, 0] < -0.9)
    np.testing.assert_allclose(np.linalg.norm(action.direction, axis=1), 1.0)


@pytest.mark.parametrize(
    ("text", "error", "word"),
    [
        ("time_s,speed_m_s,force_n\n0,1,1\n1,1,1\n", FileError, "direction_rad"),
        ("", FileError, "time_s"),
        (HEADER + "0,0,x,1\n1,0,0,1\n", FileError, "line 2"),
        (HEADER + "0,0,1\n1,0,0,1\n", FileError, "line 2"),
        (HEADER + "0,0,0.1,1\n", StrokeError, "fewer than two"),
        (HEADER + "0,0,0.1,1\n0,0,0.1,1\n", StrokeError, "line 3"),
        (HEADER + "0,0,0.1,nan\n1,0,0.1,1\n", StrokeError, "line 2"),
        (HEADER + "\n\n0,0,0.1,1\n\n1,0,x,1\n", FileError, "line 6"),
        (HEADER + "\n0,0,0.1,1\n\n1,0,nan,1\n", StrokeError, "line 5"),
        (HEADER + "0,0,0.1,1\n\n\n0,0,0.1,1\n", StrokeError, "line 5"),
        (HEADER.strip() + ",force_n\n0,0,0.1,1,2\n1,0,0.1,1,2\n", FileError, "two columns force_n"),
        (HEADER + "0,0,-0.1,1\n1,0,0.1,1\n", StrokeError, "negative"),
    ],
)
def test_broken_tables_are_refused_where_they_break(tmp_path, text, error, word):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(error, match=word) as caught:
        read_action_csv(path)
    assert "a.csv" in str(caught.value)


def test_columns_that_are_no_table_are_refused_in_words():
    with pytest.raises(StrokeError, match="fewer than two"):
        action_from_table(*(np.zeros(0) for _ in range(4)))
    with pytest.raises(StrokeError, match="shapes"):
        action_from_table(np.arange(3.0), np.zeros(3), np.ones(2), np.ones(3))
    with pytest.raises(StrokeError, match="row 2 holds"):
        action_from_table(np.arange(3.0), np.array([0.0, np.nan, 0.0]), np.ones(3), np.ones(3))


def test_action_csv_accepts_a_bom_and_any_column_order(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfforce_n,time_s,speed_m_s,direction_rad\r\n1,0,0.1,0\r\n\r\n1,0.5,0.1,0\r\n")
    action = read_action_csv(path)
    assert len(action.speed) == 101
    assert math.isclose(action.speed[0], 0.1)


def test_a_tolerance_is_another_way_to_the_same_touch(tmp_path, capsys, material):
    plain, near = tmp_path / "plain.wav", tmp_path / "near.wav"
    words = ("synth", "--material", material, "--stroke", "left-right-soft")
    assert hnf(*words, "--out", plain) == 0
    assert hnf(*words, "--tolerance", "-30", "--out", near) == 0
    one, two = (read_wav(path).samples.astype(float) for path in (plain, near))
    assert len(one) == len(two)
    assert 0.0 < np.sqrt(np.mean(np.square(one - two))) < 0.1 * np.sqrt(np.mean(np.square(one)))


@pytest.mark.parametrize("tolerance", ["-60", "3", "nan", "-inf", "-5e0", "-1e2"])
def test_a_tolerance_out_of_reach_is_refused(tmp_path, capsys, material, tolerance):
    words = ("--stroke", "left-right-soft", "--tolerance", tolerance, "--out", tmp_path / "x.wav")
    assert hnf("synth", "--material", material, *words) == 2
    assert "-10 to -45 dB" in capsys.readouterr().err
    assert not (tmp_path / "x.wav").exists()


def test_a_tolerance_may_be_written_with_an_exponent(tmp_path, material):
    words = ("--stroke", "left-right-soft", "--tolerance", "-1e1", "--out", tmp_path / "x.wav")
    assert hnf("synth", "--material", material, *words) == 0


def test_a_tolerance_without_a_say_is_refused(tmp_path, capsys):
    """Weights whose heads lag one another: it was left aside in silence."""
    entry, config = load_library()[0], FieldConfig.published(8)
    own = json.dumps({"name": "mine", "token": entry.token.tolist(), "mechanics": asdict(entry.mechanics)})
    weights, out = tmp_path / "own.safetensors", tmp_path / "x.wav"
    save_field(weights, Field(config, initial_parameters(config, 1), metadata={"material": own}))
    words = ("synth", "--weights", weights, "--stroke", "rub-slow", "--out", out)
    assert hnf(*words, "--tolerance", "-30") == 2
    assert "--tolerance has no say" in capsys.readouterr().err
    assert not out.exists()
    assert hnf(*words) == 0


@pytest.mark.parametrize(
    ("rows", "doubt"),
    [
        ([(0.0, 90.0), (0.5, 180.0)], "degrees"),
        ([(0.0, -720.0), (0.5, 0.0)], "degrees"),
        ([(0.0, 0.0), (1000.0, 0.1), (2000.0, 0.1)], "milliseconds"),
        ([(0.0, 12.5), (0.5, -12.5)], ""),
        ([(0.0, 0.0), (100.0, 0.0)], ""),
        ([(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (60.0, 0.0)], ""),
    ],
)
def test_numbers_of_another_unit_are_read_and_doubted(tmp_path, rows, doubt):
    path, said = tmp_path / "a.csv", []
    path.write_text(HEADER + "".join(f"{time},{direction},0.1,1\n" for time, direction in rows))
    read_action_csv(path, warn=said.append)
    assert len(said) == bool(doubt)
    assert all(doubt in each and "a.csv" in each for each in said)


def test_a_doubt_about_units_is_among_the_warnings(tmp_path, capsys, material):
    table = tmp_path / "a.csv"
    table.write_text(HEADER + "0,90,0.1,1\n0.5,180,0.1,1\n")
    assert hnf("synth", "--material", material, "--action", table, "--out", tmp_path / "x.wav", "--json") == 0
    said = capsys.readouterr()
    assert any("degrees" in warning for warning in json.loads(said.out)["warnings"])
    assert "degrees" in said.err


def test_a_tolerance_is_kept_in_a_stroke_of_minutes_too(tmp_path, capsys, material):
    table, plain, near = tmp_path / "long.csv", tmp_path / "plain.wav", tmp_path / "near.wav"
    rows = (f"{at / 10},{0.2 * math.sin(at / 10)},{0.05 + 0.03 * math.sin(0.9 * at)},1" for at in range(0, 1301))
    table.write_text(HEADER + "\n".join(rows) + "\n")
    for words, path in (((), plain), (("--tolerance", "-30"), near)):
        assert hnf("synth", "--material", material, "--action", table, *words, "--out", path) == 0
    assert "tolerance" not in capsys.readouterr().err
    one, two = (read_wav(path).samples.astype(float) for path in (plain, near))
    assert len(one) == len(two) == 1_300_000
    assert 0.0 < np.sqrt(np.mean(np.square(one - two))) < 0.05 * np.sqrt(np.mean(np.square(one)))
