"""The expected-magnitude form: the field's expected spectrum in every window at any offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material
from hnf_core.metrics.spectra import WINDOW_SAMPLES, welch, window_magnitudes
from hnf_lab.evaluation.bounds import MetricBounds, compute_bounds
from hnf_lab.evaluation.methods import (
    compute_expected_densities,
    make_expected_magnitude_signal,
    synthesise_expected_magnitude,
)

Float = NDArray[np.float64]
SECONDS = 2.0
OFFSETS = range(0, WINDOW_SAMPLES, 125)


@pytest.fixture(scope="module")
def stroke() -> StrokeInput:
    material = get_material("pine-wood")
    action = make_random_smooth_action(SECONDS, 5, speed_m_s=(0.06, 0.2), force_n=(0.5, 2.0))
    return uniform_stroke(action, material.token, material.mechanics)


def limits_at(draws: list[Float], offset: int) -> MetricBounds:
    return compute_bounds([window_magnitudes(each[offset:]) for each in draws])


def test_mse_is_within_ten_percent_of_best_at_every_offset(stroke: StrokeInput) -> None:
    field = load_field()
    draws = [synthesise(field, stroke, seed=seed).signal.samples.astype(np.float64) for seed in range(20)]
    ours = synthesise_expected_magnitude(field, stroke)
    assert len(ours) == len(draws[0])
    ratios = []
    for offset in OFFSETS:
        limits = limits_at(draws, offset)
        ratios.append(limits.expected_mse(window_magnitudes(ours[offset:])) / limits.best)
    assert 1.0 < max(ratios) <= 1.10
    one = limits_at(draws, 0)
    assert one.expected_mse(window_magnitudes(draws[0])) > 1.8 * one.best


def test_expected_densities_match_averaged_periodograms() -> None:
    field, material = load_field(), get_material("denim")
    still = uniform_stroke(make_steady_action(8.0, 0.1, 1.0, 0.4), material.token, material.mechanics)
    expected = compute_expected_densities(field, still, 400)
    assert expected.shape == (5, 100)
    # Equal states in other rows of a float32 product: some machines' kernels round the last rows otherwise.
    assert np.ptp(expected[1:], axis=0).max() < 1e-6 * expected.max()
    measured = np.mean(
        [welch(synthesise(field, still, seed=seed).signal.samples, 10_000.0)[1][1:101] for seed in range(3)], axis=0
    )
    level = 10.0 * np.log10(expected[-1] / measured)
    heard = measured > 1e-3 * measured.max()
    assert np.sqrt(np.mean(np.square(level[heard]))) < 0.5
    assert abs(np.mean(level[heard])) < 0.15


def test_magnitude_scales_with_root_density_without_a_seed(stroke: StrokeInput) -> None:
    density = compute_expected_densities(load_field(), stroke, 4)
    once = make_expected_magnitude_signal(density, 20_000)
    np.testing.assert_allclose(make_expected_magnitude_signal(4.0 * density, 20_000), 2.0 * once, rtol=1e-12)
    np.testing.assert_array_equal(once, synthesise_expected_magnitude(load_field(), stroke))
    assert np.all(make_expected_magnitude_signal(np.zeros((3, 100)), 500) == 0.0)


@pytest.mark.parametrize("left", [0, 1, 2, 3])
def test_a_density_is_heard_when_its_state_is(left: int) -> None:
    """States after the last one requested do not shift the earlier ones in time, whatever their number."""
    material = get_material("pine-wood")
    whole = make_random_smooth_action(SECONDS, 5, speed_m_s=(0.06, 0.2), force_n=(0.5, 2.0))
    states = len(whole.speed) // 4 * 4 - 3 + left
    names = ("direction", "speed", "force", "position", "contact")
    action = replace(whole, **{name: getattr(whole, name)[:states] for name in names})
    cut = synthesise_expected_magnitude(load_field(), uniform_stroke(action, material.token, material.mechanics))
    ours = synthesise_expected_magnitude(load_field(), uniform_stroke(whole, material.token, material.mechanics))
    same = (states - 1) // 4 * 4 * 50
    np.testing.assert_allclose(cut[:same], ours[:same], atol=1e-3 * np.std(ours))


def test_a_flat_density_gives_its_magnitude_in_every_bin() -> None:
    flat = make_expected_magnitude_signal(np.full((2, 100), 1e-3), 5000)
    target = 0.5 * np.sqrt(np.pi * 1e-3 * 0.5 * 10_000.0 * 375.0)
    for offset in (0, 130, 500):
        shown = window_magnitudes(flat[offset : offset + 4000])
        assert shown.mean() == pytest.approx(target, rel=0.02)
        assert np.abs(shown / target - 1.0).max() < 0.3
