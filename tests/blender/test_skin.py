"""Estimated output at the skin for a measured actuator."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from player_builders import RATE_HZ, tone

from hnf_blender.actuator.skin_preview import (
    OutputEstimate,
    SkinPreview,
    describe_estimate,
    estimate_output,
    estimate_skin,
)
from hnf_blender.props.scene_settings import read_file_profile
from hnf_core.actuators.measure.frequency_response import FrequencyResponse
from hnf_core.actuators.profile import GENERIC, read_profile, write_profile
from hnf_core.signal import Signal

LIMIT_S = 20.0


def test_a_skin_gets_what_a_measured_response_is_made_up_for(tmp_path) -> None:
    """As the player does; the panel's own profile of the file knows no response."""
    frequency = np.geomspace(20.0, 1000.0, 50)
    gain = 1.0 / (1.0 + 1j * frequency / 100.0)
    lossy = FrequencyResponse(frequency, 20.0 * np.log10(np.abs(gain)), np.angle(gain), np.ones(50))
    write_profile(tmp_path / "mine.json", replace(GENERIC, name="mine", response=lossy))
    sound = tone(0.4, level=1.0)
    signal = Signal(sound.samples, RATE_HZ, seed=0)
    skin, shown = SkinPreview(), read_file_profile(str(tmp_path / "mine.json"))
    assert shown.response is None
    until = time.monotonic() + LIMIT_S
    while not skin.update("once", signal, shown) and time.monotonic() < until:
        time.sleep(0.01)
    assert skin.estimate is not None
    assert skin.estimate.skin == estimate_skin(signal, read_profile(tmp_path / "mine.json"))
    assert skin.estimate.skin.rms > 1.2 * estimate_skin(signal, GENERIC).rms
    (tmp_path / "mine.json").unlink()
    assert skin.update("gone", signal, shown)  # what was shown is not true any more
    time.sleep(0.3)
    assert (skin.update("gone", signal, shown), skin.estimate) == (False, None)


def measured(level_db: float):
    """An actuator that loses level_db everywhere above 100 Hz, and gives too much of the rest."""
    frequency = np.geomspace(20.0, 1000.0, 60)
    level = np.where(frequency > 100.0, level_db, -level_db)
    return replace(GENERIC, name="mine", response=FrequencyResponse(frequency, level, np.zeros(60), np.ones(60)))


def noise(seconds: float = 2.0) -> Signal:
    samples = np.random.default_rng(2).normal(0.0, 0.5, round(seconds * RATE_HZ)).astype(np.float32)
    return Signal(samples, RATE_HZ, seed=2)


def test_band_errors_are_reported_with_and_without_compensation() -> None:
    shown = estimate_output(noise(), measured(-8.0), virtual=False)
    assert shown.skin is None
    assert shown.uncompensated is not None
    assert shown.compensated is not None
    assert 7.0 < shown.uncompensated.rms_db <= shown.uncompensated.max_db < 9.5
    assert shown.compensated.rms_db < 0.25 * shown.uncompensated.rms_db
    (line,) = describe_estimate(shown)
    assert f"off by {shown.compensated.rms_db:.1f} dB" in line


def test_where_nothing_was_measured_nothing_is_told_of_bands() -> None:
    assert estimate_output(noise(0.1), GENERIC, virtual=False) == OutputEstimate()
    assert describe_estimate(OutputEstimate()) == describe_estimate(None) == ()


def test_a_silent_stroke_has_no_bands() -> None:
    silent = Signal(np.zeros(2000, dtype=np.float32), RATE_HZ, seed=0)
    assert estimate_output(silent, measured(-8.0), virtual=False) == OutputEstimate()
