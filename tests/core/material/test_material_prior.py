"""The prior route: names and shading values, alone and combined."""

import dataclasses

import numpy as np
import pytest
from asset_names import HELD_BACK, TUNED
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import MaterialError
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.library import Appearance, LibraryMaterial, load_library
from hnf_core.material.name_matching import (
    CATEGORY_WORDS,
    build_vocabulary,
    is_image_name,
    list_singulars,
    split_compound,
    split_image_name,
    split_words,
)
from hnf_core.material.ranking import NO_EVIDENCE, rank
from hnf_core.material.token import TOKEN_DIM


def entry(name, category, words, color, roughness, metallic=0.0, sheen=0.0, transmission=0.0):
    look = Appearance(color, roughness, metallic, sheen, transmission)
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    return LibraryMaterial(name, category, tuple(words.split(", ")), look, UNKNOWN_MECHANICS, token)


LIBRARY = (
    entry("oak-wood", "wood", "oak, wood, timber", (0.35, 0.2, 0.1), 0.6),
    entry("varnished-wood", "wood", "varnished wood, wood, parquet", (0.2, 0.1, 0.05), 0.25),
    entry("brushed-steel", "metal", "brushed metal, steel, stainless", (0.55, 0.55, 0.56), 0.3, 1.0),
    entry("cast-iron", "metal", "iron, cast iron", (0.2, 0.2, 0.2), 0.6, 1.0),
    entry("granite", "stone", "granite, stone", (0.3, 0.3, 0.3), 0.7),
    entry("velvet", "fabric", "velvet, plush", (0.2, 0.05, 0.1), 0.9, 0.0, 1.0),
    entry("denim", "fabric", "denim, jeans", (0.1, 0.15, 0.3), 0.85, 0.0, 0.2),
    entry("printer-paper", "paper", "paper", (0.85, 0.85, 0.85), 0.9),
    entry("abs-plastic", "plastic", "abs, plastic", (0.3, 0.3, 0.3), 0.4),
    entry("carbon-fibre", "plastic", "carbon fibre, carbon fiber", (0.03, 0.03, 0.03), 0.3),
    entry("upholstery-foam", "foam", "foam", (0.5, 0.5, 0.45), 0.95),
    entry("loop-carpet", "carpet", "carpet, rug", (0.3, 0.25, 0.2), 1.0, 0.0, 0.3),
    entry("ceramic-tile", "tile", "tile, ceramic", (0.8, 0.8, 0.78), 0.15),
    entry("grained-leather", "leather", "leather, faux leather", (0.15, 0.07, 0.04), 0.55),
    entry("rubber", "rubber", "rubber", (0.03, 0.03, 0.03), 0.75),
    entry("window-glass", "glass", "glass, window", (0.95, 0.95, 0.95), 0.02, 0.0, 0.0, 1.0),
)
CATEGORY = {material.name: material.category for material in LIBRARY}
BLANK = Appearance()
REAL = load_library()
DULL = Appearance((0.2, 0.15, 0.1), 0.6, 0.0, 0.0, 0.0)


def best(appearance, *names):
    return rank(LIBRARY, appearance, names)[0]


def categories(appearance, *names):
    """Categories by their best material."""
    return list(dict.fromkeys(CATEGORY[s.name] for s in rank(LIBRARY, appearance, names)))


@pytest.mark.parametrize(
    ("names", "look", "expected"),
    [
        (("LeatherPartsMat", "LeatherParts_low"), Appearance((0.1, 0.05, 0.03), 0.55, 0.0), "grained-leather"),
        (("fabric Mystere Peacock Velvet", "SheenChair_fabric"), Appearance((0, 0.09, 0.1), 0.8, 0.0, 1.0), "velvet"),
        (("MetalPartsMat.003",), Appearance((0.4, 0.4, 0.4), 0.35, 1.0), "brushed-steel"),
        (("wood Brown", "SheenChair_wood"), Appearance((0.3, 0.18, 0.09), 0.6, 0.0), "oak-wood"),
        (("PBR_GRANITE-02",), Appearance((0.3, 0.3, 0.3), 0.7, 0.0), "granite"),
        (("CarbonFiberHood",), Appearance((0.03, 0.03, 0.03), 0.3, 0.0), "carbon-fibre"),
        (("Holz dunkel",), DULL, "oak-wood"),
        (("cuir_noir",), Appearance((0.1, 0.06, 0.04), 0.55, 0.0), "grained-leather"),
    ],
)
def test_named_and_consistent_is_near_certain(names, look, expected):
    suggestion = best(look, *names)
    assert suggestion.name == expected
    assert 0.8 < suggestion.confidence <= 1.0


def test_what_a_name_leaves_open_the_shading_decides():
    wooden = Appearance((0.35, 0.2, 0.1), 0.6, 0.0)
    rubbery = Appearance((0.03, 0.03, 0.03), 0.8, 0.0)
    assert set(categories(BLANK, "RubberWoodMat")[:2]) == {"rubber", "wood"}
    assert categories(wooden, "RubberWoodMat")[:2] == ["wood", "rubber"]
    assert categories(rubbery, "RubberWoodMat")[:2] == ["rubber", "wood"]
    clear = Appearance((0.95, 0.95, 0.95), 0.02, 0.0, 0.0, 1.0)
    assert categories(clear, "GlassPlasticMat")[:2] == ["glass", "plastic"]
    assert categories(Appearance(roughness=0.45, transmission=0.0), "GlassPlasticMat")[:2] == ["plastic", "glass"]


