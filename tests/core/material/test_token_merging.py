"""Merging of views: powers average, shares follow power, and the order of views has no effect."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import MaterialError
from hnf_core.material.band_descriptor import get_smooth_token_values
from hnf_core.material.fuse import BAND_COUNT, merge_tokens
from hnf_core.material.token import LEVELS, TOKEN_DIM, Token, band_slice

band_sets = st.lists(st.booleans(), min_size=BAND_COUNT, max_size=BAND_COUNT)


@st.composite
def tokens(draw: st.DrawFn) -> Token:
    values = draw(hnp.arrays(np.float32, TOKEN_DIM, elements=st.floats(-1, 1, width=32)))
    values[LEVELS] = draw(hnp.arrays(np.float32, BAND_COUNT, elements=st.floats(-9, -3, width=32)))
    known = np.zeros(TOKEN_DIM, dtype=bool)
    for band, told in enumerate(draw(band_sets)):
        known[band_slice(band)] = told
    known[-2:] = draw(st.booleans())
    return Token(np.where(known, values, get_smooth_token_values()).astype(np.float32), known)


views = st.lists(tokens(), min_size=1, max_size=6)

_SHAPE_ONLY = get_smooth_token_values()
_SHAPE_ONLY[-2:] = [1.0, -0.5]
SHAPE_ONLY = Token(_SHAPE_ONLY, np.arange(TOKEN_DIM) >= TOKEN_DIM - 2)
"""A view that knows how heights are spread and no band's power."""


@given(tokens())
def test_one_view_is_itself(token):
    merged = merge_tokens([token])
    assert np.array_equal(merged.values, token.values)
    assert np.array_equal(merged.known, token.known)
    assert merged.values.dtype == np.float32


@settings(max_examples=60)
@given(views, st.randoms(use_true_random=False))
def test_the_order_does_not_matter_to_the_last_bit(found, random):
    areas = [random.uniform(0.1, 3.0) for _ in found]
    order = random.sample(range(len(found)), len(found))
    merged = merge_tokens(found, areas)
    again = merge_tokens([found[i] for i in order], [areas[i] for i in order])
    assert merged.values.tobytes() == again.values.tobytes()
    assert np.array_equal(merged.known, again.known)


@given(views)
def test_known_where_any_view_knows_and_smooth_elsewhere(found):
    merged = merge_tokens(found)
    assert np.array_equal(merged.known, np.any([token.known for token in found], axis=0))
    assert np.array_equal(merged.values[~merged.known], get_smooth_token_values()[~merged.known])


@settings(max_examples=60)
@given(views)
def test_band_power_is_the_mean_over_views_that_resolve_it(found):
    merged = merge_tokens(found)
    for band in range(BAND_COUNT):
        at = band_slice(band).start
        powers = [10.0 ** (2.0 * float(token.values[at])) for token in found if token.known[at]]
        if powers:
            assert 2.0 * merged.values[at] == pytest.approx(np.log10(np.mean(powers)), abs=1e-5)


@settings(max_examples=60)
@example([SHAPE_ONLY, SHAPE_ONLY])
@given(views)
def test_every_feature_lies_between_those_of_its_views(found):
    merged = merge_tokens(found)
    for index in np.flatnonzero(merged.known):
        those = [float(token.values[index]) for token in found if token.known[index]]
        assert min(those) - 1e-5 <= merged.values[index] <= max(those) + 1e-5


@example(SHAPE_ONLY, 2)
@given(tokens(), st.integers(2, 5))
def test_equal_views_say_what_one_says(token, count):
    np.testing.assert_allclose(merge_tokens([token] * count).values, token.values, atol=1e-5)


@given(tokens(), tokens())
def test_a_weight_is_so_many_equal_views(first, second):
    np.testing.assert_allclose(
        merge_tokens([first, second], [3.0, 1.0]).values, merge_tokens([first, first, first, second]).values, atol=1e-5
    )


def test_shares_are_weighted_by_the_bands_power():
    """Two halves of a surface, one with ten times the mean square, each a pure grating: along x, and along y."""
    strong, weak = get_smooth_token_values(), get_smooth_token_values()
    strong[band_slice(3)], weak[band_slice(3)] = [-4.0, 1, 0, 1, 0, 1, 0], [-4.5, -1, 0, 1, 0, 1, 0]
    known = np.ones(TOKEN_DIM, dtype=bool)
    merged = merge_tokens([Token(strong, known), Token(weak, known)])
    level, cos2, _, cos4, *_ = merged.values[band_slice(3)]
    assert level == pytest.approx(0.5 * np.log10((1e-8 + 1e-9) / 2), abs=1e-5)
    assert cos2 == pytest.approx((10 - 1) / 11, abs=1e-5)
    assert cos4 == pytest.approx(1.0, abs=1e-6)


def test_views_of_two_scales_make_one_whole_token():
    """A wide view knows the long bands, a near one the short ones; the band of both is the mean of their power."""
    wide, near = np.zeros(TOKEN_DIM, dtype=bool), np.zeros(TOKEN_DIM, dtype=bool)
    values = get_smooth_token_values()
    values[LEVELS] = -5.0
    for band in range(BAND_COUNT):
        wide[band_slice(band)], near[band_slice(band)] = band <= 3, band >= 3
    merged = merge_tokens([Token(values, wide), Token(values, near)])
    assert merged.known[:-2].all()
    assert not merged.known[-2:].any()
    np.testing.assert_allclose(merged.values[LEVELS], -5.0, atol=1e-6)


@pytest.mark.parametrize(
    ("found", "weights", "message"),
    [
        ([], None, "no token to merge"),
        ([Token(np.zeros(3, dtype=np.float32), np.zeros(3, dtype=bool))], None, "finite values"),
        ([Token(np.full(TOKEN_DIM, np.nan, dtype=np.float32), np.ones(TOKEN_DIM, dtype=bool))], None, "finite values"),
        ([Token(get_smooth_token_values(), np.ones(TOKEN_DIM, dtype=bool))], [0.0], "positive weights"),
        ([Token(get_smooth_token_values(), np.ones(TOKEN_DIM, dtype=bool))], [1.0, 1.0], "positive weights"),
    ],
)
def test_what_cannot_be_merged_is_refused_in_words(found, weights, message):
    with pytest.raises(MaterialError, match=message):
        merge_tokens(found, weights)
