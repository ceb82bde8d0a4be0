"""Stand-in tokens for unknown surfaces: category means, nearest tokens, and photographs as height."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.errors import FileError
from hnf_core.field.weights import HELD_OUT_WEIGHTS, load_field
from hnf_core.material.library import load_library
from hnf_core.material.token import BAND_FEATURES, LEVELS, SMOOTH_LEVEL
from hnf_lab.bootstrap import bootstrap_mean
from hnf_lab.evaluation.held_out import (
    KnownMaterial,
    compute_category_mean,
    compute_distance_db,
    describe_photo,
    find_category,
    find_held_out_names,
    find_nearest_token,
    fit_height_decades,
    make_held_out_table,
    make_photo_table,
    predict_spectrum,
    scale_token,
)

ACTION = make_steady_action(0.3, 0.1, 1.0)
FLAT = np.full(501, 1e-3)


def known(name: str, category: str, gain: float = 1.0) -> KnownMaterial:
    """A library material, its truth the field's own expectation times gain."""
    material = next(each for each in load_library() if each.name == name)
    one = KnownMaterial(name, category, material.token, material.mechanics, FLAT, FLAT)
    density = np.concatenate([[0.0], gain * predict_spectrum(load_field(), one, ACTION), np.zeros(400)])
    return replace(one, density=density, oracle=1.2589 * density)


def test_a_category_mean_is_a_mean_of_logarithms() -> None:
    one = known("oak-wood", "wood")
    others = [replace(one, density=4.0 * FLAT), replace(one, density=FLAT), replace(one, category="metal")]
    mean, what = compute_category_mean(one, others)
    np.testing.assert_allclose(mean, 2.0 * FLAT)
    assert what == "wood"
    assert compute_category_mean(replace(one, category="glass"), others)[1] == "all others"
    assert compute_distance_db(4.0 * FLAT, FLAT) == pytest.approx(20.0 * np.log10(2.0))


def test_the_nearest_token_is_the_same_material_when_it_is_there() -> None:
    everyone = [known(name, "") for name in ("oak-wood", "denim", "sandpaper", "silk")]
    slightly = replace(everyone[1], token=everyone[1].token + np.float32(0.01))
    assert find_nearest_token(slightly, everyone).name == "denim"


def test_margins_are_positive_only_for_an_accurate_field() -> None:
    trained = [known("pine-wood", "wood"), known("granite", "stone"), known("silk", "fabric")]
    good = make_held_out_table(load_field(), ACTION, [known("oak-wood", "wood"), known("denim", "fabric")], trained, 0)
    assert good.figures["margins"]["category mean"][1] > 0.0
    assert [entry["field, shared"] for entry in good.figures["classes"]] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert [entry["oracle, 8 s"] for entry in good.figures["classes"]] == pytest.approx([1.0, 1.0], abs=1e-3)
    bad = make_held_out_table(load_field(), ACTION, [known("pine-wood", "wood", 100.0)] * 2, trained[1:], 0)
    assert [entry["field_power_bias_db"] for entry in bad.figures["classes"]] == pytest.approx([-20.0, -20.0])


def test_an_interval_holds_its_mean_and_narrows() -> None:
    rng = np.random.default_rng(0)
    few, many = rng.normal(1.0, 1.0, 8), rng.normal(1.0, 1.0, 800)
    for values in (few, many):
        mean, low, high = bootstrap_mean(values, 1).to_list()
        assert low < mean < high
        assert mean == pytest.approx(values.mean())
    assert np.ptp(bootstrap_mean(many, 1).to_list()) < 0.3 * np.ptp(bootstrap_mean(few, 1).to_list())


def test_held_out_classes_are_those_that_the_weights_name() -> None:
    field = load_field()
    told = replace(field, metadata={"held_out": '["cork", "slate", "elsewhere"]'})
    assert find_held_out_names(told, ["brass", "cork", "slate"]) == ("cork", "slate")
    assert find_held_out_names(replace(field, metadata={}), ["cork"]) == ()
    assert find_held_out_names(replace(field, metadata={"held_out": "not json"}), ["cork"]) == ()