def test_shading_alone_tells_a_little():
    metal = best(Appearance(roughness=0.2, metallic=1.0), "")
    assert CATEGORY[metal.name] == "metal"
    assert 0.2 < metal.confidence < 0.65
    brown = best(Appearance((0.33, 0.19, 0.1), 0.6, 0.0), "Material.001")
    assert CATEGORY[brown.name] == "wood"
    assert 0.15 < brown.confidence < 0.5
    assert best(Appearance((0.8, 0.8, 0.8), 0.5, 0.0, 0.0, 0.0), "Material", "Cube").confidence < 0.2


def test_nothing_known_is_all_alike():
    suggestions = rank(LIBRARY, BLANK, [])
    assert max(s.confidence for s in suggestions) < 0.15
    assert {s.reason for s in suggestions} == {"no clue in the scene"}
    assert sorted(s.name for s in suggestions) == sorted(m.name for m in LIBRARY)


def test_a_word_is_never_found_inside_another():
    blank = rank(LIBRARY, BLANK, [])
    for name in ("Chairman", "Woodward", "tileable", "Brassica", "oaktree", "abstract"):
        assert rank(LIBRARY, BLANK, [name]) == blank, name


def test_a_mat_is_a_material_not_a_rug():
    assert rank(LIBRARY, BLANK, ["Mat.001"]) == rank(LIBRARY, BLANK, [])


def test_names_weigh_material_over_object_over_texture():
    assert categories(BLANK, "leather", "MetalChair")[:2] == ["leather", "metal"]
    assert categories(BLANK, "metal", "LeatherChair")[:2] == ["metal", "leather"]
    assert categories(BLANK, "", "LeatherChair", "metal_diff")[:2] == ["leather", "metal"]
    assert best(BLANK, "leather").confidence > best(BLANK, "", "leather").confidence
    assert best(BLANK, "", "leather").confidence > best(BLANK, "", "", "leather").confidence


def test_the_rarer_word_wins():
    assert best(BLANK, "denim fabric").name == "denim"
    assert best(BLANK, "velvet").name == "velvet"
    assert best(BLANK, "cast iron stove").name == "cast-iron"
    assert best(BLANK, "lenses").name == "window-glass"


def test_the_reason_names_the_words_and_the_values():
    reason = best(Appearance((0.1, 0.05, 0.03), 0.2, 1.0), "LeatherPartsMat").reason
    assert "'leather' in 'LeatherPartsMat'" in reason
    assert "metallic 1.00 does not fit" in reason


looks = st.builds(
    Appearance,
    st.none() | st.tuples(*[st.floats(0, 1)] * 3),
    *[st.none() | st.floats(0, 1) for _ in range(4)],
)
name_lists = st.lists(st.text(max_size=20) | st.sampled_from(["WoodMat", "metal", "x_tile", "Lens.001"]), max_size=4)


@settings(max_examples=60, deadline=None)
@given(looks, name_lists)
def test_every_ranking_is_a_descending_list_of_the_whole_library(look, names):
    suggestions = rank(LIBRARY, look, names)
    confidence = [s.confidence for s in suggestions]
    assert sorted(s.name for s in suggestions) == sorted(CATEGORY)
    assert confidence == sorted(confidence, reverse=True)
    assert min(confidence) > 0.0
    assert max(confidence) <= 1.0
    assert rank(LIBRARY, look, names) == suggestions


@settings(max_examples=30, deadline=None)
@given(looks, name_lists, st.permutations(sorted(set(CATEGORY.values()))))
def test_the_order_of_categories_does_not_matter(look, names, order):
    plain = {s.name: s.confidence for s in rank(LIBRARY, look, names)}
    shuffled = sorted(LIBRARY, key=lambda material: order.index(material.category))
    for suggestion in rank(shuffled, look, names):
        assert suggestion.confidence == pytest.approx(plain[suggestion.name], rel=1e-9)


def test_of_two_that_fit_alike_the_usual_comes_first():
    special = dataclasses.replace(LIBRARY[2], name="knurled-steel")
    assert rank([LIBRARY[2], special], BLANK, ["steel"])[0].name == "brushed-steel"
    assert rank([special, LIBRARY[2]], BLANK, ["steel"])[0].name == "knurled-steel"


def test_values_that_nobody_chose_say_nothing():
    born = Appearance((0.8, 0.8, 0.8), 0.5)
    assert rank(LIBRARY, born, ["Material"]) == rank(LIBRARY, BLANK, ["Material"])
    assert rank(LIBRARY, Appearance((0.8, 0.8, 0.7), 0.5), [""]) != rank(LIBRARY, BLANK, [""])


