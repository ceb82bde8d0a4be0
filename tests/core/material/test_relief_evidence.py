"""Relief as evidence: likelihood, distance, and properties estimated from a ranking."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import MaterialError
from hnf_core.field.features import rotate_to_stroke_frame, token_distances
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.fuse import compute_library_spread
from hnf_core.material.library import Appearance, get_material, load_library
from hnf_core.material.ranking import (
    NO_EVIDENCE,
    RELIEF_DOUBT,
    compute_invariants,
    estimate_property,
    get_probabilities,
    rank,
    relief_log_odds,
)
from hnf_core.material.token import LEVELS, TOKEN_DIM, Token, band_slice
from hnf_core.tactile.tactile_map import Route

LIBRARY = load_library()
NAMES = [material.name for material in LIBRARY]
ALL = np.ones(TOKEN_DIM, dtype=bool)
turns = st.floats(0.0, 2.0 * np.pi)
materials = st.sampled_from(LIBRARY)


def turned(values, angle: float):
    """The token of the same surface turned under the hand by angle."""
    return rotate_to_stroke_frame(values[None], np.array([[np.cos(angle), np.sin(angle)]]))[0].astype(np.float32)


def test_the_relief_of_every_material_speaks_for_itself() -> None:
    for material in LIBRARY:
        odds = relief_log_odds(LIBRARY, Token(material.token, ALL))
        own = odds[NAMES.index(material.name)]
        assert own > 0.0, material.name
        assert own >= odds.max() - 1e-9, material.name


@settings(max_examples=30, deadline=None)
@given(materials, turns)
def test_however_a_surface_lies_its_relief_says_the_same(material, angle) -> None:
    straight = relief_log_odds(LIBRARY, Token(material.token, ALL))
    assert relief_log_odds(LIBRARY, Token(turned(material.token, angle), ALL)) == pytest.approx(straight, abs=1e-3)
    assert compute_invariants(turned(material.token, angle)[None]) == pytest.approx(
        compute_invariants(material.token[None]), abs=1e-5
    )


def test_what_is_not_known_says_nothing() -> None:
    nothing = np.zeros(len(LIBRARY))
    token = LIBRARY[0].token
    assert (relief_log_odds(LIBRARY, None) == nothing).all()
    assert (relief_log_odds(LIBRARY, Token(token, ~ALL)) == nothing).all()
    assert (relief_log_odds(LIBRARY, Token(token, ALL), Route.PRIOR) == nothing).all()


@settings(max_examples=30, deadline=None)
@given(materials, st.integers(0, 6), st.floats(-8.9, -3.0))
def test_bands_that_are_not_known_do_not_count(material, band, level) -> None:
    known = ALL.copy()
    known[band_slice(band)] = False
    other = material.token.copy()
    other[band_slice(band)] = level
    first, second = (relief_log_odds(LIBRARY, Token(values, known)) for values in (material.token, other))
    assert first == pytest.approx(second, abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-12.0, 0.0), min_size=7, max_size=7), st.sampled_from([Route.MEASURED, Route.PREDICTED]))
def test_no_relief_rules_a_material_out(levels, route) -> None:
    values = LIBRARY[0].token.copy()
    values[LEVELS] = levels
    odds = relief_log_odds(LIBRARY, Token(values, ALL), route)
    assert np.isfinite(odds).all()
    assert (odds >= np.log(RELIEF_DOUBT) - 1e-9).all()


def test_a_predicted_relief_weighs_less_than_a_measured_one() -> None:
    token = Token(get_material("denim").token, ALL)
    measured, predicted = (
        np.ptp(relief_log_odds(LIBRARY, token, route)) for route in (Route.MEASURED, Route.PREDICTED)
    )
    assert 0.0 < predicted < measured


def test_a_prediction_is_no_evidence_of_what_it_does_not_explain() -> None:
    token = get_material("denim").token
    _, variance = compute_library_spread()
    blind, keen = (
        relief_log_odds(LIBRARY, Token(token, ALL, (share * np.sqrt(variance)).astype(np.float32)), Route.PREDICTED)
        for share in (1.01, 0.2)
    )
    assert not blind.any()
    assert keen[NAMES.index("denim")] > 0.0


def test_a_scaled_relief_still_ranks_its_own_material_first() -> None:
    higher = get_material("corduroy").token.copy()
    higher[LEVELS] += np.float32(np.log10(2.0))
    ranked = rank(LIBRARY, Appearance(), [], token=Token(higher, ALL))
    assert ranked[0].name == "corduroy"
    assert "its relief is like corduroy's" in ranked[0].reason


def test_words_and_looks_outweigh_a_relief() -> None:
    """A tyre's tread drawn on something that its name calls oak stays oak."""
    token = Token(get_material("tyre-rubber").token, ALL)
    assert rank(LIBRARY, Appearance(), ["oak"], token=token)[0].name == "oak-wood"
    told = next(each for each in rank(LIBRARY, Appearance(), ["oak"], token=token) if each.name == "oak-wood")
    assert "its relief does not fit" in told.reason


