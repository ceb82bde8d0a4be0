"""A sound card reached through Blender's own sound: what a stream would send, made beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from player_builders import RATE_HZ, tone

from hnf_blender.preview.sound_device import limit_offline, process_for_output
from hnf_core.actuators.limits import FULL_SCALE_COUNTS, Limits
from hnf_core.actuators.measure.frequency_response import FrequencyResponse, Resonator
from hnf_core.actuators.measure.inverse_filter import make_compensation
from hnf_core.actuators.profile import GENERIC
from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sink import SinkFormat
from hnf_core.actuators.sources import BufferSource

bounds = st.builds(
    Limits,
    full_scale_m_s2=st.floats(1.0, 50.0),
    peak=st.floats(0.1, 1.0),
    slew_per_s=st.floats(1e3, 1e5),
    sustained=st.floats(0.1, 1.0),
    thermal_s=st.floats(0.5, 10.0),
)


@settings(max_examples=40, deadline=None)
@given(
    limits=bounds,
    level=st.floats(0.0, 200.0),
    to_hz=st.sampled_from([8000.0, 10_000.0, 44_100.0]),
    loop=st.booleans(),
    seed=st.integers(0, 2**16),
)
def test_played_whole_it_keeps_the_limits(limits, level, to_hz, loop, seed) -> None:
    samples = (level * np.random.default_rng(seed).standard_normal(4000)).astype(np.float32)
    samples[7] = np.nan
    out = limit_offline(samples, RATE_HZ, to_hz, limits, loop=loop).astype(np.float64)
    assert len(out) >= int(0.4 * to_hz)
    assert out.shape[1] == 1
    assert np.abs(out).max(initial=0.0) <= limits.peak + 1e-7
    assert out[-1, 0] == 0.0
    assert np.abs(np.diff(out[:, 0], prepend=0.0)).max() <= limits.slew_per_s / to_hz + 1.0 / 32767
    if loop:  # over and over, the coil warms to the mean square of one turn
        assert np.mean(np.square(out)) <= limits.sustained**2 * (1.0 + 1e-6)


@pytest.mark.parametrize("to_hz", [RATE_HZ, 44_100.0])
def test_played_whole_it_is_what_a_stream_sends(to_hz) -> None:
    profile, frequency = replace(GENERIC, range_hz=(40.0, 400.0)), np.geomspace(20.0, 1000.0, 60)
    gain = Resonator(150.0, 0.1, 1.0).evaluate(frequency)
    measured = FrequencyResponse(frequency, 20.0 * np.log10(np.abs(gain)), np.unwrap(np.angle(gain)), np.ones(60))
    profile = replace(profile, response=measured)
    sound = tone(0.4, level=6.0)
    sent = render_counts(
        BufferSource(sound.samples[:, None], RATE_HZ), SinkFormat(to_hz, 1, 441, "a sound card"), profile.limits,
        make_compensation(profile, RATE_HZ, 1), low_latency=False,
    )  # fmt: skip
    played = process_for_output(sound.samples, RATE_HZ, to_hz, profile)
    assert np.abs(played).max() > 0.05
    assert np.abs(np.rint(played * FULL_SCALE_COUNTS) - sent).max() <= 1.0
    plain = limit_offline(sound.samples, RATE_HZ, to_hz, profile.limits)
    assert abs(np.std(played) / np.std(plain) - 1.0) > 0.05
