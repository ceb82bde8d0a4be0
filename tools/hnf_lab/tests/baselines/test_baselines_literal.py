"""The literal HNF, which is silent under a smooth stroke (finding 1)."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.datasets.recording import Recording
from hnf_core.field.field import FieldConfig
from hnf_lab.baselines.interface import MaterialRecordings
from hnf_lab.baselines.published_hnf import PublishedHnf, select_seconds

RATE = 10_000
SMALL = FieldConfig.published(hidden=32)


def texture(seconds=5.0, seed=1):
    action = make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.3), force_n=(0.2, 3.0))
    speed = np.interp(np.arange(round(seconds * RATE)) / RATE, action.time, action.speed)
    noise = np.random.default_rng(seed).standard_normal(len(speed))
    return Recording(action, 10.0 * speed * np.convolve(noise, np.ones(8) / 8.0, "same"), RATE, "noise", "made up")


def test_literal_hnf_is_silent_under_a_smooth_stroke():
    """Trained on 4 s, judged on the same stroke: 30 dB below the texture between 20 and 1000 Hz."""
    recorded = texture(4.0)
    fitted = PublishedHnf(SMALL, epochs=15).fit(MaterialRecordings("noise", (recorded,)), 0)
    samples = fitted.render([recorded.action], 0)[0]
    assert len(samples) == len(recorded.samples)
    window = np.hanning(len(samples))
    band = slice(round(20.0 * 4.0), round(1000.0 * 4.0))
    powers = [np.sum(np.square(np.abs(np.fft.rfft(window * each)[band]))) for each in (samples, recorded.samples)]
    assert powers[0] < 1e-3 * powers[1]
    np.testing.assert_array_equal(samples, fitted.render([recorded.action], 99)[0])


def test_recordings_are_spread_over_all():
    recordings = [texture(2.0, seed) for seed in range(6)]
    assert [recording.samples[0] for recording in select_seconds(recordings, 6.0)] == [
        recordings[index].samples[0] for index in (0, 2, 5)
    ]
    assert select_seconds(recordings, 1e4) == recordings
    assert len(select_seconds(recordings, 0.1)) == 1
