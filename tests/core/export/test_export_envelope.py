"""Envelopes: exact for tones, true to the energy of noise, silent where the signal is, within their stated error."""

from __future__ import annotations

import numpy as np
import pytest
from export_signals import signal_of, texture, tone
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import FileError
from hnf_core.export.envelope import (
    EMPHASIS_DURATION_S,
    Emphasis,
    Envelope,
    compute_envelope,
    make_envelope_grid,
    reduce_windows,
    render_envelope,
    select_control_points,
)
from hnf_core.export.options import MAX_RENDERED_SAMPLES

RANGE = (20.0, 1000.0)


@pytest.mark.parametrize("rate", [2500.0, 8000.0, 10_000.0, 44_100.0])
@pytest.mark.parametrize("hertz", [25.0, 63.0, 160.0, 333.3, 990.0])
def test_a_tone_has_its_own_amplitude_and_frequency(hertz: float, rate: float) -> None:
    if hertz > 0.45 * rate:
        pytest.skip("this rate does not hold it")
    envelope = compute_envelope(tone(hertz, 6.0, 1.0, rate), RANGE)
    inside = (envelope.time > 0.2) & (envelope.time < 0.8)
    np.testing.assert_allclose(envelope.amplitude[inside], 6.0, rtol=0.02)
    np.testing.assert_allclose(envelope.frequency[inside], hertz, rtol=0.02)


def test_the_energy_of_noise_is_kept() -> None:
    signal = texture(4.0)
    envelope = compute_envelope(signal, RANGE)
    assert np.sqrt(np.mean(np.square(envelope.amplitude)) / 2.0) == pytest.approx(signal.rms, rel=0.02)


def test_what_lies_outside_the_range_is_not_in_the_envelope() -> None:
    low, inside = tone(12.0, 5.0), tone(200.0, 2.0)
    both = signal_of(low.samples + inside.samples)
    envelope = compute_envelope(both, (60.0, 500.0))
    middle = (envelope.time > 0.1) & (envelope.time < 0.4)
    np.testing.assert_allclose(envelope.amplitude[middle], 2.0, rtol=0.05)


@settings(deadline=None)
@given(
    count=st.integers(0, 3000),
    rate=st.sampled_from([1000.0, 8000.0, 10_000.0, 44_100.0]),
)
def test_silence_stays_silence(count: int, rate: float) -> None:
    envelope = compute_envelope(signal_of(np.zeros(count), rate), RANGE)
    assert not envelope.amplitude.any()
    assert envelope.emphases == ()
    assert envelope.duration_s == count / rate
    samples = render_envelope(envelope, rate if rate > 2000.0 else 10_000.0, 3)
    assert not samples.any()


def test_a_lifted_hand_is_silent_between_two_rubs() -> None:
    signal = texture(1.5)
    samples = signal.samples.copy()
    samples[5000:10_000] = 0.0
    envelope = compute_envelope(signal_of(samples), RANGE)
    between = (envelope.time > 0.53) & (envelope.time < 0.97)
    assert not envelope.amplitude[between].any()


@settings(deadline=None)
@given(
    samples=hnp.arrays(np.float32, st.integers(1, 2000), elements=st.floats(-50.0, 50.0, width=32)),
    power=st.integers(-8, 8),
)
def test_scaling_scales_the_amplitude_alone(samples: np.ndarray, power: int) -> None:
    factor = 2.0**power
    samples = samples * np.float32(factor) / np.float32(factor)  # without the digits that denormals lose
    once, twice = (compute_envelope(signal_of(samples * np.float32(k)), RANGE) for k in (1.0, factor))
    np.testing.assert_array_equal(once.time, twice.time)
    np.testing.assert_allclose(twice.amplitude, factor * once.amplitude, rtol=1e-9, atol=1e-12 * factor)
    np.testing.assert_allclose(twice.frequency, once.frequency, rtol=1e-9)
    assert len(once.emphases) == len(twice.emphases)


