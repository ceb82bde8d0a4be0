"""Judge of recordings: laws of distance, bands, exponents and baselines; the command on a made-up copy of HaTT."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hatt_files import HATT, model_xml, needs_hatt
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.cli.main import main
from hnf_core.errors import FileError
from hnf_lab.evaluation.recordings.measure import (
    CONDITIONS,
    choose_material,
    compute_baselines,
    describe_signal,
    find_category,
    read_textures,
)
from hnf_lab.evaluation.recordings.report import summarise
from hnf_lab.evaluation.recordings.spectra import (
    FINE_HZ,
    STEP_HZ,
    THIRD_OCTAVES_HZ,
    average_bins_db,
    compare_levels,
    fit_exponents,
    sum_third_octaves_db,
)

SEEDS = st.integers(0, 10**6)


def draw_density(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.exp(np.interp(FINE_HZ, np.linspace(16.0, 1130.0, 9), rng.normal(-6.0, 2.0, 9)))


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.floats(-30.0, 30.0))
def test_a_gain_is_all_level_and_no_shape(seed, gain_db):
    recorded = average_bins_db(draw_density(seed))
    distance = compare_levels(recorded + gain_db, recorded)
    assert distance.level == pytest.approx(gain_db, abs=1e-9)
    assert distance.shape == pytest.approx(0.0, abs=1e-9)
    assert distance.total == pytest.approx(abs(gain_db), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(SEEDS, SEEDS)
def test_total_is_the_rms_over_the_bins_that_count(seed, other):
    recorded, levels = (average_bins_db(draw_density(number)) for number in (seed, other))
    counted = recorded >= recorded.max() - 30.0
    distance = compare_levels(levels, recorded)
    assert distance.total == pytest.approx(np.sqrt(np.mean(np.square((levels - recorded)[counted]))))
    beyond = np.where(counted, levels, levels + 50.0)
    assert compare_levels(beyond, recorded) == distance


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_third_octaves_hold_all_the_power(seed):
    density = draw_density(seed)
    edges = THIRD_OCTAVES_HZ[[0, -1]] * 2.0 ** np.array([-1 / 6, 1 / 6])
    weight = np.clip(np.minimum(FINE_HZ + 1.0, edges[1]) - np.maximum(FINE_HZ - 1.0, edges[0]), 0.0, STEP_HZ)
    bands = 10.0 ** (sum_third_octaves_db(density) / 10.0)
    assert bands.sum() == pytest.approx(density @ weight)
    flat = 10.0 ** (sum_third_octaves_db(np.ones_like(FINE_HZ)) / 10.0)
    np.testing.assert_allclose(flat, THIRD_OCTAVES_HZ * (2.0 ** (1 / 6) - 2.0 ** (-1 / 6)))


@settings(max_examples=40, deadline=None)
@given(st.floats(-1.0, 3.0), st.floats(-1.0, 1.0))
def test_exponents_of_a_power_law_are_found(speed_exponent, force_exponent):
    speed, force = np.array(CONDITIONS).T
    levels = 20.0 * np.log10(speed**speed_exponent * force**force_exponent)[:, None] + np.array([0.0, -20.0])
    found = fit_exponents(levels, speed, force)
    np.testing.assert_allclose(found[0], speed_exponent, atol=1e-9)
    np.testing.assert_allclose(found[1], force_exponent, atol=1e-9)
    assert np.isnan(fit_exponents(levels[:3], speed[:3], force[:3])).all()  # one speed tells nothing of speed


@pytest.mark.parametrize(
    ("name", "category"),
    [("Paper Plate", "paper"), ("Floortile 4", "tile"), ("Velcro Loops", "fabric"), ("Metal Shelving", "metal"),
     ("Artificial Grass", "carpet"), ("Terra Cotta", "stone"), ("Stone Tile 1", "tile"), ("Object 7", "")],
)  # fmt: skip
def test_categories_follow_the_names(name, category):
    assert find_category(name) == category


def test_a_gaussian_signal_has_no_kurtosis_and_a_pulsed_one_has():
    noise = np.random.default_rng(0).standard_normal(100_000)
    kurtosis, crest, modulation = describe_signal(noise, 10_000.0)
    assert abs(kurtosis) < 0.1
    assert 3.5 < crest < 6.0
    assert modulation < 0.1
    pulsed = noise * (np.arange(100_000) % 2000 < 200)
    assert describe_signal(pulsed, 10_000.0)[0] > 10.0
    assert describe_signal(pulsed, 10_000.0)[2] > 1.0


def write_copy(folder: Path) -> Path:
    """A made-up copy of HaTT: two denims, a foam and a thing without a word for its material."""
    for number, name in enumerate(("Denim 1", "Denim 2", "EPDM Foam", "Thing")):
        text = model_xml(swap=[("Test Cloth", name), ("<var>0.05</var>", f"<var>{0.05 * 4.0**number}</var>")])
        (folder / f"Models_{name}.xml").write_text(text, encoding="utf-8")
    return folder


def test_baselines_leave_the_texture_itself_out(tmp_path):
    textures = read_textures(write_copy(tmp_path))
    by_name = {texture.name: texture for texture in textures}
    assert [texture.stem for texture in textures] == ["denim", "denim", "epdm foam", "thing"]
    everything, category, namesakes, another = compute_baselines(by_name["Denim 1"], textures)
    assert category == namesakes == another
    assert category.total > 0.1
    assert everything.total > category.total
    alone = compute_baselines(by_name["Thing"], textures)
    assert np.isnan([distance.total for distance in alone[1:]]).all()
    assert summarise([1.0, float("nan"), 3.0]) == (2.0, pytest.approx(2.8), 2)


def test_the_command_writes_report_figures_and_picture(tmp_path, capsys):
    copy, out = tmp_path / "hatt", tmp_path / "out"
    copy.mkdir()
    write_copy(copy)
    words = ["eval", "recordings", "--hatt", str(copy), "--out", str(out), "--seconds", "0.5"]
    assert main(words, lambda arguments: 1) == 0
    printed = capsys.readouterr().out
    assert "mean of its category" in printed
    assert (out / "recordings.md").read_text("utf-8").strip() == printed.strip()
    record = json.loads((out / "recordings.json").read_text("utf-8"))
    assert {entry["name"]: entry["material"] for entry in record["textures"]}["Denim 2"] == "denim"
    assert "no word matches" in {entry["reason"] for entry in record["textures"]}
    for entry in record["textures"]:
        assert entry["distance_db"] >= max(entry["shape_db"], 0.0)
    assert (out / "recordings.png").stat().st_size > 10_000
    assert {entry["material"] for entry in record["statistics"]} >= {"denim", "eva-foam"}


def test_a_folder_without_models_is_refused(tmp_path):
    with pytest.raises(FileError):
        read_textures(tmp_path)
    assert main(["eval", "recordings", "--hatt", str(tmp_path), "--seconds", "0.1"], lambda arguments: 1) == 2


@needs_hatt
def test_baselines_on_real_recordings_are_as_measured():
    """The figures that every answer has to be held against, on the 50 textures of the sample."""
    textures = read_textures(HATT)
    assert len(textures) == 50
    medians = [summarise([b.total for b in column])[0] for column in zip(
        *(compute_baselines(texture, textures) for texture in textures), strict=True)]  # fmt: skip
    assert medians[0] == pytest.approx(7.4, abs=0.2)
    assert medians[1] == pytest.approx(5.1, abs=0.2)
    assert choose_material("Leather 1 Front")[0].name == "leather"
