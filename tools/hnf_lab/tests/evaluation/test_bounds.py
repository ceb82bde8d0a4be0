"""Bounds on scores of random textures, and how much a signal repeats itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from textures import RATE, texture

from hnf_core.metrics.spectra import spectral_mse, window_magnitudes
from hnf_lab.evaluation.bounds import compute_bounds, measure_repetition


def test_a_gaussian_texture_scores_its_known_limits() -> None:
    draws = [texture(seed) for seed in range(40)]
    limits = compute_bounds([window_magnitudes(each) for each in draws])
    assert limits.oracle_share == pytest.approx(2.0 - np.pi / 2.0, abs=0.01)
    assert limits.best_share == pytest.approx(1.0 - np.pi / 4.0, abs=0.005)
    measured = np.mean([spectral_mse(window_magnitudes(a), window_magnitudes(b)) for a, b in pairwise(draws)])
    assert measured == pytest.approx(limits.oracle, rel=0.02)


def test_the_expected_error_is_the_mean_over_recordings() -> None:
    draws = [window_magnitudes(texture(seed, 2.0)) for seed in range(64)]
    limits = compute_bounds(draws[:32])
    for other in (np.zeros_like(draws[0]), 1.3 * draws[0][::-1], window_magnitudes(texture(500, 2.0))):
        fresh = np.mean([spectral_mse(other, each) for each in draws[32:]])
        assert limits.expected_mse(other) == pytest.approx(fresh, rel=0.03)
    oracle = [limits.expected_mse(each) for each in draws[32:]]
    assert np.mean(oracle) == pytest.approx(limits.oracle, rel=0.03)
    assert limits.expected_mse(np.mean(draws[32:], axis=0)) == pytest.approx(limits.best * (1.0 + 1.0 / 32.0), rel=0.02)
    for none in (draws[:1], [np.zeros_like(draws[0])] * 32):
        with pytest.raises(ValueError, match="silent or single"):
            compute_bounds(none)


def test_a_loop_repeats_and_noise_does_not() -> None:
    once = texture(1, 0.5)
    assert measure_repetition(np.tile(once, 8), RATE) == pytest.approx(1.0, abs=1e-6)
    assert measure_repetition(-np.tile(once, 8), RATE) == pytest.approx(1.0, abs=1e-6)
    fresh = measure_repetition(texture(2, 8.0), RATE)
    assert fresh < 0.3
    echo = texture(2, 8.0) + 0.7 * np.roll(texture(2, 8.0), 15_000)
    assert measure_repetition(echo, RATE) > fresh + 0.2
    assert measure_repetition(echo, RATE, max_lag_s=1.0) < 0.3
    assert measure_repetition(3.0 * echo + 5.0, RATE) == pytest.approx(measure_repetition(echo, RATE))
    assert measure_repetition(np.zeros(4000), RATE) == 0.0
    with pytest.raises(ValueError, match="too short"):
        measure_repetition(np.zeros(1500), RATE)