@settings(max_examples=30, deadline=None)
@given(looks, st.sampled_from(LIBRARY))
def test_a_fitting_name_never_hurts(look, material):
    def confidence(*names):
        return {s.name: s.confidence for s in rank(LIBRARY, look, names)}[material.name]

    assert confidence(material.words[0]) >= confidence("") - 1e-12


def test_invalid_values_are_ignored_and_an_empty_library_raises():
    odd = dataclasses.replace(BLANK, roughness=float("nan"), base_color=(float("nan"), 0.0, 0.0))
    assert rank(LIBRARY, odd, []) == rank(LIBRARY, BLANK, [])
    assert rank(LIBRARY, Appearance(roughness=7.0), [])[0].name == rank(LIBRARY, Appearance(roughness=1.0), [])[0].name
    with pytest.raises(MaterialError):
        rank([], BLANK, [])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("GlassPlasticMat.001", ["glass", "plastic", "mat"]),
        ("PBRMetal_04-rough", ["pbr", "metal", "rough"]),
        ("fabric Mystere Peacock Velvet", ["fabric", "mystere", "peacock", "velvet"]),
        ("MÉTAL brossé", ["metal", "brosse"]),
        ("WOOD", ["wood"]),
        ("42", []),
    ],
)
def test_names_split_into_words(name, words):
    assert split_words(name) == words


@pytest.mark.parametrize(
    ("plural", "one"), [("lenses", "lens"), ("metals", "metal"), ("glasses", "glass"), ("alloys", "alloy")]
)
def test_plurals_lead_to_their_singular(plural, one):
    assert one in list_singulars(plural)
    assert list_singulars("glass") == ("glass",)


def hit_rate(names: dict[str, str]) -> float:
    """Share of names whose best-ranked category, told by the name alone, is the right one."""
    hits = 0
    for name, expected in names.items():
        as_picture = is_image_name(name)
        ranked = rank(REAL, BLANK, [""] if as_picture else [name], image_names=[name] * as_picture)
        told = ranked[0].reason != NO_EVIDENCE
        hits += told and next(each.category for each in REAL if each.name == ranked[0].name) == expected
    return hits / len(names)


def test_names_as_they_are_met_name_their_category():
    assert min(len(TUNED), len(HELD_BACK)) > 50
    assert hit_rate(TUNED) > 0.9
    assert hit_rate(HELD_BACK) > 0.85


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("T_Oak_Planks_BaseColor.png", ["t", "oak", "planks"]),
        ("SavonaTile_Metalness.jpg", ["savona", "tile"]),
        ("FlightHelmet_Materials_LeatherPartsMat_OcclusionRoughMetal.png",
         ["flight", "helmet", "materials", "leather", "parts", "mat"]),
        ("scratched_metal_01_diff_4k.exr", ["scratched", "metal"]),
        ("Bricks075A_1K-JPG_Color", ["bricks"]),
        ("T_Ceramic_Tile_M.TGA", ["t", "ceramic", "tile"]),
        ("metal.png", ["metal"]),
        ("roughness.png", []),
    ],
)  # fmt: skip
def test_a_picture_s_channel_is_no_word_of_its_name(name, words):
    assert split_image_name(name) == words


def test_a_channel_called_metalness_makes_nothing_of_metal():
    ranked = rank(LIBRARY, BLANK, [""], image_names=["SavonaTile_Metalness.jpg"])
    assert CATEGORY[ranked[0].name] == "tile"
    assert rank(LIBRARY, BLANK, [""], image_names=["x_metallic.png"]) == rank(LIBRARY, BLANK, [""])


def test_image_names_rank_between_object_and_material_names():
    def first(names, picture):
        return CATEGORY[rank(LIBRARY, BLANK, names, image_names=[picture])[0].name]

    assert first(["leather", ""], "oak_diff.png") == "leather"
    assert first(["", "leather"], "oak_diff.png") == "wood"


@pytest.mark.parametrize(
    ("word", "parts"),
    [
        ("glasscheibe", ["glas"]), ("eichenholz", ["eichen", "holz"]), ("woodfloor", ["wood", "floor"]),
        ("gummireifen", ["gummi"]), ("lederbezug", ["leder"]), ("brickwork", ["brick"]),
        ("chairman", []), ("woodward", []), ("oaktree", []), ("firewall", []), ("abstract", []), ("dialog", []),
        ("tableware", []), ("software", []),
    ],
)  # fmt: skip
def test_compounds_split_only_where_both_halves_are_words(word, parts):
    assert set(split_compound(word, build_vocabulary(REAL))) == set(parts)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=30))
def test_no_name_breaks_the_words(name):
    found = split_image_name(name)
    assert all(found)
    assert is_image_name(f"{name}.PNG")
    for word in found:
        assert isinstance(split_compound(word, build_vocabulary(LIBRARY)), list)


def test_no_language_names_two_categories_with_one_word():
    """A word of two categories says half as much; those meant to are listed here."""
    owners: dict[str, set[str]] = {}
    for category, words in CATEGORY_WORDS.items():
        assert len(words.split()) == len(set(words.split())), category
        for word in words.split():
            owners.setdefault(word, set()).add(category)
    assert {word for word, categories in owners.items() if len(categories) > 1} == set()
