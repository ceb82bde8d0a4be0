"""Another rate of the model's signal: whatever is computed together, each output is what it is alone."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.field import resampling
from hnf_core.field.resampling import HALF_WIDTH, KAISER_BETA, ROLL_OFF, plan_conversion, resample_stream

RATES = (97.0, 1000.0, 2800.5, 7999.0, 10_001.0, 44_100.0, 47_999.0, 48_000.0, 1e6)


def one_by_one(samples, rate, outputs):
    """Each output's windowed sinc, written out."""
    step, scale = 1e4 / rate, min(1.0, rate / 1e4) * ROLL_OFF
    reach = int(np.ceil(HALF_WIDTH / scale))
    found = []
    for m in outputs:
        place = m * step
        base = int(np.floor(place + 1e-9))
        at = base + np.arange(-reach, reach + 1)
        distance = at - place
        window = np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - (distance / reach) ** 2, 0.0, 1.0)))
        kernel = np.sinc(scale * distance) * window
        inside = (at >= 0) & (at < len(samples))
        found.append(samples[at[inside]] @ kernel[inside] / kernel.sum())
    return np.array(found)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(RATES), st.integers(1, 900))
def test_every_output_is_its_own_windowed_sinc(seed, rate, count):
    samples = np.random.default_rng(seed).standard_normal(count)
    convert = plan_conversion(1e4, rate)
    found = convert.convert(samples, 0, 0, convert.count_outputs(count))
    some = np.unique(np.linspace(0, max(len(found) - 1, 0), 40).astype(int)) if len(found) else []
    np.testing.assert_allclose(found[some], one_by_one(samples, rate, some), atol=1e-8)


@pytest.mark.parametrize("rate", RATES)
def test_few_of_a_phase_are_what_many_of_it_are(monkeypatch, rate):
    samples, convert = np.random.default_rng(1).standard_normal(3000), plan_conversion(1e4, rate)
    count = convert.count_outputs(len(samples))
    found = []
    for few, together in ((0, 2**15), (10**9, 2**15), (10**9, 1)):
        monkeypatch.setattr(resampling, "_FEW_OUTPUTS", few)
        monkeypatch.setattr(resampling, "_KERNEL_NUMBERS", together)
        found.append(convert.convert(samples, 0, 0, min(count, 20_000)))
    np.testing.assert_allclose(found[1], found[0], atol=1e-13)
    np.testing.assert_allclose(found[2], found[0], atol=1e-13)


@pytest.mark.parametrize("rate", [8000.0, 44_100.0, 1e6])
def test_a_stream_gives_no_more_at_once_than_it_says(monkeypatch, rate):
    """However many times the model's rate: a minute at 10 MHz would be five gigabytes."""
    samples, convert = np.random.default_rng(2).standard_normal(12_000), plan_conversion(1e4, rate)
    whole = convert.convert(samples, 0, 0, convert.count_outputs(len(samples)))
    monkeypatch.setattr(resampling, "MAX_BLOCK_OUTPUTS", 5000)
    pieces = list(resample_stream(iter(np.split(samples, [4000, 9000])), len(samples), 1e4, rate))
    assert max(len(piece) for piece in pieces) <= 5000
    np.testing.assert_allclose(np.concatenate(pieces), whole, atol=1e-12)


def test_a_rate_of_many_phases_asks_for_few_kernels_at_once():
    samples, convert = np.zeros(8000), plan_conversion(1e4, 47_999.0)
    tracemalloc.start()
    try:
        convert.convert(samples, 0, 0, convert.count_outputs(len(samples)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8e6
