"""Another rate of the model's signal, by libsoxr: against windowed sincs written out, in time, of the right length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import UsageError
from hnf_core.field import resampling
from hnf_core.field.resampling import check_rates, count_outputs, rate_warnings, resample, resample_stream

RATES = (97.0, 1000.0, 2800.5, 7999.0, 10_001.0, 44_100.0, 47_999.0, 48_000.0, 1e6)
HALF_WIDTH, KAISER_BETA, ROLL_OFF = 256, 16.0, 0.97
"""The reference: a sinc of 256 zero crossings, Kaiser-windowed for −160 dB, flat to 0.94 of the Nyquist frequency."""


def interpolate_by_sinc(samples, rate, outputs):
    """Each output's windowed sinc, written out: the reference."""
    step, scale = 1e4 / rate, min(1.0, rate / 1e4) * ROLL_OFF
    reach = int(np.ceil(HALF_WIDTH / scale))
    found = []
    for m in outputs:
        place = m * step
        at = int(np.floor(place + 1e-9)) + np.arange(-reach, reach + 1)
        distance = at - place
        window = np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - (distance / reach) ** 2, 0.0, 1.0)))
        kernel = np.sinc(scale * distance) * window
        inside = (at >= 0) & (at < len(samples))
        found.append(samples[at[inside]] @ kernel[inside] / kernel.sum())
    return np.array(found)


def draw_band_limited(seed, count, rate):
    """Noise below 0.7 of the lower Nyquist frequency, faded in and out."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.0, 0.35 * min(rate, 1e4), 30)
    phase = 2.0 * np.pi * (frequency[:, None] * np.arange(count) / 1e4 + rng.random((30, 1)))
    return np.sin(phase).sum(axis=0) * np.hanning(count)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(RATES), st.integers(2000, 6000))
def test_every_output_is_its_windowed_sinc(seed, rate, count):
    count = round(count * max(1.0, 1000.0 / rate))  # some hundred periods of the slower rate
    samples = draw_band_limited(seed, count, rate)
    found = resample(samples, 1e4, rate)[0]
    some = np.unique(np.linspace(0, len(found) - 1, 60).astype(int))
    exact = interpolate_by_sinc(samples, rate, some)
    assert np.sqrt(np.mean(np.square(found[some] - exact))) < 1e-4 * np.sqrt(np.mean(np.square(samples)))


@pytest.mark.parametrize("rate", [8000.0, 16_000.0, 44_100.0, 48_000.0])
@pytest.mark.parametrize("hz", [30.0, 250.0, 1000.0])
def test_a_tone_of_the_touch_band_is_exact(rate, hz):
    """To −160 dB of the tone, in time and level."""
    time_s = np.arange(20_000) / 1e4
    found = resample(np.sin(2.0 * np.pi * hz * time_s), 1e4, rate)[0]
    exact = np.sin(2.0 * np.pi * hz * np.arange(len(found)) / rate)
    inner = slice(len(found) // 4, -len(found) // 4)
    assert np.abs(found - exact)[inner].max() < 1e-8


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 3000), st.sampled_from((*RATES, 1.0, 10_000.0)), st.lists(st.integers(0, 3000), max_size=5))
def test_a_stream_is_the_whole_and_has_the_length(count, rate, cuts):
    samples = np.random.default_rng(count).standard_normal(count)
    whole = resample(samples, 1e4, rate)[0]
    blocks = np.split(samples, sorted(min(cut, count) for cut in cuts))
    stream = np.concatenate(list(resample_stream(blocks, count, 1e4, rate)))
    assert len(whole) == count_outputs(count, 1e4, rate)
    assert stream.tobytes() == whole.tobytes()


@pytest.mark.parametrize("rate", [8000.0, 44_100.0, 1e6])
def test_a_stream_gives_no_more_at_once_than_it_says(monkeypatch, rate):
    """However many times the model's rate: a minute at 10 MHz would be five gigabytes."""
    samples = np.random.default_rng(2).standard_normal(120_000)
    whole = resample(samples, 1e4, rate)[0]
    monkeypatch.setattr(resampling, "MAX_BLOCK_OUTPUTS", 50_000)
    pieces = list(resample_stream([samples], len(samples), 1e4, rate))
    # libsoxr holds some thousand samples of its input back, and gives them together.
    assert max(len(piece) for piece in pieces) <= 50_000 + 5000 * max(rate / 1e4, 1.0)
    assert np.concatenate(pieces).tobytes() == whole.tobytes()


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.1e7, float("nan"), float("inf"), -48_000.0])
def test_what_is_no_rate_is_refused(rate):
    with pytest.raises(UsageError, match="is no sample rate"):
        check_rates(1e4, rate)


def test_rates_too_far_apart_are_refused():
    with pytest.raises(UsageError, match="nothing can be converted"):
        resample(np.zeros(3), 1.0, 1e6)


def test_a_rate_below_touch_is_named():
    assert rate_warnings(2200.0) == ()
    assert "1000 Hz" in rate_warnings(1000.0)[0]
