"""What a skin would get, where the actuator was measured."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from player_builders import RATE_HZ, tone

from hnf_blender.actuator.skin import Skin, felt
from hnf_blender.props.profile_file import profile_in_file
from hnf_core.actuators.profile import GENERIC
from hnf_core.actuators.profile_file import read_profile, write_profile
from hnf_core.actuators.response import Response
from hnf_core.signal import Signal

LIMIT_S = 20.0


def test_a_skin_gets_what_a_measured_response_is_made_up_for(tmp_path) -> None:
    """As the player does; the panel's own profile of the file knows no response."""
    frequency = np.geomspace(20.0, 1000.0, 50)
    gain = 1.0 / (1.0 + 1j * frequency / 100.0)
    lossy = Response(frequency, 20.0 * np.log10(np.abs(gain)), np.angle(gain), np.ones(50))
    write_profile(tmp_path / "mine.json", replace(GENERIC, name="mine", response=lossy))
    sound = tone(0.4, level=1.0)
    signal = Signal(sound.samples, RATE_HZ, seed=0)
    skin, shown = Skin(), profile_in_file(str(tmp_path / "mine.json"))
    assert shown.response is None
    until = time.monotonic() + LIMIT_S
    while not skin.look("once", signal, shown) and time.monotonic() < until:
        time.sleep(0.01)
    assert skin.shown == felt(signal, read_profile(tmp_path / "mine.json"))
    assert skin.shown.rms > 1.2 * felt(signal, GENERIC).rms
    (tmp_path / "mine.json").unlink()
    assert skin.look("gone", signal, shown)  # what was shown is not true any more
    time.sleep(0.3)
    assert (skin.look("gone", signal, shown), skin.shown) == (False, None)
