"""Probe files: built-in ones, one's own, and what is wrong with a bad one."""

from __future__ import annotations

from pathlib import Path

import pytest

from hnf_core.cli.main import main
from hnf_core.errors import UsageError
from hnf_core.export.wav import read_wav
from hnf_core.material.probe import PROBE_NAMES, BodyMode, get_probe, is_probe

STYLUS = """
name = "my-stylus"
mass_kg = 0.02
tip_radius_m = 0.8e-3
stiffness_n_m = 2.0e5
[hand]
stiffness_n_m = 300.0
damping_ratio = 2.0
[[body_modes]]
frequency_hz = 600.0
damping_ratio = 0.1
gain = 0.5
"""


PROBE_FOLDER = Path(__file__).resolve().parents[3] / "hnf_core" / "data" / "probes"


def refuse_blender(_arguments):
    raise AssertionError("hnf synth needs no Blender")


def write_probe(folder, text):
    path = folder / "probe.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_built_in_probes_are_what_their_names_say():
    assert [get_probe(name).name for name in PROBE_NAMES] == list(PROBE_NAMES)
    pen, rigid, finger = (get_probe(name) for name in ("pen", "rigid-tip", "finger"))
    assert rigid._replace(name="pen", body_modes=pen.body_modes) == pen
    assert pen.body_modes
    assert not rigid.body_modes
    assert (pen.kind, rigid.kind, finger.kind) == ("pen", "pen", "finger")
    assert pen.pad is None
    assert finger.pad is not None


def test_a_file_describes_a_stylus_of_ones_own(tmp_path):
    probe = get_probe(write_probe(tmp_path, STYLUS))
    assert probe[:4] == ("my-stylus", 0.02, 0.8e-3, 2.0e5)
    assert (probe.hand_stiffness_n_m, probe.hand_damping_ratio) == (300.0, 2.0)
    assert probe.body_modes == (BodyMode(600.0, 0.1, 0.5),)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("mass_kg = 0.02", "mass_kg = -1", "mass_kg must be a number"),
        ("mass_kg = 0.02", "mass_kg = nan", "mass_kg must be a number"),
        ("mass_kg = 0.02", 'mass_kg = "heavy"', "mass_kg must be a number"),
        ("mass_kg = 0.02", "mass_kg = true", "mass_kg must be a number"),
        ("mass_kg = 0.02\n", "", "'mass_kg' is missing"),
        ("damping_ratio = 2.0\n", "", "'hand.damping_ratio' is missing"),
        ("gain = 0.5", "gain = 1e9", "body_modes.gain"),
        ("gain = 0.5", "gain = 0.5\n[sound]\nvolume = 3", "unknown entry 'sound'"),
        ("gain = 0.5", "gain = 0.5\ncolor = 3", "unknown entry 'body_modes.color'"),
        ("[hand]", "[hand]\nstrength_n = 3", "unknown entry 'hand.strength_n'"),
        ("[hand]", "[pad]\nskin_mass_kg = 1e-4\n[hand]", "'pad.skin_stiffness_n_m' is missing"),
        ("mass_kg = 0.02", 'mass_kg = 0.02\nsoft_tip = "no"', "soft_tip must be true or false"),
        ("[[body_modes]]", "[body_modes]", "body_modes must be tables"),
        ("[hand]\n", "hand = 3\n[other]\n", "unknown entry 'other'"),
        ("[hand]\nstiffness_n_m = 300.0\ndamping_ratio = 2.0\n", "hand = 3\n", "hand must be a table"),
        ("[hand]\nstiffness_n_m = 300.0\ndamping_ratio = 2.0\n", "", "'hand.stiffness_n_m' is missing"),
        ("0.8e-3", "0.8e-3 # \x00", "this is no probe"),
        ("[hand]", "hand = 3\n[other]", "this is no probe"),
        ("name =", "name", "this is no probe"),
    ],
)
def test_impossible_constants_are_named_in_one_line(tmp_path, old, new, named):
    assert old in STYLUS
    path = write_probe(tmp_path, STYLUS.replace(old, new, 1))
    with pytest.raises(UsageError, match=r"probe\.toml") as error:
        get_probe(path)
    assert named in str(error.value)
    assert "\n" not in str(error.value)
    assert not is_probe(path)


@pytest.mark.parametrize("name", PROBE_NAMES)
def test_a_copy_of_a_built_in_file_is_that_probe(tmp_path, name):
    copied = tmp_path / "copy.toml"
    copied.write_bytes((PROBE_FOLDER / f"{name}.toml").read_bytes())
    assert get_probe(str(copied)) == get_probe(name)
    made = []
    for probe in (name, str(copied)):
        made.append(tmp_path / f"{len(made)}.wav")
        command = ["synth", "--material", "denim", "--stroke", "left-right-soft", "--probe", probe]
        assert main([*command, "--out", str(made[-1])], refuse_blender) == 0
    first, second = (read_wav(path) for path in made)
    assert first.samples.tobytes() == second.samples.tobytes()
    assert second.provenance["probe"] == str(copied)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"", b"name = "])
def test_a_file_that_is_no_table_is_refused_by_name(tmp_path, content):
    path = tmp_path / "probe.toml"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"probe\.toml: this is no probe") as error:
        get_probe(str(path))
    assert len(str(error.value).splitlines()) == 1


def test_a_probe_file_that_is_mended_is_read_again(tmp_path):
    path = write_probe(tmp_path, STYLUS.replace("mass_kg = 0.02", "mass_kg = 0"))
    assert not is_probe(path)
    write_probe(tmp_path, STYLUS)
    assert get_probe(path).mass_kg == 0.02


def test_a_bad_probe_ends_a_command_in_one_line(tmp_path, capsys):
    bad = write_probe(tmp_path, STYLUS.replace("mass_kg = 0.02", "mass_kg = -1"))
    command = ["synth", "--material", "denim", "--stroke", "left-right-soft", "--out", str(tmp_path / "x.wav")]
    for probe, problem, remedy in (
        ("nonsense", "there is no probe 'nonsense'", "Take pen, finger, rigid-tip"),
        (str(tmp_path / "none.toml"), "cannot be read", "Check the path"),
        (bad, "mass_kg must be a number from 1e-05 to 10, not -1", "pen.toml"),
    ):
        assert main([*command, "--probe", probe], refuse_blender) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert problem in line
        assert remedy in line


def test_an_unknown_probe_is_answered_by_the_names_there_are(tmp_path, capsys):
    out = tmp_path / "x.wav"
    command = ["synth", "--material", "denim", "--stroke", "left-right-soft", "--out", str(out), "--probe"]
    for probe, named in (("thumb", "rigid-tip"), (str(tmp_path / "none.toml"), "cannot be read")):
        assert main([*command, probe], refuse_blender) != 0
        assert named in capsys.readouterr().err
        assert not out.exists()
    assert main([*command, write_probe(tmp_path, STYLUS)], refuse_blender) == 0
    assert out.stat().st_size > 1000
