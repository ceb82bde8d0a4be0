"""Profiles from data-sheet figures: the model is recovered, and unstated values stay unknown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.measure.build_profile import DATASHEET_USABLE_DB, make_datasheet_profile
from hnf_core.actuators.measure.frequency_response import fit_resonance
from hnf_core.actuators.output_prediction import simulate_output
from hnf_core.actuators.profile import read_profile
from hnf_core.cli.main import main
from hnf_core.errors import UsageError
from hnf_core.signal import Signal

RATE = 10_000


@settings(max_examples=40, deadline=None)
@given(st.floats(40.0, 400.0), st.floats(0.7, 60.0), st.floats(0.5, 60.0))
def test_resonance_sharpness_and_strength_come_back(resonance_hz: float, quality: float, peak: float) -> None:
    profile = make_datasheet_profile("LRA", "sheet", resonance_hz=resonance_hz, quality=quality, peak_m_s2=peak)
    assert profile.response is not None
    model = fit_resonance(profile.response)
    assert model.resonance_hz == pytest.approx(resonance_hz, rel=1e-3)
    assert 0.5 / model.damping == pytest.approx(quality, rel=5e-3)
    # Full scale on the wire gives the sheet's figure at the resonance, whatever full scale itself is called.
    at_resonance = profile.limits.full_scale_m_s2 * 10.0 ** (float(profile.response.gain_db_at(resonance_hz)) / 20.0)
    assert at_resonance == pytest.approx(peak, rel=5e-3)
    low, high = profile.range_hz or (0.0, 0.0)
    assert low <= resonance_hz <= high
    level = profile.response.gain_db
    inside = (profile.response.frequency_hz >= low) & (profile.response.frequency_hz <= high)
    assert level[inside].min() >= level.max() - DATASHEET_USABLE_DB


def test_compensation_restores_the_level_of_a_sine() -> None:
    profile = make_datasheet_profile("LRA", "sheet", resonance_hz=175.0, quality=8.0, peak_m_s2=14.0)
    time = np.arange(2 * RATE) / RATE
    for hz in (150.0, 175.0, 220.0):
        signal = Signal((0.3 * np.sin(2.0 * np.pi * hz * time)).astype(np.float32), float(RATE), 0)
        corrected, plain = (simulate_output(signal, profile, compensate=each).signal for each in (True, False))
        assert corrected.rms == pytest.approx(signal.rms, rel=0.05)
        assert abs(20.0 * np.log10(plain.rms / signal.rms)) > 1.0


def test_a_stated_range_is_used_and_unstated_values_stay_unknown() -> None:
    profile = make_datasheet_profile(
        "LRA", "sheet", resonance_hz=175.0, quality=12.0, peak_m_s2=None, range_hz=(150.0, 200.0)
    )
    assert profile.range_hz == (150.0, 200.0)
    assert (profile.peak_m_s2, profile.sustained, profile.thermal_s) == (None, None, None)
    assert profile.assumes_full_scale


@pytest.mark.parametrize(
    "figures",
    [(5.0, 10.0, None), (175.0, 0.0, None), (175.0, 1e9, None), (2000.0, 5.0, None), (175.0, 5.0, (2e3, 3e3))],
)
def test_what_is_no_such_actuator_is_refused(figures: tuple[float, float, tuple[float, float] | None]) -> None:
    resonance, quality, within = figures
    with pytest.raises(UsageError):
        make_datasheet_profile("x", "y", resonance_hz=resonance, quality=quality, peak_m_s2=1.0, range_hz=within)


def test_from_the_command_line_to_a_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "lra.json"
    words = ["actuators", "describe", "--title", "Coin", "--source", "Maker, sheet 1", "--resonance", "175"]
    assert main([*words, "--bandwidth", "17.5", "--peak-g", "1.4", "--out", str(out)], lambda _: 0) == 0
    assert "with its response corrected" in capsys.readouterr().out
    profile = read_profile(out)
    assert (profile.title, profile.source) == ("Coin", "Maker, sheet 1")
    assert profile.response is not None
    assert 0.5 / fit_resonance(profile.response).damping == pytest.approx(10.0, rel=0.01)
    assert main([*words, "--q", "1000", "--out", str(out), "--json"], lambda _: 0) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["full_scale_assumed"] is True
    assert record["rms_error_before_db"] is None, "its range holds no third of an octave"


@pytest.mark.parametrize(
    "words",
    [
        ("--q", "0"),
        ("--q", "5", "--sustained", "2"),
        ("--q", "5", "--range", "300", "100"),
        ("--bandwidth", "-3"),
        ("--q", "5", "--peak", "nan"),
    ],
)
def test_figures_that_cannot_be_are_told(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["actuators", "describe", "--title", "T", "--source", "S", "--resonance", "175"]
    assert main([*common, *words, "--out", str(tmp_path / "x.json")], lambda _: 0) == 2
    assert "--" in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()
