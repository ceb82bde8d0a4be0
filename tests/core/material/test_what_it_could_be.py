"""What a surface could be, weighed: the word for the stuff, and the expectation over a ranking."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.material.contact_model import MECHANICS_NAMES
from hnf_core.material.library import Appearance, get_material, load_library
from hnf_core.material.ranking import (
    ENOUGH_PROBABILITY,
    LOG_MECHANICS,
    PICTURE_ODDS,
    Suggestion,
    expect_material,
    mix_rankings,
    rank,
)
from hnf_core.material.token import BAND_FEATURES, LEVELS, TOKEN_DIM

LIBRARY = load_library()
BLANK = Appearance()
RED = (0.6, 0.02, 0.02)


def take(*names, look=BLANK):
    return rank(LIBRARY, look, names)[0]


@pytest.mark.parametrize(
    ("name", "material"),
    [
        ("Suede Shoe", "suede"),
        ("Terracotta Cup", "terracotta"),
        ("Velvet Scarf", "velvet"),
        ("Cork Board", "cork"),
        ("Granite Statue", "granite"),
        ("painted wood door", "painted-wood"),
        ("frosted glass", "frosted-glass"),
        ("Shoe", "leather"),
        ("Paper Plate", "kraft-paper"),
    ],
)
def test_the_stuff_outweighs_the_thing(name, material) -> None:
    assert take(name).name == material


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(["suede", "cork", "granite", "velvet", "terracotta", "denim", "brick", "silk"]),
       st.sampled_from(["shoe", "cup", "scarf", "board", "statue", "bag", "sofa", "wheel", "bottle", "table"]),
       st.booleans())  # fmt: skip
def test_no_thing_changes_what_the_stuff_is(stuff, thing, is_object) -> None:
    alone = take(stuff).name
    names = (stuff, thing) if is_object else (f"{stuff}_{thing}",)
    assert take(*names).name == alone


@pytest.mark.parametrize(
    "name",
    ["Material.001", "PBR", "Principled BSDF", "Metallic Roughness", "MetallicRoughness", "CC0", "UV Checker",
     "Oak_Leaves", "pine needles", "CherryBlossom"],
)  # fmt: skip
def test_a_way_of_working_and_a_plant_are_no_material(name) -> None:
    assert rank(LIBRARY, BLANK, [name]) == rank(LIBRARY, BLANK, [])


def test_a_tree_is_wood_where_no_part_of_a_plant_is_named() -> None:
    assert take("Oak").name == "oak-wood"
    assert take("Oak_Leaves_Wood").name == "oak-wood"
    assert take("Gold Leaf").name == "brass"


@pytest.mark.parametrize("metallic", [0.0, 0.3])
def test_a_metal_of_a_paint_s_color_is_painted(metallic) -> None:
    assert take("metalRed", look=Appearance(RED, 0.4, metallic)).name == "painted-metal"
    assert take("metal", look=Appearance((0.56, 0.57, 0.58), 0.25, 1.0)).name == "smooth-metal"


def suggest(weights) -> list[Suggestion]:
    total = sum(weights)
    ranked = [
        Suggestion(material.name, 0.5, "", weight / total) for material, weight in zip(LIBRARY, weights, strict=True)
    ]
    return sorted(ranked, key=lambda suggestion: -suggestion.probability)


weights = st.lists(st.floats(0.1, 1.0), min_size=len(LIBRARY), max_size=len(LIBRARY))


@settings(max_examples=40, deadline=None)
@given(weights)
def test_the_expectation_lies_between_and_has_no_lines(values) -> None:
    ranked = suggest(values)
    felt = expect_material(LIBRARY, ranked)
    tokens = np.stack([material.token for material in LIBRARY])
    assert felt.name == ranked[0].name
    assert (felt.token[LEVELS] >= tokens[:, LEVELS].min(axis=0) - 1e-5).all()
    assert (felt.token[LEVELS] <= tokens[:, LEVELS].max(axis=0) + 1e-5).all()
    bands = felt.token[: TOKEN_DIM - 2].reshape(-1, len(BAND_FEATURES))
    peaks = tokens[:, BAND_FEATURES.index("peak") : TOKEN_DIM - 2 : len(BAND_FEATURES)]
    np.testing.assert_array_equal(bands[:, BAND_FEATURES.index("peak")], peaks.min(axis=0))
    for name in MECHANICS_NAMES[:-1]:
        known = [value for each in LIBRARY if (value := getattr(each.mechanics, name)) is not None]
        assert min(known) - 1e-12 <= getattr(felt.mechanics, name) <= max(known) + 1e-9
    assert felt.mechanics.thread_spacing_m == 0.0


@settings(max_examples=20, deadline=None)
@given(weights, st.randoms(use_true_random=False))
def test_the_order_of_the_library_does_not_matter(values, random) -> None:
    ranked = suggest(values)
    shuffled = list(LIBRARY)
    random.shuffle(shuffled)
    first, second = expect_material(LIBRARY, ranked), expect_material(shuffled, ranked)
    np.testing.assert_array_equal(first.token, second.token)
    assert first.mechanics == second.mechanics


def test_two_alike_materials_are_averaged_in_decibels() -> None:
    soft, hard = get_material("soft-foam"), get_material("granite")
    ranked = [Suggestion("granite", 0.5, "", 0.49), Suggestion("soft-foam", 0.5, "", 0.49)]
    felt = expect_material((soft, hard), ranked)
    np.testing.assert_allclose(felt.token[LEVELS], 0.5 * (soft.token + hard.token)[LEVELS], rtol=1e-5)
    for name in LOG_MECHANICS:
        pair = getattr(soft.mechanics, name), getattr(hard.mechanics, name)
        assert getattr(felt.mechanics, name) == pytest.approx(np.sqrt(pair[0] * pair[1]))


def test_what_holds_enough_is_felt_alone() -> None:
    denim = get_material("denim")
    enough = [Suggestion("denim", 0.9, "", ENOUGH_PROBABILITY), Suggestion("velvet", 0.9, "", 1 - ENOUGH_PROBABILITY)]
    assert expect_material(LIBRARY, enough) is denim
    assert expect_material(LIBRARY, rank(LIBRARY, BLANK, ["Denim"])) is denim
    unknown = expect_material(LIBRARY, rank(LIBRARY, BLANK, ["Material"]))
    assert unknown.mechanics != get_material(unknown.name).mechanics


def test_mechanics_are_unknown_only_where_none_knows_them() -> None:
    one = replace(get_material("denim"), mechanics=replace(get_material("denim").mechanics, friction=None))
    two = get_material("velvet")
    ranked = [Suggestion("denim", 0.5, "", 0.4), Suggestion("velvet", 0.5, "", 0.4)]
    assert expect_material((one, two), ranked).mechanics.friction == pytest.approx(two.mechanics.friction)
    blind = [replace(each, mechanics=replace(each.mechanics, friction=None)) for each in (one, two)]
    assert expect_material(blind, ranked).mechanics.friction is None
    assert len(astuple(expect_material(blind, ranked).mechanics)) == len(MECHANICS_NAMES)


def test_a_picture_makes_what_pictures_show_likelier() -> None:
    category = {material.name: material.category for material in LIBRARY}

    def sum_categories(look):
        shares: dict[str, float] = {}
        for suggestion in rank(LIBRARY, BLANK, [""], look=look):
            shares[category[suggestion.name]] = shares.get(category[suggestion.name], 0.0) + suggestion.probability
        return shares

    plain, seen = sum_categories({}), sum_categories(PICTURE_ODDS)
    assert seen["fabric"] > plain["fabric"]
    assert seen["glass"] < plain["glass"]
    assert rank(LIBRARY, BLANK, ["glass"], look=PICTURE_ODDS)[0].name == "clear-glass"


COLORS = st.lists(st.tuples(*[st.floats(0.0, 1.0)] * 3), min_size=1, max_size=4)


@settings(max_examples=20, deadline=None)
@given(colors=COLORS, sizes=st.lists(st.floats(0.1, 10.0), min_size=4, max_size=4))
def test_parts_of_a_surface_are_as_probable_as_they_are_large(colors, sizes) -> None:
    parts, shares = [rank(LIBRARY, Appearance(color), ["scan"]) for color in colors], sizes[: len(colors)]
    mixed = mix_rankings(LIBRARY, parts, shares)
    assert sorted(each.name for each in mixed) == sorted(material.name for material in LIBRARY)
    assert [each.confidence for each in mixed] == sorted((each.confidence for each in mixed), reverse=True)
    found = {each.name: each.probability for each in mixed}
    by_part = [{each.name: each.probability for each in part} for part in parts]
    for name, probability in found.items():
        expected = np.average([part[name] for part in by_part], weights=shares)
        assert probability == pytest.approx(expected, abs=1e-12)
    same = mix_rankings(LIBRARY, [parts[0], parts[0]], shares[:1] * 2)
    assert [each.name for each in same] == [each.name for each in parts[0]]
