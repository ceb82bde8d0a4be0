"""An actuator measured through a real sound server: its output looped back into its input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sound_server import sound_server, why_not

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.measure.accelerometer import Accelerometer, make_sweep, measure_actuator
from hnf_core.actuators.measure.frequency_response import estimate_response
from hnf_core.actuators.sinks.audio import OPEN_STREAMS, AudioSink
from hnf_core.errors import DeviceError, UsageError

ATTEMPTS = 4
CALM_S = 0.12
"""Owed at most: nobody waits for a sweep, and a busy machine is late."""
UNBROKEN = 0.9995
"""A wire's coherence is 1; where the server of a busy machine leaves out 1 ms of it, at most 0.998."""


@pytest.mark.skipif(why_not() != "", reason=why_not())
def test_a_wire_has_a_flat_response_and_its_delay(tmp_path: Path) -> None:
    limits, excitation = Limits(10.0), make_sweep(10_000.0, 3.0, 10.0, 1000.0, 4.0)
    with sound_server(tmp_path):
        for attempt in range(ATTEMPTS):
            try:
                # Full scale of the input is 20 m/s² where full scale of the output is 10: a gain of two.
                asked, got = measure_actuator(AudioSink(queue_s=CALM_S), Accelerometer(None, 20.0), excitation, limits)
            except (UsageError, DeviceError):  # the machine was late, and it said so
                if attempt == ATTEMPTS - 1:
                    raise
                continue
            found = estimate_response(asked.samples, got.samples, asked.sample_rate, 20.0, 900.0)
            if found.coherence.min() > UNBROKEN:
                break
    assert found.coherence.min() > UNBROKEN
    np.testing.assert_allclose(found.gain_db, 20.0 * np.log10(2.0), atol=0.1)
    assert 0.0 < found.delay_s < 2.0


@pytest.mark.skipif(why_not() != "", reason=why_not())
def test_an_output_that_is_not_there_leaves_the_input_closed(tmp_path: Path) -> None:
    sensor = Accelerometer(None, 20.0)
    with sound_server(tmp_path):
        with pytest.raises(DeviceError, match="nosuch"):
            measure_actuator(AudioSink("nosuch"), sensor, make_sweep(10_000.0, 1.0, 10.0, 1000.0, 4.0), Limits(10.0))
        assert not OPEN_STREAMS
        assert sensor.get_signal().sample_rate > 0.0, "PortAudio was not started anew below it"
        with pytest.raises(DeviceError, match=r"--input audio:DEVICE with one of these: .*pulse"):
            Accelerometer("nosuch", 20.0).__enter__()
