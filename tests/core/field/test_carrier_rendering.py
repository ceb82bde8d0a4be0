"""The fast carriers against the plain ones: equal to −57 dB (−65 in the median), hop by hop, whatever the hand does."""

import dataclasses
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from normal_noise import normal_block

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field.carrier_rendering import REACH_SAMPLES, Knots, render_carrier_hops, render_carriers_full_rate
from hnf_core.field.carriers import (
    ARC_BLOCK,
    Carriers,
    draw_band_bins,
    draw_band_spectra,
    make_bins,
    make_wave_plan,
    render_complex_waves,
    render_real_waves,
)
from hnf_core.field.noise_cache import (
    ARC_HOP_CELLS,
    CELL_SAMPLES,
    DEMODULATION_CYCLES,
    HOP_SIZE,
    LEVEL_MARGINS,
    get_arc_hop,
    get_time_hop,
    group_time_levels,
)
from hnf_core.field.stroke import SAMPLES_PER_STATE, extrapolate_position
from hnf_core.kernel.loader import without_kernel

CARRIERS = Carriers()
FAR = 10 ** (-57 / 20)


def wandering(seed: int, seconds: float, fastest: float, states: int = 4) -> tuple[Action, np.ndarray]:
    """A hand that speeds up, rests and turns back, and amplitudes that go elsewhere every so many states."""
    rng = np.random.default_rng(seed)
    count = round(seconds * ACTION_RATE_HZ) + 1
    t = np.arange(count) / ACTION_RATE_HZ
    velocity = fastest * np.sin(2 * np.pi * (rng.uniform(0.2, 2.0) * t + rng.random()))
    velocity[(t > 0.4 * seconds) & (t < 0.5 * seconds)] = 0.0
    place = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) / ACTION_RATE_HZ)])
    action = Action(ACTION_RATE_HZ, np.tile([1.0, 0.0], (count, 1)), np.abs(velocity), np.ones(count), place, t >= 0)
    goal, place_of = rng.uniform(0.0, 1.0, (count // states + 2, CARRIERS.count)), np.arange(count) / states
    low, share = place_of.astype(int), (place_of % 1.0)[:, None]
    share = share**2 * (3.0 - 2.0 * share)
    amplitude = goal[low] * (1.0 - share) + goal[low + 1] * share
    # What the field does too: nothing that this hand would move faster than the model rate can hold.
    fast = np.abs(velocity)[:, None] * CARRIERS.arc_edges()[1:] > 4000.0
    around = np.max([np.roll(fast, k, axis=0) for k in (-2, -1, 0, 1, 2)], axis=0)
    amplitude[:, CARRIERS.arc_slice] *= ~around
    amplitude[(t > 0.7 * seconds) & (t < 0.8 * seconds)] = 0.0
    return action, amplitude


def fast(knots: Knots, action: Action, seed: int, hops: range) -> np.ndarray:
    place = extrapolate_position(
        action, hops.start * HOP_SIZE - REACH_SAMPLES, len(hops) * HOP_SIZE + 2 * REACH_SAMPLES
    )
    return render_carrier_hops(knots, CARRIERS, seed, place, hops)


def states(amplitude: np.ndarray) -> Knots:
    return Knots(SAMPLES_PER_STATE * np.arange(len(amplitude)), amplitude)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.002, 0.05, 0.3, 2.0]))
def test_as_the_plain_carriers(seed, fastest):
    action, amplitude = wandering(seed, 1.2, fastest)
    plain = render_carriers_full_rate(amplitude[:, None, :], CARRIERS, seed, action, 0, 2 * HOP_SIZE)
    found = fast(states(amplitude), action, seed, range(2))
    assert rms(found - plain) < FAR * rms(plain)


def test_as_the_plain_carriers_when_every_state_is_another():
    action, amplitude = wandering(3, 1.2, 0.1, states=1)
    plain = render_carriers_full_rate(amplitude[:, None, :], CARRIERS, 1, action, 0, 2 * HOP_SIZE)
    assert rms(fast(states(amplitude), action, 1, range(2)) - plain) < 10 ** (-50 / 20) * rms(plain)


@pytest.mark.parametrize("family", ["time", *range(CARRIERS.arc_octaves)])
def test_as_the_plain_carriers_each_family_alone(family):
    action, amplitude = wandering(3, 1.0, 0.1)
    only = np.zeros_like(amplitude)
    first = CARRIERS.arc_slice.start + 24 * family if family != "time" else 0
    part = CARRIERS.time_slice if family == "time" else slice(first, first + 24)
    only[:, part] = amplitude[:, part]
    plain = render_carriers_full_rate(only[:, None, :], CARRIERS, 1, action, 0, 2 * HOP_SIZE)
    assert rms(fast(states(only), action, 1, range(2)) - plain) < FAR * rms(plain)


def test_nothing_from_nothing():
    action, amplitude = wandering(5, 1.0, 0.1)
    assert not fast(states(np.zeros_like(amplitude)), action, 2, range(2)).any()


