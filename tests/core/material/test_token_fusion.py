"""Token fusion: measured bands where the map has them, library bands elsewhere, each with its route."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import MaterialError
from hnf_core.material.band_descriptor import get_smooth_token_values
from hnf_core.material.fuse import (
    BAND_COUNT,
    EMPTY_LEVEL,
    ROUTE_CONFIDENCE,
    compute_library_spread,
    compute_map_weights,
    find_significant_bands,
    format_routes,
    fuse,
    routes_by_band,
)
from hnf_core.material.token import TOKEN_DIM, Token, band_slice
from hnf_core.tactile.tactile_map import Route

tokens = hnp.arrays(np.float32, TOKEN_DIM, elements=st.floats(-9, 2, width=32))
band_sets = st.lists(st.booleans(), min_size=BAND_COUNT, max_size=BAND_COUNT)
confidences = st.floats(0, 1)


def measured_token(values: np.ndarray, bands: list[bool], shape: bool) -> Token:
    known = np.zeros(TOKEN_DIM, dtype=bool)
    for band, told in enumerate(bands):
        known[band_slice(band)] = told
    known[-2:] = shape
    return Token(np.where(known, values, get_smooth_token_values()).astype(np.float32), known)


@settings(max_examples=50, deadline=None)
@given(tokens, tokens, band_sets, st.booleans(), confidences)
def test_every_value_comes_from_the_source_that_its_route_names(values, prior, bands, shape, confidence):
    measured = measured_token(values, bands, shape)
    fused = fuse(measured, prior, confidence)
    shape = shape and any(find_significant_bands(measured))
    for band, told in enumerate(find_significant_bands(measured)):
        assert bands[band] or not told
        assert fused.routes[band] is (Route.MEASURED if told else Route.PRIOR)
        source = values if told else prior
        assert np.array_equal(fused.values[band_slice(band)], source[band_slice(band)])
    assert np.array_equal(fused.values[-2:], (values if shape else prior)[-2:])
    assert fused.shape_route is (Route.MEASURED if shape else Route.PRIOR)
    assert fused.values.dtype == np.float32
    assert confidence - 1e-12 <= fused.confidence <= 1.0


@settings(max_examples=20, deadline=None)
@given(tokens, confidences)
def test_without_micro_geometry_the_prior_is_all_there_is(prior, confidence):
    fused = fuse(None, prior, confidence)
    assert np.array_equal(fused.values, prior)
    assert set(fused.routes) == {Route.PRIOR}
    assert fused.confidence == pytest.approx(confidence)


@settings(max_examples=20, deadline=None)
@given(tokens)
def test_a_band_without_relief_falls_back_to_the_prior(prior):
    sine = get_smooth_token_values()
    sine[band_slice(2).start] = -4.5
    fused = fuse(measured_token(sine, [True] * BAND_COUNT, True), prior, 0.1)
    assert [route is Route.MEASURED for route in fused.routes] == [band == 2 for band in range(BAND_COUNT)]
    assert np.array_equal(fused.values[band_slice(2)], sine[band_slice(2)])
    assert np.array_equal(fused.values[band_slice(4)], prior[band_slice(4)])
    flat = fuse(measured_token(get_smooth_token_values(), [True] * BAND_COUNT, True), prior, 0.1)
    assert set(flat.routes) == {Route.PRIOR}
    assert flat.shape_route is Route.PRIOR


def test_what_a_picture_shows_to_be_smooth_stays_smooth():
    """A predicted map stands for the whole surface: nothing in it is not nothing known."""
    prior = np.full(TOKEN_DIM, -5.0, dtype=np.float32)
    flat = measured_token(get_smooth_token_values(), [True] * 4 + [False] * 3, True)
    fused = fuse(flat, prior, 0.1, route=Route.PREDICTED)
    assert fused.routes == (Route.PREDICTED,) * 4 + (Route.PRIOR,) * 3
    assert fused.shape_route is Route.PREDICTED
    assert np.array_equal(fused.values[band_slice(3)], get_smooth_token_values()[band_slice(3)])
    assert np.array_equal(fused.values[band_slice(4)], prior[band_slice(4)])


@settings(max_examples=50, deadline=None)
@given(tokens, tokens, band_sets, confidences)
def test_predicted_and_prior_bands_mix_by_confidence(values, prior, bands, confidence):
    token = measured_token(values, bands, False)
    fused = fuse(token, prior, confidence, route=Route.PREDICTED)
    share = ROUTE_CONFIDENCE[Route.PREDICTED] / (ROUTE_CONFIDENCE[Route.PREDICTED] + confidence)
    for band, told in enumerate(bands):
        at = band_slice(band)
        own = 1.0 if values[at.start] <= EMPTY_LEVEL else share
        met = own * values[at] + (1.0 - own) * prior[at] if told else prior[at]
        assert fused.routes[band] is (Route.PREDICTED if told else Route.PRIOR)
        np.testing.assert_allclose(fused.values[at], met, rtol=1e-5, atol=1e-5)
    assert np.array_equal(fused.values[-2:], prior[-2:])


LIBRARY_MEAN, LIBRARY_VARIANCE = compute_library_spread()
shares = st.floats(0.01, 0.99)


def predicted_token(values, share_explained: float) -> Token:
    error = np.sqrt((1.0 - share_explained) * LIBRARY_VARIANCE).astype(np.float32)
    return Token(np.asarray(values, dtype=np.float32), np.ones(TOKEN_DIM, dtype=bool), error)


@settings(max_examples=40, deadline=None)
@given(tokens, tokens, confidences, st.floats(1.0, 30.0))
def test_a_prediction_that_explains_nothing_is_not_felt(values, prior, confidence, factor):
    """Off by as much as the library's materials differ, or more: the blend goes to nothing by itself."""
    error = (factor * 1.001 * np.sqrt(LIBRARY_VARIANCE)).astype(np.float32)
    fused = fuse(Token(values, np.ones(TOKEN_DIM, dtype=bool), error), prior, confidence, Route.PREDICTED)
    assert np.array_equal(fused.values, prior)
    assert set(fused.routes) == {Route.PRIOR}
    assert fused.confidence == pytest.approx(confidence)


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(np.float32, TOKEN_DIM, elements=st.floats(-8, 2, width=32)), shares)
def test_a_prediction_alone_is_felt_as_it_is(values, share):
    """A mean that suits the look already holds the library; blended with it, it must not be shrunk twice."""
    fused = fuse(predicted_token(values, share), LIBRARY_MEAN, 0.0, Route.PREDICTED)
    np.testing.assert_allclose(fused.values, values, rtol=1e-2, atol=1e-2)
    assert set(fused.routes) == {Route.PREDICTED}
    assert fused.confidence == pytest.approx(share**2, abs=1e-3)


