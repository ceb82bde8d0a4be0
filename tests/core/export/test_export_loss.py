"""Bands add up, and the report tells what was lost, no more and no less."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from export_signals import OPTIONS, signal_of, texture, tone
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.export.ahap import MIN_DURATION_WITH_CLICKS_S
from hnf_core.export.convert import export_signal
from hnf_core.export.envelope import compute_envelope
from hnf_core.export.fidelity import SILENT_OUTPUT, compute_signal_stats, format_loss_table, measure_loss
from hnf_core.export.formats import FORMATS
from hnf_core.metrics.spectra import OCTAVE_CENTRES_HZ, OCTAVE_EDGES_HZ, band_power, compare_bands

SAMPLES = hnp.arrays(np.float64, st.integers(1, 800), elements=st.floats(-30.0, 30.0))


def test_there_are_nine_octaves() -> None:
    assert len(OCTAVE_CENTRES_HZ) == 9
    assert OCTAVE_CENTRES_HZ[-1] == 1000.0
    np.testing.assert_allclose(np.divide(OCTAVE_EDGES_HZ[1:], OCTAVE_EDGES_HZ[:-1]), 2.0)


@settings(deadline=None)
@given(samples=SAMPLES, rate=st.floats(100.0, 50_000.0))
def test_all_bands_together_hold_the_mean_square(samples: np.ndarray, rate: float) -> None:
    power = band_power(samples, rate, (0.0, *OCTAVE_EDGES_HZ, math.inf))
    assert power.sum() == pytest.approx(np.mean(np.square(samples)), rel=1e-9, abs=1e-20)


@pytest.mark.parametrize("centre", OCTAVE_CENTRES_HZ[2:])
def test_a_tone_lies_in_its_own_band(centre: float) -> None:
    samples = tone(centre, 4.0, 2.0).samples * np.hanning(20_000)
    power = band_power(samples, 10_000.0)
    assert power[OCTAVE_CENTRES_HZ.index(centre)] == pytest.approx(8.0 * 3.0 / 8.0, rel=1e-3)
    assert power.sum() == pytest.approx(np.mean(np.square(samples)), rel=1e-6)


@settings(deadline=None)
@given(samples=SAMPLES, factor=st.floats(0.1, 10.0))
def test_bands_change_by_the_square_of_the_scale(samples: np.ndarray, factor: float) -> None:
    for band in compare_bands(samples, 8000.0, factor * samples, 8000.0):
        if band.before > 1e-20:
            assert band.change_db == pytest.approx(20.0 * math.log10(factor), abs=1e-6)


def test_the_same_process_at_another_rate_has_the_same_bands() -> None:
    for band in compare_bands(tone(200.0, 3.0, 1.0, 8000.0).samples, 8000.0, tone(200.0, 3.0).samples, 10_000.0):
        if band.low_hz < 200.0 < band.high_hz:
            assert band.change_db == pytest.approx(0.0, abs=0.05)


def test_a_band_that_is_gone_has_no_change_in_db() -> None:
    (band,) = (b for b in compare_bands(tone().samples, 1e4, np.zeros(50), 1e4) if b.low_hz < 160.0 < b.high_hz)
    assert (band.after, band.change_db) == (0.0, None)
    assert not band_power([], 1e4).any()


@settings(deadline=None)
@given(samples=SAMPLES)
def test_no_loss_is_no_loss(samples: np.ndarray) -> None:
    signal = signal_of(samples)
    loss = measure_loss(signal, signal)
    assert loss.before == loss.after
    assert {band.change_db for band in loss.bands} <= {0.0, None}
    json.dumps(loss.to_json(), allow_nan=False)
    assert "-0.0" not in format_loss_table(loss)


def test_a_sine_has_the_crest_of_a_sine() -> None:
    facts = compute_signal_stats(tone(100.0, 5.0))
    assert facts.crest_db == pytest.approx(20.0 * math.log10(math.sqrt(2.0)), abs=0.01)
    assert facts.range_db == pytest.approx(0.0, abs=0.01)
    assert (facts.rms, facts.peak) == (pytest.approx(5.0 / math.sqrt(2.0), rel=1e-3), pytest.approx(5.0, rel=1e-3))


def test_dynamics_are_the_spread_of_levels() -> None:
    loud = tone(100.0, 8.0).samples
    signal = signal_of(np.concatenate([loud, 0.1 * loud]))
    assert compute_signal_stats(signal).range_db == pytest.approx(20.0, abs=0.1)


def test_silence_and_nothing_at_all_have_a_report() -> None:
    for samples in (np.zeros(100), np.zeros(0)):
        shown = format_loss_table(measure_loss(signal_of(samples), signal_of(np.zeros(50)), ("All of it.",)))
        assert "silent" in shown
        assert shown.endswith("- All of it.")


def test_the_table_leaves_out_bands_that_say_nothing() -> None:
    fading = tone(160.0, 5.0, 1.0).samples * np.hanning(10_000)
    quiet = format_loss_table(measure_loss(signal_of(fading), signal_of(0.5 * fading)))
    assert "88–177 Hz" in quiet
    assert "-6.0 dB" in quiet
    assert "354–707 Hz" not in quiet
    assert "above 1414 Hz" in format_loss_table(
        measure_loss(texture(), signal_of(np.random.default_rng(0).normal(size=900)))
    )


def test_only_equal_samples_at_an_equal_rate_are_exact() -> None:
    signal = texture()
    nearly = signal.samples.copy()
    nearly[7] = np.nextafter(nearly[7], np.float32(9.0))
    assert measure_loss(signal, signal_of(signal.samples.copy())).exact
    assert not measure_loss(signal, signal_of(nearly)).exact
    assert not measure_loss(signal, signal_of(signal.samples, 9999.0)).exact
    assert not measure_loss(signal, signal_of(signal.samples[:-1])).exact


@pytest.mark.parametrize("word", ["haptic", "ahap", "wav8k"])
@settings(deadline=None, max_examples=30)
@given(samples=hnp.arrays(np.float32, st.integers(1, 60), elements=st.floats(-20.0, 20.0, width=32)))
@example(samples=np.array([0.5, -0.5], np.float32))
@example(samples=np.full(1, 1e-6, np.float32))
def test_what_is_lost_whole_is_said_and_nothing_else_is(
    word: str, samples: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"whole{FORMATS[word].suffix}"
    loss = export_signal(signal_of(samples), FORMATS[word], path, OPTIONS).loss
    assert (SILENT_OUTPUT in loss.dropped) == (loss.before.rms > 0.0 and loss.after.rms == 0.0)
    assert (f"- {SILENT_OUTPUT}" in format_loss_table(loss)) == (SILENT_OUTPUT in loss.dropped)


@pytest.mark.parametrize("count", [10, 20, 40, 41, 80])
def test_a_click_too_short_for_a_pause_stays_in_the_pattern(tmp_path: Path, count: int) -> None:
    """A transient pauses the continuous event, and in a few milliseconds there is no place for that."""
    samples = np.zeros(count)
    samples[count // 2] = 10.0
    whole = compute_envelope(signal_of(samples), OPTIONS.range_hz, separate_clicks=False)
    loss = export_signal(signal_of(samples), FORMATS["ahap"], tmp_path / "x.ahap", OPTIONS).loss
    assert loss.after.peak > 0.5 * whole.amplitude.max() > 0.0
    assert (loss.after.peak > 5.0) == (count / 10_000.0 > MIN_DURATION_WITH_CLICKS_S)
