"""Figures of the encoder comparison, on the descriptor with its known properties."""

import numpy as np
import pytest

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.weights import load_field
from hnf_core.material.band_descriptor import describe, get_smooth_token_values
from hnf_core.material.encoder_registry import get_encoder
from hnf_core.material.token import ENCODER_ID, LEVELS, TOKEN_DIM, Token
from hnf_core.tactile.views import PITCHES_M
from hnf_lab.encoder.evaluate import (
    SensorView,
    SurfaceSample,
    compute_level_change_db,
    compute_neighbour_distance,
    compute_signal_distances_db,
    compute_stability,
    compute_token_distance,
    describe_samples,
    make_sample,
    render_maps,
)

DESCRIPTOR = get_encoder(ENCODER_ID)
PIECES = [make_sample(name, 900) for name in ("denim", "cork")]


def raised(decibels: float, known: bool = True) -> Token:
    values = get_smooth_token_values()
    values[LEVELS] = -5.0 + decibels / 20.0
    return Token(values, np.full(TOKEN_DIM, known))


def test_levels_change_by_what_they_are_raised():
    assert compute_level_change_db(raised(0.0), raised(2.0)) == pytest.approx(2.0, abs=1e-4)
    assert compute_token_distance(raised(0.0), raised(0.0)) == 0.0
    assert compute_token_distance(raised(0.0), raised(2.0)) == pytest.approx(0.1 / 1.5 * np.sqrt(7.0), abs=1e-4)
    assert compute_token_distance(raised(0.0), raised(2.0, known=False)) == 0.0


def test_a_shot_is_repeatable_and_changes_what_it_says():
    plain = render_maps(PIECES[0], SensorView())[0]
    for shot in (SensorView(shift_px=3), SensorView(noise=0.01), SensorView(lamps=1), SensorView(sensor="digit")):
        first, again = (render_maps(PIECES[0], shot)[0] for _ in range(2))
        assert np.array_equal(first.image, again.image)
        assert not np.array_equal(first.image, plain.image)
    shifted = render_maps(PIECES[0], SensorView(shift_px=3))[0].image
    middle = slice(32, -32)
    np.testing.assert_allclose(
        np.roll(shifted, (-3, -3), axis=(0, 1))[middle, middle], plain.image[middle, middle], atol=2e-3
    )
    noise = render_maps(PIECES[0], SensorView(noise=0.01))[0].image - plain.image
    assert float(noise.std()) == pytest.approx(0.01, rel=0.02)


def test_views_are_one_widest_and_some_finest():
    views = render_maps(PIECES[0], SensorView(near_views=4))
    assert [view.metres_per_pixel for view in views] == [PITCHES_M[0], *[PITCHES_M[3]] * 4]
    assert all(view.image.shape == (64, 64, 3) for view in views)


def test_the_descriptor_ignores_the_sensor_but_not_noise():
    plain, digit, noisy = (
        describe_samples(DESCRIPTOR, PIECES, shot)
        for shot in (SensorView(), SensorView(sensor="digit"), SensorView(noise=0.02))
    )
    sensor, noise = compute_stability(plain, digit), compute_stability(plain, noisy)
    apart = compute_neighbour_distance(plain, PIECES)
    assert sensor.token < 0.02 * apart
    assert sensor.level_db < 0.1
    assert noise.level_db > 1.0


def test_equal_tokens_have_equal_signals_and_raised_ones_do_not():
    action = make_steady_action(1.0, 0.1, 1.0, 0.3, "pen")
    field = load_field()

    def truth(each: SurfaceSample) -> Token:
        return describe(render_maps(each, SensorView())[0])

    def louder(each: SurfaceSample) -> Token:
        token = truth(each)
        values = token.values.copy()
        values[LEVELS] += 0.6
        return Token(values, token.known)

    assert compute_signal_distances_db(field, action, PIECES[:1], truth, truth).tolist() == [0.0]
    assert compute_signal_distances_db(field, action, PIECES[:1], truth, louder)[0] > 3.0
