"""What the panel shows of the actuator, and what is chosen where Blender keeps no preferences. Reading it computes
nothing.

Where strokes are played: kept in the preferences, since ports belong to a machine, never in the .blend.
"""

from __future__ import annotations

from enum import Enum
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, NamedTuple

from ..state.addon_settings import Settings, get_settings
from ..translations import tr

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


def get_selected_output(context: Any = None) -> str:
    """Target of the chosen output as `hnf stream --to` takes it; SPEAKERS for Blender's sound device."""
    kept = get_settings(context)
    return ACTUATOR.selected if isinstance(kept, Settings) else str(kept.output)


def select_output(target: str) -> None:
    """From now on strokes are played there."""
    import bpy

    kept = get_settings()
    if isinstance(kept, Settings):
        ACTUATOR.selected = target
    elif kept.output != target:
        kept.output = target
        bpy.context.preferences.is_dirty = True


def needs_offline_player(target: str) -> bool:
    """Is it a sound output that can only be reached through Blender's own sound, since sounddevice is missing?"""
    return target.partition(":")[0] == "audio" and (
        "sounddevice" in ACTUATOR.missing_packages or not _is_sounddevice_installed()
    )


@lru_cache(maxsize=1)
def _is_sounddevice_installed() -> bool:
    return find_spec("sounddevice") is not None


def list_builtin_outputs() -> tuple[Output, ...]:
    """The outputs that need not be looked for."""
    return (
        Output(SPEAKERS, tr("Speakers (Blender)")),
        Output(VIRTUAL, tr("Virtual actuator")),
        Output("audio", tr("Usual sound output, within limits")),
    )


def list_outputs(context: Any = None) -> tuple[Output, ...]:
    """All that can be chosen now; the chosen one too where it was not found."""
    chosen, listed = get_selected_output(context), list(list_builtin_outputs())
    listed += [each for each in ACTUATOR.outputs if each.target not in {one.target for one in listed}]
    if chosen not in {each.target for each in listed}:
        listed.append(Output(chosen, chosen))
    return tuple(listed)


def find_output_title(target: str, context: Any = None) -> str:
    return next((each.title for each in list_outputs(context) if each.target == target), target)
