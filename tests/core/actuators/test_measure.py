"""Estimation, fitting and inversion of an actuator's response."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from responses import of_gains

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.measure.accelerometer import Accelerometer, make_noise, make_sweep, measure_actuator
from hnf_core.actuators.measure.build_profile import make_measured_profile
from hnf_core.actuators.measure.frequency_response import FrequencyResponse, Resonator, estimate_response, fit_resonance
from hnf_core.actuators.measure.inverse_filter import (
    MAX_BOOST_DB,
    CompensationFilter,
    compute_band_errors,
    compute_filter_gain,
    compute_inverse_gain,
    compute_third_octave_centres,
    design_inverse_filter,
    find_largest_errors_db,
    make_compensation,
)
from hnf_core.actuators.profile import GENERIC
from hnf_core.actuators.signal_chain import SignalChain
from hnf_core.actuators.sink import SinkFormat, SinkStatus
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.virtual_transducer import GENERIC_TRANSDUCER, counts_to_drive, simulate_motion
from hnf_core.errors import DeviceError, UsageError
from hnf_core.metrics.spectra import band_power
from hnf_core.signal import Signal

RATE = 10_000.0
GRID_HZ = np.geomspace(10.0, 1000.0, 150)
RESONATORS = st.builds(
    Resonator,
    st.floats(30.0, 500.0),
    st.floats(0.05, 1.0),
    st.floats(0.05, 20.0),
)


def through(resonator: Resonator, samples: np.ndarray) -> np.ndarray:
    """What the resonator makes of samples, with its ringing after them."""
    size = 2 * len(samples)
    frequency = np.fft.rfftfreq(size, 1.0 / RATE)
    return np.asarray(
        np.fft.irfft(np.fft.rfft(samples, size) * resonator.evaluate(frequency), size)[: len(samples) + 2000]
    )


def level_db(gain: np.ndarray) -> np.ndarray:
    return np.asarray(20.0 * np.log10(np.abs(gain)))


@pytest.mark.parametrize("kind", ["sweep", "noise"])
@pytest.mark.parametrize("delay", [0, 7, 480, -300])
def test_a_known_response_is_found_whatever_the_delay(kind: str, delay: int) -> None:
    signal = (
        make_sweep(RATE, 6.0, 8.0, 1100.0, 5.0) if kind == "sweep" else make_noise(RATE, 6.0, 8.0, 1100.0, 5.0, seed=3)
    )
    truth = Resonator(90.0, 0.15, 0.7)
    got = through(truth, signal.samples)
    got = np.concatenate([np.zeros(delay), got]) if delay >= 0 else got[-delay:]
    got += 1e-3 * np.random.default_rng(0).standard_normal(len(got))
    found = estimate_response(signal.samples, got, RATE, 20.0, 900.0)
    error = found.gain_db - level_db(truth.evaluate(found.frequency_hz))
    assert np.abs(error).max() < 0.5  # next to the resonance, where 2.5 Hz and 0.4 s are coarse
    assert np.sqrt(np.mean(np.square(error))) < 0.1
    assert found.coherence.min() > 0.9


def test_a_louder_sensor_shifts_the_level_and_nothing_else() -> None:
    signal = make_sweep(RATE, 4.0, 8.0, 1100.0, 5.0)
    got = through(Resonator(90.0, 0.3, 0.7), signal.samples)
    one, other = (estimate_response(signal.samples, got * factor, RATE, 20.0, 900.0) for factor in (1.0, 10.0))
    np.testing.assert_allclose(other.gain_db - one.gain_db, 20.0, atol=1e-9)
    np.testing.assert_allclose(other.coherence, one.coherence, atol=1e-12)


def test_noise_of_the_sensor_does_not_raise_the_response() -> None:
    signal = make_noise(RATE, 20.0, 8.0, 1100.0, 5.0, seed=1)
    truth = Resonator(90.0, 0.3, 1.0)
    got = through(truth, signal.samples)
    got += 0.5 * np.sqrt(np.mean(got**2)) * np.random.default_rng(0).standard_normal(len(got))
    found = estimate_response(signal.samples, got, RATE, 60.0, 600.0)
    error = found.gain_db - level_db(truth.evaluate(found.frequency_hz))
    assert abs(float(np.mean(error))) < 0.1
    assert found.coherence.max() < 0.9999


@pytest.mark.parametrize(
    "got", [np.zeros(60_000), np.full(60_000, np.nan), np.random.default_rng(0).standard_normal(60_000)]
)
def test_what_did_not_come_from_the_excitation_is_refused(got: np.ndarray) -> None:
    signal = make_sweep(RATE, 6.0, 8.0, 1100.0, 5.0)
    with pytest.raises(UsageError):
        estimate_response(signal.samples, got, RATE, 20.0, 900.0)


@settings(max_examples=40, deadline=None)
@given(RESONATORS)
def test_a_resonator_is_found_again(truth: Resonator) -> None:
    found = fit_resonance(of_gains(GRID_HZ, truth.evaluate(GRID_HZ)))
    assert found.error_db < 1e-3
    assert found.resonance_hz == pytest.approx(truth.resonance_hz, rel=1e-3)
    assert found.damping == pytest.approx(truth.damping, rel=1e-3)
    assert found.gain == pytest.approx(truth.gain, rel=1e-3)


LEVELS = st.lists(st.floats(-60.0, 40.0), min_size=5, max_size=40)


@settings(max_examples=60, deadline=None)
@given(LEVELS, st.floats(5.0, 100.0), st.floats(1.2, 40.0))
def test_the_inverse_never_asks_for_more_than_20_db(levels: list[float], low: float, ratio: float) -> None:
    frequency = np.geomspace(10.0, 4000.0, len(levels))
    response = of_gains(frequency, 10.0 ** (np.array(levels) / 20.0))
    asked = np.geomspace(1.0, 5000.0, 2000)
    gain = compute_inverse_gain(response, (low, min(low * ratio, 5000.0)), asked)
    assert gain.max() <= 10.0 ** (MAX_BOOST_DB / 20.0) * (1.0 + 1e-12)
    assert (gain > 0.0).all()
    assert (gain[(asked < low / 2.0) | (asked > 2.0 * low * ratio)] == 1.0).all()


@settings(max_examples=20, deadline=None)
@given(RESONATORS)
def test_taps_have_the_inverse_magnitude_and_no_delay(resonator: Resonator) -> None:
    response = of_gains(GRID_HZ, resonator.evaluate(GRID_HZ) / resonator.gain)
    range_hz = (20.0, 900.0)
    taps = design_inverse_filter(response, range_hz, RATE)
    inside = GRID_HZ[(GRID_HZ > 25.0) & (GRID_HZ < 800.0)]
    off = level_db(compute_filter_gain(taps, inside, RATE)) - level_db(compute_inverse_gain(response, range_hz, inside))
    assert np.abs(off).max() < 1.0
    assert np.sqrt(np.mean(np.square(off))) < 0.3
    # Minimum phase: no other causal filter of this magnitude gives more of its energy earlier; its first value is e^c0.
    size = 1 << 16
    mean_log = np.mean(np.log(np.abs(np.fft.fft(taps, size))))
    assert taps[0] == pytest.approx(np.exp(mean_log), rel=1e-2)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(0, 60), min_size=1, max_size=12), st.integers(1, 3), st.integers(1, 90))
def test_compensation_of_blocks_is_that_of_the_whole(cuts: list[int], channels: int, count: int) -> None:
    random = np.random.default_rng(5)
    taps, samples = random.standard_normal(count), random.standard_normal((sum(cuts), channels)).astype(np.float32)
    stage, at, blocks = CompensationFilter(taps, channels), 0, []
    for cut in cuts:
        blocks.append(stage.process(samples[at : at + cut]))
        at += cut
    whole = np.concatenate(blocks)
    assert whole.shape == samples.shape
    for channel in range(channels):
        plain = np.convolve(np.append(samples[:, channel].astype(np.float64), 0.0), taps)[: len(samples)]
        np.testing.assert_allclose(whole[:, channel], plain, atol=1e-4)


def test_compensation_lowers_band_errors_on_the_transducer() -> None:
    """Measured on one excitation, proved on another, through the simulated mass and spring and not its estimate."""
    limits = GENERIC.limits
    asked = make_sweep(RATE, 8.0, 8.0, 1100.0, 5.0)
    counts = counts_of(asked.samples, None)
    response = estimate_response(counts[:, 0] * (limits.full_scale_m_s2 / 32767), moved(counts), RATE, 10.0, 1000.0)
    profile = make_measured_profile(GENERIC, response, title="it", calibrated=True).profile
    assert profile.range_hz is not None
    test = make_noise(RATE, 8.0, 15.0, 1200.0, 1.5, seed=9)
    (stage,) = make_compensation(profile, RATE, 1)
    edges = [float(centre * 2.0 ** (-1 / 6)) for centre in compute_third_octave_centres(25.0, 850.0)]
    wanted = band_power(test.samples, RATE, tuple(edges))
    errors = []
    for got in (
        moved(counts_of(test.samples, None)),
        moved(counts_of(test.samples, stage, profile.limits.full_scale_m_s2)),
    ):
        errors.append(np.abs(10.0 * np.log10(band_power(got[: len(test.samples)], RATE, tuple(edges)) / wanted)))
    assert errors[0].max() > 9.0
    assert errors[1].max() < 0.7
    assert np.sqrt(np.mean(np.square(errors[1]))) < 0.3
    before, after = find_largest_errors_db(compute_band_errors(response_in(profile), profile.range_hz, RATE))
    assert after < 1.0 < before


def response_in(profile: object) -> FrequencyResponse:
    response = getattr(profile, "response", None)
    assert isinstance(response, FrequencyResponse)
    return response


def counts_of(samples: np.ndarray, stage: CompensationFilter | None, full_scale: float | None = None) -> np.ndarray:
    limits = GENERIC.limits if full_scale is None else replace(GENERIC.limits, full_scale_m_s2=full_scale)
    source = BufferSource(np.asarray(samples, dtype=np.float32)[:, None], RATE)
    chain = SignalChain(source, SinkFormat(RATE, 1, 150, "it"), limits, () if stage is None else (stage,))
    return chain.render_block(len(samples))


def moved(counts: np.ndarray) -> np.ndarray:
    return np.asarray(simulate_motion(GENERIC_TRANSDUCER, counts_to_drive(counts), RATE).acceleration[:, 0])


@pytest.mark.parametrize(
    ("frequency", "gain", "coherence"),
    [
        ([10.0], [0.0], [1.0]),
        ([20.0, 10.0], [0.0, 0.0], [1.0, 1.0]),
        ([10.0, 20.0], [0.0, np.nan], [1.0, 1.0]),
        ([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]),
        ([10.0, 20.0], [0.0, 0.0], [1.0, 2.0]),
    ],
)
def test_what_is_no_response_is_refused(frequency: list[float], gain: list[float], coherence: list[float]) -> None:
    columns = [np.array(values, dtype=np.float64) for values in (frequency, gain, coherence)]
    with pytest.raises(UsageError):
        FrequencyResponse(columns[0], columns[1], np.zeros(len(columns[0])), columns[2])


@pytest.mark.parametrize(
    "arguments", [(RATE, 0.1, 10, 100, 1), (RATE, 5, 100, 10, 1), (RATE, 5, 10, 6000, 1), (RATE, 5, 10, 100, 0)]
)
def test_what_is_no_excitation_is_refused(arguments: tuple[float, float, float, float, float]) -> None:
    with pytest.raises(UsageError):
        make_sweep(*arguments)
    with pytest.raises(UsageError):
        make_noise(*arguments, seed=0)


def test_an_excitation_stays_within_its_level_and_band() -> None:
    for signal in (make_sweep(RATE, 5.0, 20.0, 800.0, 3.0), make_noise(RATE, 5.0, 20.0, 800.0, 3.0, seed=1)):
        assert np.abs(signal.samples).max() <= 3.0 + 1e-5
        inside, outside = band_power(signal.samples, RATE, (15.0, 1000.0, 5000.0))
        assert outside < 1e-3 * inside
    assert np.array_equal(
        make_noise(RATE, 1.0, 20, 800, 3.0, seed=1).samples, make_noise(RATE, 1.0, 20, 800, 3.0, seed=1).samples
    )


class Deaf(Accelerometer):
    """Hears nothing, and needs no sound input."""

    def __init__(self) -> None:
        super().__init__(None, 1.0)

    def __enter__(self) -> Deaf:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def get_signal(self) -> Signal:
        return Signal(np.zeros(100, np.float32), RATE, 0)


def test_a_limited_or_underrun_measurement_is_refused(tmp_path: Path) -> None:
    loud = make_sweep(RATE, 0.5, 20.0, 500.0, 20.0)
    with pytest.raises(UsageError, match=r"beyond the device's limits\. Measure with a lower --level"):
        measure_actuator(FileSink(tmp_path / "x.wav", int(RATE)), Deaf(), loud, Limits(10.0))
    poor = FileSink(tmp_path / "x.wav", int(RATE))
    poor.status = lambda: SinkStatus(played=5000, underruns=3)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"ran out of samples 3 times\. Close"):
        measure_actuator(poor, Deaf(), loud, Limits(30.0))
