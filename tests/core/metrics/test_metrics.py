"""Properties of the metrics: identity, level, symmetry, and scores of random textures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from textures import RATE, Float, texture

from hnf_core.metrics.spectra import (
    average_spectrum_distance_db,
    lsd_power_db,
    select_compared_bins,
    spectral_mse,
    welch,
    window_magnitudes,
)
from hnf_lab.evaluation.metrics import NINE_BANDS_HZ, gfc, lsd_log10_magnitude, nine_band_error_db, power_bias_db


def long_run(seconds: float = 400.0) -> Float:
    return welch(texture(99, seconds), RATE)[1]


FREQUENCY = np.fft.rfftfreq(1000, 1.0 / RATE)

seeds = st.integers(0, 10_000)
gains = st.floats(1e-3, 1e3)


@given(seeds, gains)
@settings(max_examples=20, deadline=None)
def test_metrics_have_identity_and_the_right_level_dependence(seed: int, gain: float) -> None:
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


def test_the_true_process_scores_037_db_and_an_lsd_of_7_5_db() -> None:
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


def test_bins_30_db_down_or_outside_20_to_1000_hz_are_ignored() -> None:
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
