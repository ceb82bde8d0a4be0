"""`hnf describe` and `hnf synth --touch`: from a picture of a touch sensor to numbers, files and a vibration."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from touch_frames import PIXEL_M, SHAPE, draw_relief, make_relief, write_frame, write_presses

from hnf_core.cli.main import main
from hnf_core.export.wav import read_wav
from hnf_core.material.band_descriptor import describe
from hnf_core.material.library import load_library
from hnf_core.material.token import LEVELS
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import SENSORS

BILLETS = Path(__file__).resolve().parents[4] / "shared/data/gelsight_billets"


def hnf(*words) -> int:
    def no_blender(_arguments):
        raise AssertionError("this needs no Blender")

    return main([str(word) for word in words], no_blender)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A sensor's folder: background, calibration, and one touch of a rough surface."""
    folder = tmp_path_factory.mktemp("sensor")
    write_presses(folder / "presses", "gelsight")
    calibration = folder / "calibration.json"
    words = ("--calibrate", folder / "presses", "--mm-per-pixel", 1e3 * PIXEL_M, "--out", calibration)
    assert hnf("describe", *words) == 0
    press = write_frame(folder / "press.png", draw_relief(SENSORS["gelsight"]))
    return press, ("--background", folder / "presses" / "background.png", "--calibration", calibration)


def test_a_picture_gives_the_token_of_the_surface_it_shows(bench, tmp_path, capsys):
    press, options = bench
    height, picture = tmp_path / "h.npy", tmp_path / "map.png"
    assert hnf("describe", press, *options, "--height", height, "--json") == 0
    output = capsys.readouterr()
    record = json.loads(output.out)
    assert output.err == ""
    assert record["calibrated"]
    assert record["contact_share"] > 0.9
    metres = np.load(height, allow_pickle=False)
    assert metres.shape == SHAPE
    assert 1e6 * metres.std() == pytest.approx(record["height_rms_um"], rel=0.05)
    true = 10.0 ** describe(tactile_map_from_height(make_relief(), None, PIXEL_M, 2 * PIXEL_M)).values[LEVELS]
    measured = [band["rms_um"] for band in record["bands"]]
    assert np.array(measured[1:5], float) == pytest.approx(1e6 * true[1:5], rel=0.1)
    assert measured[0] is None
    assert record["token"]["level@8mm"] is None
    assert {each["name"] for each in record["materials"]} == {each.name for each in load_library()}
    assert sum(each["probability"] for each in record["materials"]) == pytest.approx(1.0)
    pytest.importorskip("matplotlib", reason="the picture needs matplotlib")
    assert hnf("describe", press, *options, "--picture", picture) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "0.5 mm: " in capsys.readouterr().out


def test_a_height_file_is_an_exr(bench, tmp_path):
    exr = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed here")
    press, options = bench
    paths = tmp_path / "h.exr", tmp_path / "h.npy"
    for path in paths:
        assert hnf("describe", press, *options, "--height", path) == 0
    stored = exr.File(str(paths[0]), separate_channels=True).channels()["Y"].pixels
    assert np.array_equal(stored, np.load(paths[1]))


def test_a_touch_is_felt_and_the_wav_says_of_what(bench, tmp_path, capsys):
    press, options = bench
    nearest, named = tmp_path / "nearest.wav", tmp_path / "named.wav"
    common = ("synth", "--touch", press, *options, "--stroke", "left-right-soft")
    assert hnf(*common, "--out", nearest, "--json") == 0
    output = capsys.readouterr()
    record = json.loads(output.out)
    assert "is the nearest material" in output.err
    assert hnf(*common, "--material", "cork", "--out", named) == 0
    provenance = read_wav(nearest).provenance
    assert provenance["touch"] == "press.png"
    assert provenance["material"] == record["material"]
    assert provenance["touch_bands"].split()[1:4] == ["measured"] * 3
    assert read_wav(named).provenance["material"] == "cork"
    assert not np.array_equal(read_wav(named).samples, read_wav(nearest).samples)