def test_sparse_knots_are_the_straight_lines_between_them():
    action, amplitude = wandering(7, 1.0, 0.1)
    at = np.array([0, 350, 400, 2000, 6100, 9000, 10_000])
    sparse = amplitude[at // SAMPLES_PER_STATE]
    every = np.stack([np.interp(SAMPLES_PER_STATE * np.arange(201), at, column) for column in sparse.T], axis=1)
    few, many = Knots(at, sparse), states(every)
    reading = fast(many, action, 0, range(2))
    assert rms(fast(few, action, 0, range(2)) - reading) < 1e-5 * rms(reading)


def test_a_jump_of_the_hand_asks_for_no_metres_of_cells():
    action, amplitude = wandering(9, 1.0, 0.05)
    place = action.position + np.where(np.arange(201) > 100, 1e6, 0.0)
    amplitude[98:104, CARRIERS.arc_slice] = 0.0
    jumped = dataclasses.replace(action, position=place)
    plain = render_carriers_full_rate(amplitude[:, None, :], CARRIERS, 1, jumped, 0, 2 * HOP_SIZE)
    assert rms(fast(states(amplitude), jumped, 1, range(2)) - plain) < FAR * rms(plain)


@pytest.mark.parametrize("hop", [-3, 0, 12])
def test_hops_of_time_are_the_carriers(hop):
    assert [each.stop - each.start for each in group_time_levels(CARRIERS)] == [7, 19, 31]
    for level, (bands, waves) in enumerate(
        zip(group_time_levels(CARRIERS), get_time_hop(CARRIERS, 3, hop).waves, strict=True)
    ):
        margin = LEVEL_MARGINS[level] << level
        plain = CARRIERS.time_samples(3, hop * HOP_SIZE - margin, HOP_SIZE + 2 * margin)
        np.testing.assert_allclose(waves, plain[bands, :: 1 << level], atol=1e-6)


@pytest.mark.parametrize(("octave", "hop"), [(0, -2), (4, 0), (7, 1000)])
def test_hops_of_arc_length_are_the_carriers(octave, hop):
    at = (hop * ARC_HOP_CELLS + np.arange(ARC_HOP_CELLS)) * CELL_SAMPLES
    waves = CARRIERS.arc_samples(3, octave, int(at[0]), ARC_HOP_CELLS * CELL_SAMPLES)[:, ::CELL_SAMPLES]
    turned = get_arc_hop(CARRIERS, 3, octave, hop).waves * np.exp(2j * np.pi * at * DEMODULATION_CYCLES / ARC_BLOCK)
    np.testing.assert_allclose(turned.real, waves, atol=1e-6)


@given(st.integers(0, 2**63), st.integers(-(2**40), 2**40))
@settings(max_examples=20, deadline=None)
def test_bins_are_those_of_the_white_spectrum(seed, block):
    edges, size = np.array([20.0, 31.5, 40.0, 77.0]), 256
    numbers = normal_block(seed, 5, block, 2 * (size // 2 + 1))
    white = numbers[: size // 2 + 1] + 1j * numbers[size // 2 + 1 :]
    bins = make_bins(edges, size)
    drawn = draw_band_bins(seed, 5, block, bins)
    assert bins.starts.tolist() == [20, 32, 40, 77]
    level = np.repeat(size / np.sqrt(4.0 * np.diff(bins.starts)), np.diff(bins.starts))
    np.testing.assert_allclose(drawn, white[20:77] * level, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(draw_band_spectra(seed, 5, block, edges, size).sum(axis=0)[20:77], drawn)


@pytest.mark.parametrize("size", [256, 2048])
def test_waves_of_a_few_bins_are_the_inverse_transform(size):
    generator, starts = np.random.default_rng(size), np.array([3, 4, 21, 53, 90])  # the last is left to the transform
    bins = generator.standard_normal(87) + 1j * generator.standard_normal(87)
    spectra = np.zeros((4, size), dtype=np.complex128)
    for band, (low, high) in enumerate(pairwise(starts)):
        spectra[band, low:high] = bins[low - 3 : high - 3]
    window, waves = generator.random(size), size * np.fft.ifft(spectra)
    lower = size * np.fft.ifft(np.roll(spectra[:3], -10, axis=1)) * window
    for context in (nullcontext(), without_kernel()):
        with context:
            found = render_real_waves(bins, make_wave_plan(starts, window))
            turned_back = render_complex_waves(bins[:50], make_wave_plan(starts[:4], window, 10))
        np.testing.assert_allclose(found, 2.0 * waves.real * window, atol=2e-5)
        np.testing.assert_allclose(turned_back, lower, atol=2e-5)


def test_a_band_without_a_bin_is_refused():
    with pytest.raises(ValueError, match="band 1 holds no bin"):
        make_bins(np.array([2.0, 4.2, 4.5, 9.0]), 64)
