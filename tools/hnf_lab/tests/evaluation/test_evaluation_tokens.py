"""Stand-ins for unknown surfaces: category means and nearest tokens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.weights import HELD_OUT_WEIGHTS, load_field
from hnf_core.material.library import load_library
from hnf_lab.bootstrap import bootstrap_mean
from hnf_lab.evaluation.held_out import (
    KnownMaterial,
    compute_category_mean,
    compute_distance_db,
    find_held_out_names,
    find_nearest_token,
    make_held_out_table,
    predict_spectrum,
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


def test_held_out_weights_list_materials_of_every_category() -> None:
    categories = {material.name: material.category for material in load_library()}
    library = sorted(categories)
    names = find_held_out_names(load_field(HELD_OUT_WEIGHTS), library)
    assert len(names) == 12
    assert {categories[name] for name in names} == set(categories.values())
    assert find_held_out_names(load_field(), library) == ()
