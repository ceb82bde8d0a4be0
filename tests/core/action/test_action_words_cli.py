"""--stroke in words: the same bytes as the fixed name, and any direction, force and speed."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.action.action import read_action_csv, write_action_csv
from hnf_core.action.parse_stroke import parse_stroke
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVE_NAMES, PRIMITIVES
from hnf_core.action.stroke_tokens import EXAMPLES
from hnf_core.cli.main import build_parser, main
from hnf_core.cli.touch import make_touch_request
from hnf_core.export.wav import read_wav
from hnf_core.field.weights import load_field
from hnf_core.material.library import load_library

MATERIAL = load_library()[0].name


def no_blender(arguments):
    raise AssertionError("synth needs no Blender")


def synth(tmp_path, capsys, stroke, name="x.wav", more=()):
    out = tmp_path / name
    words = ["synth", "--material", MATERIAL, "--stroke", stroke, "--out", str(out), "--json", *more]
    assert main(words, no_blender) == 0
    return out, json.loads(capsys.readouterr().out)


def test_words_and_the_fixed_name_write_the_same_bytes(tmp_path, capsys):
    fixed, named = synth(tmp_path, capsys, "left-right-hard", "a.wav")
    words, said = synth(tmp_path, capsys, "scrape left to right, hard", "b.wav")
    assert fixed.read_bytes() == words.read_bytes()
    assert named["stroke"] == said["stroke"] == "left-right-hard"


def test_force_and_speed_are_those_said(tmp_path, capsys):
    out, record = synth(tmp_path, capsys, "scrape right to left, 1.5 N, 80 mm/s")
    assert record["stroke"] == read_wav(out).provenance["stroke"] == "right-left-1.5n-80mm-s"
    assert (record["confidence"], record["warnings"]) == (1.0, [])
    action = make_primitive_action(parse_stroke("scrape right to left, 1.5 N, 80 mm/s"))
    assert action.force.max() == pytest.approx(1.5)
    assert action.speed.max() == pytest.approx(0.08)
    np.testing.assert_array_equal(action.direction, np.tile([-1.0, 0.0], (len(action.force), 1)))


def test_out_of_range_is_said_in_json_and_on_stderr(tmp_path, capsys):
    out = tmp_path / "x.wav"
    words = ["--material", MATERIAL, "--stroke", "scrape right to left, 20 N, 0.9 m/s", "--out", str(out), "--json"]
    assert main(["synth", *words], no_blender) == 0
    told = capsys.readouterr()
    record = json.loads(told.out)
    ranges = load_field().ranges
    top_speed, top_force = ranges.speed[1], ranges.force[1]
    assert record["confidence"] <= 1.0 / (1.0 + np.log2(0.89 / top_speed)) / (1.0 + np.log2(19.5 / top_force))
    speed, force = (next(text for text in record["warnings"] if text.startswith(word)) for word in ("Speed", "Force"))
    assert float(speed.split()[2]) == pytest.approx(900.0, rel=0.01)
    assert f"mm/s, trained on {ranges.speed[0] * 1e3:.3g}–{top_speed * 1e3:.3g} mm/s" in speed
    assert "20 N, trained on" in force
    for text in record["warnings"]:
        assert text in told.err


@pytest.mark.parametrize("stroke", ["no-such-stroke", "scrape hard and soft", "scrape 80"])
def test_refused_words_cost_exit_code_2_and_one_line(tmp_path, capsys, stroke):
    words = ["--material", MATERIAL, "--stroke", stroke, "--out", str(tmp_path / "x.wav")]
    assert main(["synth", *words], no_blender) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["touch", "x.blend", "--out", str(tmp_path), "--stroke", stroke, "--on", "Cup"], no_blender) == 2
    assert f"stroke '{stroke}'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["touch", "synth"])
def test_help_lists_the_eight_and_an_example(capsys, verb):
    assert main([verb, "--help"], no_blender) == 0
    text = " ".join(capsys.readouterr().out.split()).replace("- ", "-")
    assert all(name in text for name in PRIMITIVE_NAMES)
    assert "scrape right to left, 1.5 N, 80 mm/s" in text


def test_touch_passes_words_on_as_a_primitive():
    words = [
        "touch",
        "x.blend",
        "--out",
        "r",
        "--stroke",
        "rub, fast",
        "--on",
        "Cup",
        "--stroke",
        "up, 3 N",
        "--on",
        "Cup",
    ]
    request = make_touch_request(build_parser(no_blender).parse_args(words))
    first, second = (placement.primitive for placement in request.strokes)
    assert first is PRIMITIVES["rub-fast"]
    assert (second.name, second.force, second.direction) == ("bottom-top-3n-100mm-s", 3.0, (0.0, 1.0))


@pytest.mark.parametrize(
    "words", ["left-right-soft", "back and forth twice, slowly", "tap twice, then rub in circles", "drum for 1 s, 2 N"]
)
def test_a_written_action_is_felt_as_the_words(tmp_path, capsys, words):
    table, again = tmp_path / "said.csv", tmp_path / "again.wav"
    out, record = synth(tmp_path, capsys, words, more=["--write-action", str(table)])
    assert record["action"] == str(table)
    shared = ["synth", "--material", MATERIAL, "--action", str(table), "--out", str(again)]
    assert main(shared, no_blender) == 0
    said, read = read_wav(out).samples, read_wav(again).samples
    np.testing.assert_allclose(read, said, atol=1e-6 * np.abs(said).max())
    assert main([*shared, "--write-action", str(tmp_path / "x.csv")], no_blender) == 2
    assert "Leave out one" in capsys.readouterr().err
    assert not (tmp_path / "x.csv").exists()


@given(st.sampled_from(EXAMPLES), st.integers(0, 5))
def test_a_table_keeps_every_action_in_words(tmp_path_factory, words, seed):
    action = make_primitive_action(parse_stroke(words), seed=seed)
    path = tmp_path_factory.mktemp("table") / "said.csv"
    write_action_csv(path, action)
    told = []
    read = read_action_csv(path, warn=told.append)
    assert told == []
    for name in ("speed", "force", "position", "contact"):
        np.testing.assert_array_equal(getattr(read, name), getattr(action, name))
    np.testing.assert_allclose(read.direction, action.direction, atol=1e-15)
    assert (read.rate, read.force_curve) == (action.rate, None)


def test_a_table_of_words_starts_with_the_columns_that_are_read(tmp_path):
    write_action_csv(tmp_path / "said.csv", make_primitive_action("rub-slow"))
    header, first, *_ = (tmp_path / "said.csv").read_text().splitlines()
    assert header == "time_s,direction_rad,speed_m_s,force_n,position_m"
    assert len(first.split(",")) == 5