def photo(path: Path, pitch_mm: float) -> Path:
    matplotlib_image = pytest.importorskip("matplotlib.image")
    x = np.arange(600) / 15.0
    grey = np.broadcast_to(0.5 + 0.3 * np.sin(2.0 * np.pi * x / pitch_mm), (600, 600))
    matplotlib_image.imsave(path, np.repeat(grey[:, :, None], 3, axis=2))
    return path


def test_stripes_in_a_photograph_are_a_grating_in_the_token(tmp_path: Path) -> None:
    token = describe_photo(photo(tmp_path / "stripes.png", 1.0))
    levels: NDArray[np.float32] = token[LEVELS]
    band = int(np.argmax(levels))
    assert band == 3  # 1 mm
    features = dict(zip(BAND_FEATURES, token[band * len(BAND_FEATURES) :], strict=False))
    assert features["cos2"] == pytest.approx(1.0, abs=0.05)
    assert 10.0 ** features["level"] == pytest.approx(0.3 / np.sqrt(2.0) * 1e-5, rel=0.1)


def test_scaling_shifts_levels_and_extrapolates_unresolved_bands(tmp_path: Path) -> None:
    token = np.zeros(51, dtype=np.float32)
    token[LEVELS] = [-6.0, -6.2, -6.4, -6.6, -6.8, SMOOTH_LEVEL, SMOOTH_LEVEL]
    np.testing.assert_allclose(scale_token(token, 0.5)[LEVELS], [-5.5, -5.7, -5.9, -6.1, -6.3, -6.5, -6.7], atol=1e-5)
    assert scale_token(token, -9.0)[LEVELS].min() == SMOOTH_LEVEL
    assert token[LEVELS][-1] == SMOOTH_LEVEL


def test_one_factor_is_found_and_left_out(tmp_path: Path) -> None:
    """Truth = the field's own answer at one known factor: what leave-one-out must find again."""
    field, decades = load_field(), -1.3
    everyone = []
    for name, pitch in (("Wood", 2.0), ("Cork", 1.0), ("Denim", 0.7)):
        one = KnownMaterial(name, find_category(name), describe_photo(photo(tmp_path / f"{name}.png", pitch)),
                    known("oak-wood", "").mechanics, FLAT)  # fmt: skip
        truth = predict_spectrum(field, replace(one, token=scale_token(one.token, decades)), ACTION)
        everyone.append(replace(one, density=np.concatenate([[0.0], truth, np.zeros(400)])))
    assert [fit_height_decades(field, one, ACTION) for one in everyone] == pytest.approx([decades] * 3, abs=0.03)
    found = make_photo_table(field, everyone, ACTION).figures
    assert found["medians_db"]["photo_token_field_db"] < 0.6
    assert found["medians_db"]["nearest_photo_db"] > found["medians_db"]["photo_token_field_db"]


def test_names_have_categories_and_bad_pictures_a_message(tmp_path: Path) -> None:
    assert [find_category(name) for name in ("Sandpaper 100", "ABS Plastic", "Terra Cotta", "EPDM Foam", "Zzz")] == [
        "paper", "plastic", "stone", "foam", "",
    ]  # fmt: skip
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    with pytest.raises(FileError, match="picture"):
        describe_photo(tmp_path / "broken.jpg")


def test_held_out_weights_list_materials_of_every_category() -> None:
    categories = {material.name: material.category for material in load_library()}
    library = sorted(categories)
    names = find_held_out_names(load_field(HELD_OUT_WEIGHTS), library)
    assert len(names) == 12
    assert {categories[name] for name in names} == set(categories.values())
    assert find_held_out_names(load_field(), library) == ()
