"""Actuator profiles, and how a signal fits one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.actuators.output_prediction import compute_levels
from hnf_core.actuators.profile import GENERIC, PROFILES, ActuatorProfile, get_profile, make_user_profile
from hnf_core.errors import UsageError
from hnf_core.signal import Signal


def tone(frequency: float, peak: float, seconds: float = 1.0) -> Signal:
    time = np.arange(int(seconds * 10_000)) / 10_000.0
    return Signal((peak * np.sin(2.0 * np.pi * frequency * time)).astype(np.float32), 10_000.0, 0)


@given(st.floats(0.01, 300.0))
def test_headroom_is_the_ratio_of_peaks_in_decibels(peak: float) -> None:
    levels = compute_levels(tone(250.0, peak), GENERIC)
    assert levels.peak == pytest.approx(peak, rel=1e-6)
    assert levels.rms == pytest.approx(peak / math.sqrt(2.0), rel=1e-4)
    assert levels.headroom_db is not None
    assert GENERIC.peak_m_s2 is not None
    assert peak * 10.0 ** (levels.headroom_db / 20.0) == pytest.approx(GENERIC.peak_m_s2, rel=1e-6)


@pytest.mark.parametrize(("frequency", "below", "above"), [(10.0, 1.0, 0.0), (200.0, 0.0, 0.0), (2000.0, 0.0, 1.0)])
def test_energy_is_told_apart_by_the_range(frequency: float, below: float, above: float) -> None:
    levels = compute_levels(tone(frequency, 1.0), GENERIC)
    assert levels.below_share == pytest.approx(below, abs=1e-6)
    assert levels.above_share == pytest.approx(above, abs=1e-6)


def test_what_is_not_known_is_not_made_up() -> None:
    levels = compute_levels(tone(200.0, 1.0), ActuatorProfile("x", "X", "nowhere"))
    assert (levels.headroom_db, levels.below_share, levels.above_share) == (None, None, None)


def test_silence_has_all_the_room() -> None:
    for count in (0, 100):
        levels = compute_levels(Signal(np.zeros(count, dtype=np.float32), 10_000.0, 0), GENERIC)
        assert (levels.peak, levels.rms, levels.headroom_db) == (0.0, 0.0, math.inf)
        assert (levels.below_share, levels.above_share) == (0.0, 0.0)


def test_profiles_name_their_source_and_make_sense() -> None:
    assert GENERIC.name in PROFILES
    for name, profile in PROFILES.items():
        assert name == profile.name
        assert len(profile.source) > 10
        assert profile.range_hz is None or 0.0 < profile.range_hz[0] < profile.range_hz[1]
        assert profile.peak_m_s2 is None or profile.peak_m_s2 > 0.0
        # A largest acceleration means nothing without the range it holds in.
        assert profile.peak_m_s2 is None or profile.range_hz is not None
        assert get_profile(name) is profile


def test_a_duty_cycle_bounds_what_is_carried_for_ever() -> None:
    """EAI: 0.25 A RMS for a tenth of the time, of a sine of 0.5 A RMS, whose peak is full scale."""
    assert PROFILES["eai-c-mf"].sustained == pytest.approx(0.25 * math.sqrt(0.1) / (0.5 * math.sqrt(2.0)), rel=0.02)


@given(st.floats(0.0, 1e3), st.floats(0.1, 5e3), st.floats(0.1, 5e3))
def test_an_own_actuator_is_what_its_owner_says(peak: float, one_end: float, other_end: float) -> None:
    profile = make_user_profile(peak, one_end, other_end)
    assert profile == make_user_profile(peak, other_end, one_end)
    assert profile.range_hz == (min(one_end, other_end), max(one_end, other_end))
    assert profile.peak_m_s2 == (peak if peak > 0.0 else None)
    assert profile.name not in PROFILES


@pytest.mark.parametrize(
    "figures", [(-1.0, 20.0, 300.0), (1.0, 0.0, 300.0), (1.0, 20.0, -3.0), (math.nan, 20.0, 300.0)]
)
def test_an_impossible_actuator_is_refused(figures: tuple[float, float, float]) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        make_user_profile(*figures)


def test_an_unknown_actuator_is_refused_with_those_there_are() -> None:
    with pytest.raises(UsageError, match="generic-voice-coil"):
        get_profile("earthquake")
