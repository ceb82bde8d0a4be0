"""Classes of surfaces and their instances."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import MaterialError
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.material_classes import (
    DEFAULT_SCATTER,
    MATERIAL_TABLE,
    compute_octave_height,
    get_category,
    get_recorded_category,
    list_classes,
    sample_instance,
)
from hnf_core.simulation.surface_recipe import SurfaceRecipe, height_map
from hnf_lab.evaluation.texture_statistics import aggregate_strokes, simulate_strokes
from hnf_lab.experiments.simulator import HATT_RANGES, check_ranges, compute_instrument_noise

CATEGORIES = {
    "wood", "metal", "stone", "fabric", "paper", "plastic", "foam", "carpet", "tile", "leather", "rubber", "glass",
}  # fmt: skip


def test_classes_cover_every_category_with_and_without_grain():
    assert len(list_classes()) == len(set(list_classes())) >= 24
    assert {get_category(name) for name in list_classes()} == CATEGORIES
    grained = {
        name
        for name in list_classes()
        for recipe in [sample_instance(name, 0)[0]]
        if recipe.lattices or any(part.stretch > 1.5 for part in (*recipe.noise, *recipe.grains))
    }
    assert len(grained) >= 8
    assert len(set(list_classes()) - grained) >= 8
    assert {get_recorded_category(name) for name in list_classes()} == {*HATT_RANGES, ""}


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(list_classes()), st.integers(0, 2**31))
def test_instances_are_distinct_near_their_class_and_valid(name, seed):
    recipe, mechanics = sample_instance(name, seed)
    assert (recipe, mechanics) == sample_instance(name, seed)
    assert sample_instance(name, seed + 1) != (recipe, mechanics)
    assert SurfaceRecipe.from_dict(json.loads(json.dumps(recipe.to_dict()))) == recipe
    mean = next(entry for entry in MATERIAL_TABLE if entry.name == name)
    for value, usual, deviation in (
        (mechanics.stiffness_n_m, mean.mechanics.stiffness_n_m, DEFAULT_SCATTER.stiffness),
        (mechanics.damping_ratio, mean.mechanics.damping_ratio, DEFAULT_SCATTER.damping),
        (mechanics.friction, mean.mechanics.friction, DEFAULT_SCATTER.friction),
    ):
        assert abs(np.log(value / usual)) <= 2.0 * deviation + 1e-9
    octave = compute_octave_height(recipe.noise[0], 1e-3)
    assert abs(np.log(octave / (mean.constants.height_um * 1e-6))) <= 2.0 * DEFAULT_SCATTER.level + 1e-9
    height = height_map(recipe, seed, pixels=256)
    assert np.isfinite(height).all()
    assert height.std() > 0.0


@pytest.mark.parametrize("name", ["denim", "knurled-metal", "carbon-fibre"])
def test_a_square_lattice_stays_square_and_keeps_its_waves(name):
    usual = next(entry for entry in MATERIAL_TABLE if entry.name == name).parts.lattices[0]
    for seed in range(20):
        waves = sample_instance(name, seed)[0].lattices[0].waves
        scale = waves[0][0] / usual.waves[0][0]
        for (x, y, a, phase), (ux, uy, ua, uphase) in zip(waves, usual.waves, strict=True):
            assert (x, y) == pytest.approx((ux * scale, uy * scale))
            assert (a, phase) == (ua, uphase)


def test_no_class_of_that_name():
    with pytest.raises(MaterialError, match="classes"):
        sample_instance("unobtainium", 0)


def test_a_handful_of_instances_feels_like_recorded_textures():
    names = ("oak-wood", "brushed-metal", "granite", "denim", "soft-foam", "terracotta")
    pieces = [
        (SmoothedMaps(height_map(recipe, 7)), own) for name in names for recipe, own in [sample_instance(name, 7)]
    ]
    power, frequency = simulate_strokes(pieces, 0.5)
    felt = [aggregate_strokes(each, frequency, compute_instrument_noise) for each in power]
    inside = [
        value
        for name, each in zip(names, felt, strict=True)
        for value in check_ranges(each, get_recorded_category(name)).values()
    ]
    assert len(inside) == 30
    assert np.mean(inside) >= 0.85
    brushed = felt[names.index("brushed-metal")]
    assert brushed.rms_across > 2.0 * brushed.rms_along
    levels = dict(zip(names, (each.rms for each in felt), strict=True))
    assert levels["granite"] > 2.0 * levels["oak-wood"]
