"""Band-limited resampling of a table to an even grid, with bounded memory."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import resample_band_limited

RATE = 200.0
SIGMA_S = np.sqrt(np.log(2.0)) / (2.0 * np.pi * 0.25 * RATE)


def summed_finely(values, time, count):
    """The Gaussian, sample by sample on steps of 20 µs: what band_limited stands for where a table is fine."""
    around = np.arange(-4.0 * SIGMA_S, 4.0 * SIGMA_S, 20e-6)
    weights = np.exp(-0.5 * np.square(around / SIGMA_S))
    at = time[0] + np.arange(count)[:, None] / RATE + around
    return np.stack([np.interp(at, time, column) @ (weights / weights.sum()) for column in values.T], axis=1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(3e-4, 1.5e-3), st.floats(-1e3, 1e3))
def test_a_fine_table_is_read_under_the_gaussian(seed, step, start):
    rng = np.random.default_rng(seed)
    time = start + np.cumsum(step * rng.uniform(0.7, 1.3, 700))
    values = np.cumsum(rng.standard_normal((700, 2)), axis=0)
    count = int((time[-1] - time[0]) * RATE)
    found = resample_band_limited(values, time, count, RATE)
    np.testing.assert_allclose(found, summed_finely(values, time, count), atol=2e-3 * np.ptp(values))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(3e-3, 0.1))
def test_a_coarse_table_is_read_straight_between_its_rows(seed, step):
    rng = np.random.default_rng(seed)
    time, values = np.arange(60) * step, rng.standard_normal((60, 2))
    count = int(time[-1] * RATE)
    wanted = np.stack([np.interp(np.arange(count) / RATE, time, column) for column in values.T], axis=1)
    np.testing.assert_array_equal(resample_band_limited(values, time, count, RATE), wanted)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(-1e3, 1e3))
def test_what_stands_still_stands_still(seed, level):
    time = np.cumsum(np.exp(np.random.default_rng(seed).uniform(-12.0, -3.0, 300)))
    count = int((time[-1] - time[0]) * RATE) + 1
    np.testing.assert_allclose(
        resample_band_limited(np.full((300, 1), level), time, count, RATE), level, rtol=1e-12, atol=1e-300
    )


def test_a_ripple_does_not_alias_in_a_mostly_coarse_table():
    """Half a second at 10 kHz with a ripple of 180 Hz, then minutes at 50 Hz: the ripple folded to 20 Hz."""
    time = np.concatenate([np.arange(0.0, 0.5, 1e-4), np.arange(0.5, 200.0, 0.02)])
    force = np.where(time < 0.5, 1.0 + 0.3 * np.sin(2.0 * np.pi * 180.0 * time), 1.0)
    found = resample_band_limited(force[:, None], time, 1000, RATE)[:, 0]
    cut_off = np.abs(np.arange(1000) / RATE - 0.5) < 0.02  # there the ripple's own end is felt, as it is
    assert np.abs(found[4:][~cut_off[4:]] - 1.0).max() < 0.01
    assert np.abs(found - 1.0).max() < 0.06


@pytest.mark.parametrize("steps", [[1e-9, 1e-9, 1e-9], [5e-324, 5e-324], [1e-9] * 40])
def test_a_few_rows_close_together_cost_nothing(steps):
    time = np.cumsum([0.0, *steps, 1.0])
    tracemalloc.start()
    try:
        found = resample_band_limited(np.linspace(0.0, 1.0, len(time))[:, None], time, 201, RATE)[:, 0]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4_000_000
    assert np.isfinite(found).all()
    assert np.all(np.diff(found[3:]) > 0.0)
    assert found[-1] == pytest.approx(1.0, abs=0.01)
