"""ST-SIM in both variants and SPQI: against the authors' own figures, their laws, and what random phases score."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.metrics.similarity import (
    dct,
    get_touch_threshold_db,
    resample_to_tum_rate,
    split_blocks,
    spqi,
    st_sim_tum,
)
from hnf_lab.evaluation.metrics import st_sim_cosine

Float = NDArray[np.float64]
RATE = 8000.0


def tones() -> tuple[Float, Float]:
    t = np.arange(8192) / RATE
    x = np.sin(2 * np.pi * 97 * t) + 0.3 * np.sin(2 * np.pi * (211 * t + 40 * t * t))
    y = 0.8 * np.sin(2 * np.pi * 97 * t + 0.2) + 0.3 * np.sin(2 * np.pi * 260 * t)
    return x, y


def smooth_noise(seed: int, count: int = 64_000) -> Float:
    """Noise of an every-day texture's spectrum: a broad hump at 200 Hz."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)
    return np.fft.irfft(spectrum * (frequency / 200.0) / (1.0 + (frequency / 200.0) ** 2) ** 1.5, count)


def test_the_figures_of_vibromaf() -> None:
    """vibromaf 0.0.8 on the same two signals; in anti-phase it gives a complex number of this modulus."""
    x, y = tones()
    assert st_sim_tum(y, x, RATE) == pytest.approx(0.918584747369378, abs=1e-9)
    assert st_sim_tum(x, y, RATE) == pytest.approx(0.9215201148888835, abs=1e-9)
    assert spqi(y, x, RATE) == pytest.approx(0.06441294012862107, abs=1e-9)
    assert spqi(x, y, RATE) == pytest.approx(0.06210357915514684, abs=1e-9)
    assert st_sim_tum(-y, x, RATE) == pytest.approx(-0.9185847473693779, abs=1e-9)


def test_a_new_seed_of_one_process_scores_next_to_nothing() -> None:
    scores = [abs(st_sim_tum(smooth_noise(seed + 50), smooth_noise(seed), RATE)) for seed in range(6)]
    assert max(scores) < 0.1
    assert np.mean(scores) == pytest.approx(0.02, abs=0.03)


def test_the_cosine_variant_of_a_new_seed() -> None:
    """|X| is the texture's own m(f) times a Rayleigh draw: the cosine is (π/4) var m / (mean m² − (π/4) (mean m)²)."""
    hump = np.fft.rfftfreq(64_000, 1.0 / RATE) / 200.0
    m = hump / (1.0 + hump**2) ** 1.5
    expected = np.pi / 4.0 * m.var() / (np.mean(m**2) - np.pi / 4.0 * m.mean() ** 2)
    for seed in range(3):
        score = st_sim_cosine(smooth_noise(seed + 50), smooth_noise(seed))
        assert score.spectral == pytest.approx(expected, abs=0.02)
        assert abs(score.temporal) < 0.02


def test_one_millisecond_costs_about_half() -> None:
    x = smooth_noise(3)
    assert 0.3 < abs(st_sim_tum(np.roll(x, 8), x, RATE)) < 0.8


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_identity_sign_and_level(seed: int) -> None:
    x, y = smooth_noise(seed, 4096), smooth_noise(seed + 1, 4096)
    assert st_sim_tum(x, x, RATE) == 1.0
    assert st_sim_tum(-x, x, RATE) == pytest.approx(-1.0, abs=1e-6)
    assert spqi(x, x, RATE) == 1.0
    assert spqi(-x, x, RATE) == pytest.approx(1.0)
    same, opposite = st_sim_cosine(x, x), st_sim_cosine(-x, x)
    assert (same.spectral, same.temporal, same.combined) == pytest.approx((1.0, 1.0, 1.0))
    assert (opposite.spectral, opposite.temporal, opposite.combined) == pytest.approx((1.0, -1.0, -1.0))
    one, other = st_sim_cosine(x, y), st_sim_cosine(3.0 * y, x)
    assert other.combined == pytest.approx(one.combined, abs=1e-9)


def test_silence_and_constants_are_finite() -> None:
    x, zero = smooth_noise(1, 4096), np.zeros(4096)
    assert st_sim_tum(zero, x, RATE) == 0.0
    assert np.isfinite(st_sim_tum(x, zero, RATE))
    assert spqi(zero, x, RATE) == pytest.approx((1.0 - np.tanh(2.0)) / 2.0, abs=1e-6)
    assert np.isfinite(spqi(x, zero, RATE))
    assert st_sim_cosine(zero, x).combined == 0.0


def test_dct_is_the_orthonormal_one() -> None:
    size = 512
    n = np.arange(size)
    matrix = np.sqrt(2.0 / size) * np.cos(np.pi * (n[None, :] + 0.5) * n[:, None] / size)
    matrix[0] *= np.sqrt(0.5)
    values = np.random.default_rng(0).standard_normal((3, size))
    np.testing.assert_allclose(dct(values), values @ matrix.T, atol=1e-12)


def test_the_threshold_is_lowest_where_skin_is_keenest() -> None:
    threshold = get_touch_threshold_db()
    frequency = np.linspace(0.0, 8000.0, 1024)[:512]
    assert threshold[0] == pytest.approx(62.0 - 77.0)
    assert threshold.min() == pytest.approx(-77.0, abs=0.1)
    assert frequency[threshold.argmin()] == pytest.approx(250.0, abs=8.0)
    held = int(np.argmax(threshold > 0.0))
    assert np.ptp(threshold[held:]) == 0.0


def test_another_rate_is_resampled_and_lengths_must_fit() -> None:
    t = np.arange(10_240) / 10_000.0
    fast = np.sin(2 * np.pi * 125.0 * t)
    slow = np.sin(2 * np.pi * 125.0 * np.arange(8192) / 8000.0)
    np.testing.assert_allclose(resample_to_tum_rate(fast, 10_000.0), slow, atol=1e-9)
    np.testing.assert_array_equal(resample_to_tum_rate(slow, 8000.0), slow)
    assert split_blocks(slow[:-1]).shape == (15, 512)
    for score in (st_sim_tum, spqi):
        assert score(0.5 * fast, fast, 10_000.0) == pytest.approx(score(0.5 * slow, slow, 8000.0), abs=1e-6)
        with pytest.raises(ValueError, match="equally long"):
            score(fast, fast[:-1], RATE)
        with pytest.raises(ValueError, match="block"):
            score(fast[:400], fast[:400], RATE)
    with pytest.raises(ValueError, match="equally long"):
        st_sim_cosine(fast, slow)
