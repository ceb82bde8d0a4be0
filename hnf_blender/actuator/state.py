"""What the panel shows of the actuator, and what is chosen where Blender keeps no preferences. Reading it computes
nothing."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

SPEAKERS = ""
"""The output that is no actuator: Blender's own sound device."""
VIRTUAL = "virtual"


class Phase(Enum):
    """OFF: no player runs. OPENING: it starts, or takes the device. READY: it runs and holds no device. PLAYING.
    PAUSED. LIVE: it follows the pen."""

    OFF = "off"
    OPENING = "opening"
    READY = "ready"
    PLAYING = "playing"
    PAUSED = "paused"
    LIVE = "live"


class Output(NamedTuple):
    """A way to a device. target: as `hnf stream --to` takes it. title: what it calls itself."""

    target: str
    title: str


class ActuatorFacts(NamedTuple):
    """level_m_s2: RMS of the last moment. share: of it in what may leave at most, 0 to 1. lines: figures in words.
    problem: why nothing sounds, one sentence, "" = none."""

    phase: Phase = Phase.OFF
    level_m_s2: float = 0.0
    share: float = 0.0
    lines: tuple[str, ...] = ()
    problem: str = ""


class ActuatorState:
    """chosen: target where there are no preferences to keep it. outputs: devices as last looked for; looked: whether
    they were; seeking: they are looked for now. without: Python packages that are not there or cannot be loaded;
    missing: the same in sentences. skin: what a skin would get of the shown stroke on the virtual actuator, and
    on one that was measured, in words."""

    def __init__(self) -> None:
        self.selected = SPEAKERS
        self.outputs: tuple[Output, ...] = ()
        self.is_scanned = False
        self.is_scanning = False
        self.missing_packages: frozenset[str] = frozenset()
        self.scan_notes: tuple[str, ...] = ()
        self.facts = ActuatorFacts()
        self.skin_lines: tuple[str, ...] = ()


ACTUATOR = ActuatorState()