def test_a_relief_that_is_like_nothing_speaks_against_nothing() -> None:
    odd = get_material("denim").token.copy()
    odd[LEVELS] = -1.0
    ranked = rank(LIBRARY, Appearance(), ["oak"], token=Token(odd, ALL))
    assert ranked[0].name == "oak-wood"
    assert not any("relief" in each.reason for each in ranked)


def test_without_a_relief_the_ranking_is_what_it_was() -> None:
    look = Appearance((0.3, 0.2, 0.1), 0.6, 0.0)
    assert rank(LIBRARY, look, ["chair"]) == rank(LIBRARY, look, ["chair"], token=None, route=Route.PREDICTED)
    assert rank(LIBRARY, Appearance(), [])[0].reason == NO_EVIDENCE


@settings(max_examples=25, deadline=None)
@given(materials, st.sampled_from(["", "oak", "metal", "T_x"]))
def test_probabilities_of_a_ranking_sum_to_one(material, name) -> None:
    ranked = rank(LIBRARY, material.appearance, [name], token=Token(material.token, ALL))
    assert sum(each.probability for each in ranked) == pytest.approx(1.0)


@settings(max_examples=25, deadline=None)
@given(materials, turns)
def test_a_surface_is_at_no_distance_from_itself_however_it_lies(material, angle) -> None:
    others = np.stack([each.token for each in LIBRARY])
    steps = np.round(angle / np.radians(5.0)) * np.radians(5.0)
    distances = token_distances(turned(material.token, steps), ALL, others)
    assert distances[NAMES.index(material.name)] == pytest.approx(0.0, abs=1e-5)
    assert (distances >= 0.0).all()


def test_distance_counts_known_features_only_and_needs_one() -> None:
    token = get_material("denim").token
    known = ~ALL
    known[band_slice(2)] = True
    other = token.copy()
    other[band_slice(5)] += 1.0
    assert token_distances(token, known, other[None])[0] == pytest.approx(0.0, abs=1e-6)
    assert token_distances(token, ALL, other[None])[0] > 0.1
    with pytest.raises(MaterialError):
        token_distances(token, ~ALL, other[None])
    with pytest.raises(MaterialError):
        token_distances(token[:-1], ALL, other[None])


def test_a_single_material_is_estimated_as_it_is() -> None:
    oak = get_material("oak-wood")
    told = estimate_property(LIBRARY, {"oak-wood": 1.0}, "friction", 0.1)
    assert told.value == pytest.approx(oak.mechanics.friction)
    assert told.factor == pytest.approx(np.exp(0.1))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.01, 1.0), min_size=len(LIBRARY), max_size=len(LIBRARY)))
def test_an_estimate_and_its_spread_stay_within_the_materials(shares) -> None:
    weights = dict(zip(NAMES, shares, strict=True))
    values = [material.mechanics.stiffness_n_m for material in LIBRARY]
    told = estimate_property(LIBRARY, weights, "stiffness_n_m", 0.0)
    assert min(values) <= told.value <= max(values)
    assert 1.0 <= told.factor <= max(values) / min(values)
    thrice = estimate_property(LIBRARY, {name: 3.0 * share for name, share in weights.items()}, "stiffness_n_m", 0.0)
    assert (thrice.value, thrice.factor) == pytest.approx((told.value, told.factor))


def test_zero_friction_materials_are_left_out_of_the_estimate() -> None:
    smooth = dataclasses.replace(LIBRARY[0], mechanics=dataclasses.replace(LIBRARY[0].mechanics, friction=0.0))
    weights = {smooth.name: 0.5, LIBRARY[1].name: 0.5}
    assert estimate_property([smooth, LIBRARY[1]], weights, "friction", 0.1) == estimate_property(
        [LIBRARY[1]], weights, "friction", 0.1
    )
    with pytest.raises(MaterialError):
        estimate_property([smooth], weights, "friction", 0.1)


def test_an_estimate_of_nothing_is_refused() -> None:
    blank = dataclasses.replace(LIBRARY[0], mechanics=UNKNOWN_MECHANICS)
    with pytest.raises(MaterialError):
        estimate_property([blank], {blank.name: 1.0}, "friction", 0.1)
    ranked = rank(LIBRARY, Appearance(), ["oak"])
    assert get_probabilities(LIBRARY, ranked)["oak-wood"] == ranked[0].probability
    with pytest.raises(MaterialError):
        get_probabilities(LIBRARY[1:], ranked)
