"""The metrics keep their laws: identity, level, symmetry where it is true, and what random textures score."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.metrics.spectra import (
    NINE_BANDS_HZ,
    average_spectrum_distance_db,
    gfc,
    lsd_log10_magnitude,
    lsd_power_db,
    nine_band_error_db,
    power_bias_db,
    select_compared_bins,
    spectral_mse,
    welch,
    window_magnitudes,
)
from hnf_lab.evaluation.bounds import compute_bounds, measure_repetition

Float = NDArray[np.float64]
RATE = 10_000.0


def texture(seed: int, seconds: float = 8.0) -> Float:
    """A Gaussian texture: a resonance at 220 Hz over a slope, AR(2) and AR(1), by its transfer function."""
    count = round(seconds * RATE)
    white = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    z = np.exp(-2j * np.pi * np.fft.rfftfreq(count))
    pole = 0.96 * np.exp(2j * np.pi * 220.0 / RATE)
    return np.fft.irfft(white / ((1.0 - pole * z) * (1.0 - np.conj(pole) * z) * (1.0 - 0.8 * z)), count)


def long_run(seconds: float = 400.0) -> Float:
    return welch(texture(99, seconds), RATE)[1]


FREQUENCY = np.fft.rfftfreq(1000, 1.0 / RATE)

seeds = st.integers(0, 10_000)
gains = st.floats(1e-3, 1e3)


@given(seeds, gains)
@settings(max_examples=20, deadline=None)
def test_a_signal_is_no_distance_from_itself_and_level_counts_where_it_should(seed: int, gain: float) -> None:
    a, b = (window_magnitudes(texture(each, 1.0)) for each in (seed, seed + 1))
    assert spectral_mse(a, a) == 0.0
    assert lsd_power_db(a, a) == 0.0
    assert gfc(a, a) == pytest.approx(1.0)
    assert spectral_mse(gain * a, gain * b) == pytest.approx(gain**2 * spectral_mse(a, b))
    assert gfc(gain * a, b) == pytest.approx(gfc(a, b))
    assert lsd_power_db(gain * a, gain * b) == pytest.approx(lsd_power_db(a, b))
    assert lsd_power_db(gain * a, a, epsilon=0.0) == pytest.approx(abs(20.0 * np.log10(gain)))
    assert lsd_log10_magnitude(a, b) == pytest.approx(lsd_power_db(a, b) / 20.0)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_symmetric_where_it_is_true(seed: int) -> None:
    a, b = (window_magnitudes(texture(each, 1.0)) for each in (seed, seed + 1))
    assert spectral_mse(a, b) == spectral_mse(b, a)
    assert gfc(a, b) == pytest.approx(gfc(b, a))
    assert lsd_power_db(a, b) == pytest.approx(lsd_power_db(b, a), rel=1e-6)


def test_bins_are_10_to_1000_hz_and_dc_is_left_out() -> None:
    t = np.arange(10_000) / RATE
    assert window_magnitudes(np.full(10_000, 5.0)).max() < 1e-9
    tone = window_magnitudes(np.sin(2 * np.pi * 1000.0 * t)).mean(axis=0)
    assert np.argmax(tone) == 99
    assert tone[99] == pytest.approx(0.5 * 500.0)
    assert np.argmax(window_magnitudes(np.sin(2 * np.pi * 10.0 * t)).mean(axis=0)) == 0
    assert window_magnitudes(np.zeros(2999)).shape == (2, 100)


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


def test_the_true_process_scores_037_db_and_seven_and_a_half_in_single_windows() -> None:
    reference = long_run()
    draws = [texture(seed) for seed in range(8)]
    scores = [average_spectrum_distance_db(welch(each, RATE)[1], reference, FREQUENCY) for each in draws]
    assert np.median(scores) == pytest.approx(0.37, abs=0.05)
    bias = [power_bias_db(welch(each, RATE)[1], reference, FREQUENCY) for each in draws]
    assert abs(np.mean(bias)) < 0.1
    lsd = lsd_power_db(window_magnitudes(draws[0]), window_magnitudes(draws[1]))
    assert 7.2 < lsd < 7.9


@given(st.floats(0.01, 100.0))
@settings(max_examples=20, deadline=None)
def test_a_gain_is_its_own_decibels_in_every_average(gain: float) -> None:
    density = long_run(4.0)
    level = 20.0 * np.log10(gain)
    assert power_bias_db(gain**2 * density, density, FREQUENCY) == pytest.approx(level)
    assert average_spectrum_distance_db(gain**2 * density, density, FREQUENCY) == pytest.approx(abs(level))
    assert nine_band_error_db(gain**2 * density, density, FREQUENCY) == pytest.approx(abs(level))


def test_what_lies_30_db_down_or_outside_20_to_1000_hz_does_not_count() -> None:
    density = np.full(501, 1e-4)
    density[20] = 1.0  # 200 Hz
    assert np.flatnonzero(select_compared_bins(density, FREQUENCY)).tolist() == [20]
    density[21], density[1], density[101], density[100], density[2] = 1.1e-3, 5.0, 5.0, 0.9, 0.9
    assert np.flatnonzero(select_compared_bins(density, FREQUENCY)).tolist() == [2, 20, 21, 100]
    assert average_spectrum_distance_db(np.zeros(501), density, FREQUENCY) == pytest.approx(120.0, abs=10.0)
    for measure in (average_spectrum_distance_db, power_bias_db, nine_band_error_db):
        with pytest.raises(ValueError, match="silent"):
            measure(density, np.zeros(501), FREQUENCY)


def test_nine_bands_hold_every_bin_once() -> None:
    assert len(NINE_BANDS_HZ) == 10
    base = np.ones(501)
    for bin_index in range(1, 101):
        louder = base.copy()
        louder[bin_index] *= 4.0
        inside = np.histogram(FREQUENCY[1:101], NINE_BANDS_HZ)[0]
        band = np.histogram(FREQUENCY[bin_index], NINE_BANDS_HZ)[0].argmax()
        expected = 10.0 * np.log10((inside[band] + 3.0) / inside[band]) / 3.0
        assert nine_band_error_db(louder, base, FREQUENCY) == pytest.approx(expected)


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
