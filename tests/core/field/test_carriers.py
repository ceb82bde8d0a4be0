"""Laws of the carriers: unit power, their own band, any block alone, no repetition, tones that glide."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from normal_noise import normal_block

from hnf_core.field.carrier_rendering import interpolate_amplitudes, sum_arc_carriers, sum_time_carriers
from hnf_core.field.carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ, TIME_BLOCK, Carriers, crossfade_window
from hnf_core.metrics.spectra import welch

CARRIERS = Carriers()


def test_bands_cover_what_touch_feels():
    time, arc = CARRIERS.time_edges(), CARRIERS.arc_edges()
    assert CARRIERS.time_count == 57
    assert (time[0], time[-1]) == (2.0, pytest.approx(5000.0))
    assert np.all(np.diff(time) > 0)
    assert np.all(np.diff(time[:51]) <= 20.0)
    assert arc[0] == 50.0
    assert arc[-1] >= 1e4
    np.testing.assert_allclose(arc[1:] / arc[:-1], 2.0 ** (1.0 / 24.0))


@given(st.integers(0, 2**63), st.integers(-(2**40), 2**40), st.integers(1, 50))
def test_normal_blocks_are_functions_of_their_place(seed, block, count):
    first = normal_block(seed, 3, block, count)
    np.testing.assert_array_equal(first, normal_block(seed, 3, block, count))
    assert not np.array_equal(first, normal_block(seed, 3, block + 1, count))
    assert not np.array_equal(first, normal_block(seed, 4, block, count))
    assert not np.array_equal(first, normal_block(seed + 1, 3, block, count))


def test_noise_is_standard_normal():
    sample = np.concatenate([normal_block(7, 0, block, 4096) for block in range(-8, 8)])
    assert abs(sample.mean()) < 0.02
    assert sample.std() == pytest.approx(1.0, abs=0.02)
    assert np.mean(sample**4) == pytest.approx(3.0, abs=0.15)


def test_fades_are_power_complementary():
    window = crossfade_window(64)
    np.testing.assert_allclose(window[:32] ** 2 + window[32:] ** 2, 1.0)


def test_time_carriers_have_unit_power_inside_their_band():
    waves = CARRIERS.time_samples(3, -20_000, 160_000)
    power = np.mean(np.square(waves), axis=1)
    assert power.mean() == pytest.approx(1.0, abs=0.03)
    # 16 s of a 20 Hz band hold about 320 independent values of the power.
    assert np.all(np.abs(power - 1.0) < 0.35)
    for band in (0, 7, 30, 52, 56):
        frequency, density = welch(waves[band], MODEL_RATE_HZ, 5000)
        low, high = CARRIERS.time_edges()[band : band + 2]
        inside = (frequency > low - 5.0) & (frequency < high + 5.0)
        assert density[inside].sum() / density.sum() > 0.999


@pytest.mark.parametrize("octave", [0, 4, 7])
def test_arc_carriers_have_unit_power_inside_their_band(octave):
    step = CARRIERS.arc_step_m(octave)
    waves = CARRIERS.arc_samples(3, octave, -40_000, 200_000)
    assert np.mean(np.square(waves)) == pytest.approx(1.0, abs=0.05)
    spectrum = np.square(np.abs(np.fft.rfft(waves[5] * np.hanning(waves.shape[1]))))
    kappa = np.fft.rfftfreq(waves.shape[1], step)
    low, high = CARRIERS.arc_edges()[octave * ARC_PER_OCTAVE + 5 :][:2]
    inside = (kappa > low * 0.995) & (kappa < high * 1.005)
    assert spectrum[inside].sum() / spectrum.sum() > 0.995


@settings(max_examples=12, deadline=None)
@given(st.integers(-30_000, 30_000), st.integers(1, 9000), st.integers(0, 8999))
def test_any_stretch_is_computable_alone(start, count, split):
    split = min(split, count)
    few = Carriers(time_edges_hz=(100.0, 120.0, 400.0))
    whole = few.time_samples(11, start, count)
    parts = [few.time_samples(11, start, split), few.time_samples(11, start + split, count - split)]
    np.testing.assert_array_equal(whole, np.concatenate(parts, axis=1))


def test_nothing_repeats():
    few = Carriers(time_edges_hz=(20.0, 5000.0))
    wave = few.time_samples(5, 0, 16 * TIME_BLOCK)[0]
    spectrum = np.fft.rfft(wave, 2 * len(wave))
    correlation = np.fft.irfft(np.square(np.abs(spectrum)))[: len(wave) // 2] / np.sum(np.square(wave))
    assert np.max(np.abs(correlation[50:])) < 0.05


def test_bands_are_independent():
    waves = CARRIERS.time_samples(3, 0, 40_000)
    correlation = np.corrcoef(waves)
    assert np.max(np.abs(correlation - np.eye(len(waves)))) < 0.12


def test_amplitudes_are_read_linearly_between_states():
    amplitude = np.array([[0.0], [2.0], [1.0]])
    read = interpolate_amplitudes(amplitude, 25, 75)[:, 0]
    assert read[0] == pytest.approx(1.0)
    assert read[25] == pytest.approx(2.0)
    assert read[50] == pytest.approx(1.5)


def test_modulation_is_amplitude_times_carrier():
    few = Carriers(time_edges_hz=(40.0, 80.0, 160.0), arc_octaves=0)
    amplitude = np.random.default_rng(0).random((21, 2))
    direct = np.einsum("ik,ki->i", interpolate_amplitudes(amplitude, 130, 700), few.time_samples(2, 130, 700))
    np.testing.assert_allclose(sum_time_carriers(amplitude, few, 2, 130, 700), direct, atol=1e-12)


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.1, 0.2, 0.4])
def test_the_tone_of_a_grating_follows_speed_over_pitch(speed):
    pitch = 0.93e-3
    position = CARRIERS.arc_edges()
    band = int(np.searchsorted(position, 1.0 / pitch) - 1)
    count = 40_000
    amplitude = np.zeros((count // 50 + 1, CARRIERS.arc_count))
    amplitude[:, band] = 1.0
    place = np.arange(count) * speed / MODEL_RATE_HZ
    wave = sum_arc_carriers(amplitude, CARRIERS, lambda o, a, n: CARRIERS.arc_samples(9, o, a, n), place, 0)
    spectrum = np.square(np.abs(np.fft.rfft(wave * np.hanning(count))))
    frequency = np.fft.rfftfreq(count, 1.0 / MODEL_RATE_HZ)
    centroid = float((spectrum * frequency).sum() / spectrum.sum())
    assert centroid == pytest.approx(speed / pitch, rel=0.02)


def test_stroking_back_meets_the_same_texture():
    amplitude = np.ones((41, CARRIERS.arc_count))
    there = np.arange(2000) * 1e-5
    source = lambda o, a, n: CARRIERS.arc_samples(1, o, a, n)  # noqa: E731
    forward = sum_arc_carriers(amplitude, CARRIERS, source, there, 0)
    back = sum_arc_carriers(amplitude, CARRIERS, source, there[::-1], 0)
    np.testing.assert_allclose(forward, back[::-1], atol=1e-9)