def test_a_constant_has_no_frequency_but_the_middle() -> None:
    for level in (7.023e-42, 1.0, 37.0):
        envelope = compute_envelope(signal_of(np.full(1700, level, dtype=np.float32)), RANGE)
        np.testing.assert_array_equal(envelope.frequency, 0.5 * (RANGE[0] + RANGE[1]))
        assert envelope.amplitude.max() <= 1e-12 * level


@given(level=st.floats(1e-3, 100.0), count=st.integers(1, 5000), range_hz=st.sampled_from([RANGE, (180.0, 280.0)]))
@example(level=5.0, count=1, range_hz=RANGE)
@example(level=5.0, count=3000, range_hz=(180.0, 280.0))
@settings(deadline=None)
def test_what_transforms_round_is_no_click(level: float, count: int, range_hz: tuple[float, float]) -> None:
    assert compute_envelope(signal_of(np.full(count, level)), range_hz).emphases == ()


@settings(deadline=None)
@given(samples=hnp.arrays(np.float32, st.integers(0, 2000), elements=st.floats(-50.0, 50.0, width=32)))
def test_every_envelope_is_sound(samples: np.ndarray) -> None:
    envelope = compute_envelope(signal_of(samples), RANGE)
    assert envelope.time[0] == 0.0
    assert (np.diff(envelope.time) > 0.0).all()
    assert envelope.duration_s == len(samples) / 10_000.0
    assert np.isfinite(envelope.amplitude).all()
    assert np.isfinite(envelope.frequency).all()
    assert (envelope.amplitude >= 0.0).all()
    assert (envelope.frequency >= RANGE[0]).all()
    assert (envelope.frequency <= RANGE[1]).all()
    assert envelope.amplitude.max() <= np.abs(samples).max(initial=0.0) * (1.0 + 1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(FileError, match="not finite"):
        compute_envelope(signal_of(np.array([0.0, bad, 1.0])), RANGE)


def test_a_click_is_told_apart_from_a_texture() -> None:
    rough = texture(2.0)
    assert compute_envelope(rough, RANGE).emphases == ()
    samples = rough.samples * 0.1
    samples[7000:7010] += 12.0
    (click,) = compute_envelope(signal_of(samples), RANGE).emphases
    assert click.time_s == pytest.approx(0.7, abs=0.005)
    assert click.amplitude == pytest.approx(12.0, rel=0.1)
    calm, told, whole = (
        compute_envelope(signal_of(each), RANGE, separate_clicks=apart).amplitude
        for each, apart in ((rough.samples * 0.1, True), (samples, True), (samples, False))
    )
    assert np.abs(told - calm).max() < 0.5
    assert whole.max() > 4.0


@pytest.mark.parametrize(
    "swing", [np.ones(20_000), np.sin(2 * np.pi * 5e-4 * np.arange(20_000)), np.linspace(-1, 1, 20_000)]
)
def test_what_lies_below_the_range_is_no_click(swing: np.ndarray) -> None:
    rough = 0.1 * texture(2.0).samples
    calm, swung = (compute_envelope(signal_of(each), RANGE) for each in (rough, rough + 5.0 * swing))
    assert swung.emphases == ()
    inside = (calm.time > 0.1) & (calm.time < 1.9)
    np.testing.assert_allclose(swung.amplitude[inside], calm.amplitude[inside], atol=0.05)
    assert not compute_envelope(signal_of(5.0 * np.ones(3000)), RANGE).amplitude.max() > 1e-9


def noise(seed: int, low: float, high: float, rms: float, count: int = 20_000, rate: float = 10_000.0) -> np.ndarray:
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    hertz = np.fft.rfftfreq(count, 1.0 / rate)
    band = np.fft.irfft(spectrum * ((hertz >= low) & (hertz <= high)), count)
    return np.asarray(rms * band / band.std())


RANGES = st.sampled_from([RANGE, (60.0, 300.0), (180.0, 280.0)])
PITCH = st.floats(0.5, np.log2(4990.0)).map(lambda octaves: 2.0**octaves)
STEADY = settings(deadline=None, max_examples=60)


@STEADY
@given(hertz=PITCH, phase=st.floats(0.0, 6.3), level=st.floats(1e-3, 100.0), range_hz=RANGES)
@example(hertz=600.0, phase=0.0, level=5.0, range_hz=(60.0, 300.0))
@example(hertz=3000.0, phase=0.0, level=10.0, range_hz=RANGE)
def test_a_steady_tone_is_no_click_whatever_the_range(
    hertz: float, phase: float, level: float, range_hz: tuple[float, float]
) -> None:
    swing = level * np.sin(2.0 * np.pi * hertz * np.arange(20_000) / 10_000.0 + phase)
    assert compute_envelope(signal_of(swing), range_hz).emphases == ()


@STEADY
@given(seed=st.integers(0, 2**32), low=st.floats(5.0, 2000.0), octaves=st.floats(0.3, 5.0), range_hz=RANGES)
@example(seed=3, low=500.0, octaves=0.85, range_hz=(60.0, 300.0))
def test_a_steady_noise_is_no_click_whatever_the_range(
    seed: int, low: float, octaves: float, range_hz: tuple[float, float]
) -> None:
    rough = noise(seed, low, low * 2.0**octaves, 2.0)
    assert compute_envelope(signal_of(rough), range_hz).emphases == ()


def test_what_lies_above_the_range_adds_no_strength() -> None:
    felt, unfelt = noise(1, 60.0, 300.0, 0.3), noise(2, 500.0, 900.0, 2.0)
    envelope = compute_envelope(signal_of(felt + unfelt), (60.0, 300.0))
    samples = render_envelope(envelope, 10_000.0, 1)
    assert np.sqrt(np.mean(np.square(samples))) == pytest.approx(0.3, rel=0.05)


@STEADY
@given(
    seed=st.integers(0, 2**32), low=st.floats(60.0, 1000.0), place=st.floats(0.1, 1.9),
    width=st.integers(1, 5), height=st.floats(3.0, 40.0), range_hz=RANGES,
)  # fmt: skip
def test_a_click_is_heard_over_a_calm_texture_of_any_band(
    seed: int, low: float, place: float, width: int, height: float, range_hz: tuple[float, float]
) -> None:
    samples, first = noise(seed, low, 2.0 * low, 0.1), round(10_000.0 * place)
    samples[first : first + 2 * width] += np.repeat([height, -height], width)
    (click,) = compute_envelope(signal_of(samples), range_hz).emphases
    assert click.time_s == pytest.approx(place, abs=0.005)
    assert click.amplitude == pytest.approx(height, abs=0.5 + 0.15 * height)


def test_clicks_by_the_thousand_are_each_told() -> None:
    samples = np.zeros(600_000)
    samples[500::1000] = 5.0
    marks = np.array([each.time_s for each in compute_envelope(signal_of(samples), RANGE).emphases])
    np.testing.assert_allclose(marks, 0.05 + 0.1 * np.arange(600), atol=0.0051)


def test_what_could_not_be_rendered_again_is_refused() -> None:
    with pytest.raises(FileError, match="split it"):
        compute_envelope(signal_of(np.zeros(MAX_RENDERED_SAMPLES // 250 + 1), 10.0), RANGE)


@settings(deadline=None)
@given(
    values=hnp.arrays(np.float64, st.integers(1, 200), elements=st.floats(0.0, 1.0)),
    error=st.floats(1e-6, 0.3),
    data=st.data(),
)
def test_control_points_stay_within_the_error(values: np.ndarray, error: float, data: st.DataObject) -> None:
    steps = data.draw(hnp.arrays(np.float64, len(values), elements=st.floats(1e-3, 1.0)))
    time = np.cumsum(steps)
    kept = data.draw(st.sets(st.integers(0, len(values) - 1), max_size=5))
    chosen = select_control_points(time, values, error, kept)
    assert chosen[0] == 0
    assert chosen[-1] == len(values) - 1
    assert (np.diff(chosen) > 0).all()
    assert kept <= set(chosen.tolist())
    assert np.abs(np.interp(time, time[chosen], values[chosen]) - values).max() <= error * (1.0 + 1e-6) + 1e-9


def test_few_control_points_suffice_for_what_is_simple() -> None:
    time = np.arange(1000.0)
    assert len(select_control_points(time, np.full(1000, 0.4), 0.01)) == 2
    assert len(select_control_points(time, 1e-3 * time, 0.01)) == 2
    assert len(select_control_points(time, np.abs(time - 500.0) / 500.0, 0.001)) <= 4


@settings(deadline=None)
@given(
    values=hnp.arrays(np.float64, st.integers(1, 80), elements=st.floats(-9.0, 9.0)),
    reach=st.integers(0, 12),
)
def test_neighbourhoods_are_those_of_the_plain_loop(values: np.ndarray, reach: int) -> None:
    at = make_envelope_grid(len(values), 1000.0)
    found = reduce_windows(values, at, reach, lambda rows, inside: np.asarray((rows * inside).sum(axis=1)))
    plain = [sum(values[max(0, i - reach) : i + reach + 1]) for i in at]
    np.testing.assert_allclose(found, plain, atol=1e-9)


@settings(deadline=None)
@given(
    amplitude=st.floats(0.01, 30.0),
    hertz=st.floats(20.0, 900.0),
    seconds=st.floats(0.0, 1.0),
    rate=st.sampled_from([4000.0, 10_000.0, 48_000.0]),
    seed=st.integers(-(2**63), 2**63),
)
def test_a_steady_envelope_is_a_sine(amplitude: float, hertz: float, seconds: float, rate: float, seed: int) -> None:
    end = max(seconds, 1e-9)
    envelope = Envelope(np.array([0.0, end]), np.full(2, amplitude), np.full(2, hertz))
    samples = render_envelope(envelope, rate, seed)
    assert len(samples) == round(end * rate)
    assert samples.tobytes() == render_envelope(envelope, rate, seed).tobytes()
    assert np.abs(samples).max(initial=0.0) <= amplitude * (1.0 + 1e-6)
    if len(samples) > 10:
        basis = np.exp(2j * np.pi * hertz * np.arange(len(samples)) / rate)
        matrix = np.stack([basis.real, basis.imag], axis=1)
        fitted, *_ = np.linalg.lstsq(matrix, samples.astype(np.float64), rcond=None)
        np.testing.assert_allclose(matrix @ fitted, samples, atol=1e-4 * amplitude)


def test_seeds_draw_where_the_sine_starts() -> None:
    envelope = compute_envelope(tone(), RANGE)
    assert not np.array_equal(render_envelope(envelope, 10_000.0, 1), render_envelope(envelope, 10_000.0, 2))


def test_a_click_has_its_level_and_its_length() -> None:
    flat = Envelope(np.array([0.0, 0.2]), np.zeros(2), np.full(2, 100.0), (Emphasis(0.1, 9.0, 200.0),))
    samples = render_envelope(flat, 10_000.0, 0)
    assert samples.max() == pytest.approx(9.0, rel=1e-6)
    live = np.flatnonzero(samples) / 10_000.0
    assert live.min() >= 0.1 - 0.5 * EMPHASIS_DURATION_S - 1e-4
    assert live.max() <= 0.1 + 0.5 * EMPHASIS_DURATION_S + 1e-4


def test_what_no_memory_holds_is_refused() -> None:
    endless = Envelope(np.array([0.0, 2.0 * MAX_RENDERED_SAMPLES]), np.ones(2), np.full(2, 100.0))
    with pytest.raises(FileError, match="more than can be rendered"):
        render_envelope(endless, 10_000.0, 0)
    with pytest.raises(FileError, match="cannot hold its 900 Hz"):
        render_envelope(Envelope(np.array([0.0, 1.0]), np.ones(2), np.full(2, 900.0)), 1000.0, 0)