@settings(max_examples=40, deadline=None)
@given(shares, shares, confidences, confidences)
def test_weights_grow_with_the_share_explained(one, other, sure, surer):
    low, high = sorted((one, other))
    weights = [
        compute_map_weights(predicted_token(LIBRARY_MEAN, share), Route.PREDICTED, confidence)[1]
        for share, confidence in ((low, max(sure, surer)), (high, min(sure, surer)))
    ]
    assert (weights[0] <= weights[1] + 1e-9).all()
    assert (weights[0] >= 0.0).all()
    assert (weights[1] <= 1.0).all()


def test_a_predicted_band_is_worth_less_than_a_measured_one():
    rough = np.full(TOKEN_DIM, -5.0, dtype=np.float32)
    token = measured_token(rough, [True] * BAND_COUNT, True)
    by_route = {route: fuse(token, rough, 0.9, route=route).confidence for route in (Route.MEASURED, Route.PREDICTED)}
    assert by_route[Route.MEASURED] == 1.0
    assert by_route[Route.PREDICTED] == pytest.approx(ROUTE_CONFIDENCE[Route.PREDICTED])


def test_natural_roughness_is_kept_whole():
    rough = get_smooth_token_values()
    for band in range(BAND_COUNT):
        rough[band_slice(band).start] = -4.5 - 0.3 * band
    fused = fuse(measured_token(rough, [True] * BAND_COUNT, True), get_smooth_token_values(), 0.1)
    assert set(fused.routes) == {Route.MEASURED}


def test_the_report_names_wavelengths_and_routes():
    rough = np.full(TOKEN_DIM, -5.0, dtype=np.float32)
    token = measured_token(rough, [True, True, False, False, False, False, False], False)
    fused = fuse(token, get_smooth_token_values(), 0.5, route=Route.PREDICTED)
    assert routes_by_band(fused.routes) == {
        "8 mm": "predicted",
        "4 mm": "predicted",
        "2 mm": "prior",
        "1 mm": "prior",
        "0.5 mm": "prior",
        "0.25 mm": "prior",
        "0.125 mm": "prior",
    }


def test_a_library_token_that_cannot_be_one_is_refused():
    with pytest.raises(MaterialError):
        fuse(None, np.zeros(3), 0.5)
    with pytest.raises(MaterialError):
        fuse(None, np.full(TOKEN_DIM, np.nan), 0.5)


def test_routes_in_words_group_neighbouring_bands() -> None:
    routes = (Route.MEASURED,) * 3 + (Route.PRIOR,) * 4
    assert format_routes(routes) == "8–2 mm measured, 1–0.125 mm prior"
    assert format_routes((Route.PRIOR,) * 7) == "8–0.125 mm prior"
    assert format_routes((Route.MEASURED,) + (Route.PRIOR,) * 6) == "8 mm measured, 4–0.125 mm prior"
