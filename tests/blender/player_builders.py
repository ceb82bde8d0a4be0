"""A player's process as the window's timer drives it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from hnf_blender.actuator.actuator_state import ACTUATOR, SPEAKERS, ActuatorFacts
from hnf_blender.actuator.player_client import PlayerClient
from hnf_blender.actuator.sound import Sound
from hnf_core.actuators.profile import GENERIC

LIMIT_S = 40.0
RATE_HZ = 10_000.0


def tone(seconds: float = 0.5, level: float = 2.0, **settings) -> Sound:
    """A sine of 200 Hz, level m/s² high."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    samples = (level * np.sin(2.0 * np.pi * 200.0 * time_s)).astype(np.float32)
    return Sound(samples, RATE_HZ, GENERIC, **settings)


def until(link: PlayerClient, so: Callable[[], object]) -> bool:
    """Tick as the timer does until it is so."""
    found = until_for(link, LIMIT_S, so)
    if not found:
        print(f"{link.problem=}, {link.is_playing=}, {link.began=}, {link.last_status=}")
    return found


def until_for(link: PlayerClient, seconds: float, so: Callable[[], object]) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        link.tick()
        if so():
            return True
        time.sleep(0.005)
    return False


@contextmanager
def chosen(target: str) -> Iterator[None]:
    """With this output, as an artist without preferences would have it."""
    ACTUATOR.selected = target
    try:
        yield
    finally:
        ACTUATOR.selected, ACTUATOR.facts = SPEAKERS, ActuatorFacts()
        ACTUATOR.outputs, ACTUATOR.missing_packages, ACTUATOR.scan_notes, ACTUATOR.skin_lines = (), frozenset(), (), ()
