"""A rate is converted as if all of it were there at once: no seam, no drift, no alias."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.actuators.signal_chain import (
    ZERO_CROSSINGS,
    PassThroughResampler,
    PolyphaseResampler,
    Resampler,
    make_resampler,
)
from hnf_core.errors import UsageError

RATES = (1000.0, 2800.0, 7999.0, 8000.0, 10000.0, 44100.0, 48000.0, 2800.5)
PAIRS = (
    (2800.0, 10000.0),
    (8000.0, 10000.0),
    (10000.0, 8000.0),
    (48000.0, 8000.0),
    (44100.0, 48000.0),
    (2800.5, 7999.0),
)


def converted(by: Resampler, samples: NDArray[np.float32], cuts: list[int]) -> NDArray[np.float32]:
    pieces = np.split(samples, cuts)
    return np.concatenate([*(by.process(piece) for piece in pieces), by.finish()])


def level_db(samples: NDArray[np.float64]) -> float:
    return float(20.0 * np.log10(np.sqrt(np.mean(np.square(samples))) / np.sqrt(0.5) + 1e-12))


def sine_fit(
    samples: NDArray[np.float32], hz: float, rate: float, start: int
) -> tuple[float, float, NDArray[np.float64]]:
    """Amplitude, phase (rad, of a sine at t = 0) and what is left, of samples from frame start on."""
    t = (start + np.arange(len(samples))) / rate
    basis = np.stack([np.sin(2.0 * np.pi * hz * t), np.cos(2.0 * np.pi * hz * t)], axis=1)
    found, *_ = np.linalg.lstsq(basis, samples.astype(np.float64), rcond=None)
    return float(np.hypot(*found)), float(math.atan2(found[1], found[0])), samples - basis @ found


@given(st.sampled_from(RATES), st.sampled_from(RATES), st.integers(1, 3), st.integers(0, 700), st.data(), st.booleans())
@settings(max_examples=80, deadline=None)
def test_no_cut_shows_and_the_length_is_exact(
    from_hz: float, to_hz: float, channels: int, frames: int, data: st.DataObject, prompt: bool
) -> None:
    samples = np.random.default_rng(frames).normal(0.0, 10.0, (frames, channels)).astype(np.float32)
    cuts = sorted(data.draw(st.lists(st.integers(0, frames), max_size=8)))
    whole = converted(make_resampler(from_hz, to_hz, channels, low_latency=prompt), samples, [])
    cut = converted(make_resampler(from_hz, to_hz, channels, low_latency=prompt), samples, cuts)
    assert whole.dtype == np.float32
    assert whole.shape[1] == channels
    assert whole.tobytes() == cut.tobytes()
    if prompt:
        assert abs(len(whole) - math.ceil(frames * to_hz / from_hz)) <= (from_hz % 1 > 0 or to_hz % 1 > 0)


@pytest.mark.parametrize(("from_hz", "to_hz"), [(2800.0, 10000.0), (8000.0, 7999.0)])
def test_frame_by_frame_gives_the_same_bytes(from_hz: float, to_hz: float) -> None:
    samples = np.random.default_rng(0).normal(0.0, 10.0, (300, 2)).astype(np.float32)
    whole = converted(PolyphaseResampler(from_hz, to_hz, 2), samples, [])
    assert whole.tobytes() == converted(PolyphaseResampler(from_hz, to_hz, 2), samples, list(range(300))).tobytes()


@pytest.mark.parametrize(("from_hz", "to_hz"), PAIRS)
@pytest.mark.parametrize("share", [0.05, 0.5, 0.8])
def test_a_sine_comes_out_as_that_sine_at_its_time(from_hz: float, to_hz: float, share: float) -> None:
    hz = share * 0.5 * min(from_hz, to_hz)
    wave = np.sin(2.0 * np.pi * hz * np.arange(int(from_hz)) / from_hz).astype(np.float32)[:, None]
    out = converted(make_resampler(from_hz, to_hz, 1), wave, list(range(0, int(from_hz), 37)))[:, 0]
    start = int(0.2 * to_hz)
    amplitude, phase, rest = sine_fit(out[start:-start], hz, to_hz, start)
    assert amplitude == pytest.approx(1.0, abs=1e-3)
    assert phase == pytest.approx(0.0, abs=1e-3)
    assert level_db(rest) < -80.0


@pytest.mark.parametrize(("from_hz", "to_hz"), [pair for pair in PAIRS if pair[1] < pair[0]])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.95])
def test_what_the_lower_rate_cannot_hold_is_gone(from_hz: float, to_hz: float, share: float) -> None:
    hz = 0.5 * to_hz + share * 0.5 * (from_hz - to_hz)
    wave = np.sin(2.0 * np.pi * hz * np.arange(int(from_hz)) / from_hz).astype(np.float32)[:, None]
    out = converted(make_resampler(from_hz, to_hz, 1), wave, [])[:, 0]
    start = int(0.2 * to_hz)
    assert level_db(out[start:-start].astype(np.float64)) < -80.0


def test_a_constant_stays_one() -> None:
    out = converted(make_resampler(2800.0, 48000.0, 1), np.full((1000, 1), 7.0, np.float32), [])
    assert np.allclose(out[2000:-2000], 7.0, atol=1e-5)


def test_equal_rates_pass_untouched() -> None:
    samples = np.random.default_rng(0).integers(0, 2**32, (500, 2), dtype=np.uint32).view(np.float32)
    same = make_resampler(8000.0, 8000.0, 2)
    assert isinstance(same, PassThroughResampler)
    assert converted(same, samples, [3, 99]).tobytes() == samples.tobytes()


def test_nothing_drifts_in_an_hour() -> None:
    """Placed an hour on, as a stream would be, the next frames are still those of that very time."""
    from_hz, to_hz, hz, hour = 2800.0, 44100.0, 50.0, 3600
    by = PolyphaseResampler(from_hz, to_hz, 1)
    by._frames_in, by._frames_out = hour * 2800, hour * 44100 - 441
    by._buffer = np.zeros((1, 10 * ZERO_CROSSINGS))
    by._buffer_start = by._frames_in - 10 * ZERO_CROSSINGS
    t = hour + np.arange(2800) / from_hz
    out = by.process(np.sin(2.0 * np.pi * hz * t).astype(np.float32)[:, None])[:, 0]
    skip = 4410
    _, phase, rest = sine_fit(out[skip:], hz, to_hz, hour * 44100 - 441 + skip)
    assert phase == pytest.approx(0.0, abs=1e-6)
    assert level_db(rest) < -80.0


@pytest.mark.parametrize(("from_hz", "to_hz"), PAIRS)
def test_it_looks_ahead_no_further_than_it_says(from_hz: float, to_hz: float) -> None:
    given_frames = int(0.1 * from_hz)
    out = PolyphaseResampler(from_hz, to_hz, 1).process(np.zeros((given_frames, 1), np.float32))
    assert given_frames / from_hz - len(out) / to_hz <= (ZERO_CROSSINGS + 2) / min(from_hz, to_hz)


def test_soxr_agrees_where_both_are_flat() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(8000) / 8000.0
    hertz, phases = rng.uniform(20.0, 2500.0, 40), rng.uniform(0.0, 6.0, 40)
    samples = sum(np.sin(2.0 * np.pi * hz * t + phase) for hz, phase in zip(hertz, phases, strict=True))
    block = np.asarray(samples, dtype=np.float32)[:, None]
    theirs = make_resampler(8000.0, 10000.0, 1, low_latency=False)
    assert theirs.name == "soxr"
    ours, sharp = converted(make_resampler(8000.0, 10000.0, 1), block, []), converted(theirs, block, [])
    assert len(ours) == len(sharp)
    error = (ours - sharp)[1000:-1000]
    assert np.sqrt(np.mean(np.square(error))) < 1e-4 * np.sqrt(np.mean(np.square(sharp)))


def test_rates_that_are_none_are_refused() -> None:
    for from_hz, to_hz in ((0.0, 8000.0), (8000.0, float("nan")), (float("inf"), 8000.0), (1e-3, 9e8)):
        with pytest.raises(UsageError):
            make_resampler(from_hz, to_hz, 1)