def test_what_is_measured_does_not_depend_on_the_material(bench, tmp_path):
    """Half the relief is felt as less, whatever material gives the rest."""
    press, options = bench
    softer = write_frame(tmp_path / "softer.png", draw_relief(SENSORS["gelsight"], 10e-6))
    level = []
    for path in (press, softer):
        words = ("--touch", path, *options, "--material", "smooth-plastic", "--stroke", "left-right-hard")
        assert hnf("synth", *words, "--out", tmp_path / "x.wav") == 0
        level.append(read_wav(tmp_path / "x.wav").rms)
    assert level[0] > 2.0 * level[1]


def test_without_calibration_confidence_falls_and_a_line_says_so(bench, tmp_path, capsys):
    press, options = bench
    confidence = []
    for some in (options, options[:2]):
        out = tmp_path / "x.wav"
        assert hnf("synth", "--touch", press, *some, "--material", "cork", "--stroke", "rub-slow", "--out", out) == 0
        confidence.append(float(read_wav(out).provenance["touch_confidence"]))
        lines = capsys.readouterr().err.splitlines()
    assert confidence[1] < confidence[0]
    assert sum("no calibration" in line for line in lines) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("describe",), "one picture, or --calibrate"),
        (("describe", "{press}", "--sensor", "tactip"), "Choose one of gelsight, digit"),
        (("describe", "{press}", "--sensor", "digit", "--calibration", "{calibration}"), "Leave one of them out"),
        (("describe", "{press}", "--calibration", "none.json"), "hnf describe --calibrate"),
        (("describe", "{press}", "--background", "none.png"), "none.png"),
        (("describe", "{flat}", "--background", "{flat}"), "nothing touches"),
        (("describe", "{bright}", "--background", "{flat}"), "Lower the camera's exposure"),
        (("describe", "{small}", "--background", "{flat}"), "same settings"),
        (("describe", "{press}", "--mm-per-pixel", "0"), "not within 0.0001 to 10"),
        (("describe", "{press}", "--height", "h.txt"), ".exr or .npy"),
        (("describe", "--calibrate", "{folder}"), "--out FILE.json and --mm-per-pixel"),
        (("synth", "--stroke", "rub-slow", "--out", "x.wav"), "--touch IMAGE"),
        (("synth", "--material", "cork", "--sensor", "digit", "--stroke", "rub-slow", "--out", "x.wav"), "--touch"),
        (("synth", "--touch", "{press}", "--material", "a.hnf", "--stroke", "rub-slow", "--out", "x.wav"), "library"),
    ],
)
def test_bad_input_is_one_line_with_the_remedy(bench, tmp_path, capsys, monkeypatch, words, message):
    press, options = bench
    monkeypatch.chdir(tmp_path)
    names = {
        "press": press, "flat": options[1], "calibration": options[3], "folder": press.parent / "presses",
        "bright": write_frame(tmp_path / "bright.png", 3.0 * draw_relief(SENSORS["gelsight"])),
        "small": write_frame(tmp_path / "small.png", draw_relief(SENSORS["gelsight"])[:60]),
    }  # fmt: skip
    assert hnf(*(word.format(**names) for word in words)) in (1, 2)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.skipif(not BILLETS.is_dir(), reason="the steel's frames (shared/data/gelsight_billets) are not here")
def test_real_frames_of_steel_need_no_calibration(capsys):
    for name in ("ground_b1_1", "rough_b7_5"):
        assert hnf("describe", BILLETS / f"{name}_gelsight.png", "--json") == 0
        record = json.loads(capsys.readouterr().out)
        assert not record["calibrated"]
        assert record["integrability_db"] > 4.8
        assert len(record["notes"]) >= 2
        assert max(each["confidence"] for each in record["materials"]) < 0.3
