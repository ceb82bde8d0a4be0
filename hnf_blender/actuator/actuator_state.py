"""State of the actuator that the panel shows: outputs, the selected output, the player's phase and level.

Reading it computes nothing. The selected output is stored in the preferences, never in the .blend, since ports
belong to a machine; without preferences it is stored here.
"""

from __future__ import annotations

from enum import Enum
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, NamedTuple

from ..state.addon_settings import Settings, get_settings
from ..translations import tr

SPEAKERS = ""
"""Target of Blender's own sound device, which is no actuator."""
VIRTUAL = "virtual"


class Phase(Enum):
    """Phase of the child process that plays on an actuator.

    OFF: no process. OPENING: it starts, or opens the device. READY: no device is open. LIVE: it follows the pen.
    """

    OFF = "off"
    OPENING = "opening"
    READY = "ready"
    PLAYING = "playing"
    PAUSED = "paused"
    LIVE = "live"


class Output(NamedTuple):
    """A device to play on: its target text, as `hnf stream --to` takes it, and its title."""

    target: str
    title: str


class ActuatorFacts(NamedTuple):
    """State of the player for the panel.

    Attributes
    ----------
    phase : Phase
        Phase of the player.
    level_m_s2 : float
        Recent RMS level [m/s²].
    share : float
        Level as a fraction of the largest allowed, 0 to 1.
    lines : tuple of str
        Figures as text.
    problem : str
        Why nothing plays, one sentence; "" if there is no problem.
    """

    phase: Phase = Phase.OFF
    level_m_s2: float = 0.0
    share: float = 0.0
    lines: tuple[str, ...] = ()
    problem: str = ""


class ActuatorState:
    """Selected output, known devices and player facts.

    Attributes
    ----------
    selected : str
        Selected target, used only without preferences.
    outputs : tuple of Output
        Devices found by the last search.
    is_scanned, is_scanning : bool
        Whether a search has been made, and whether one is running.
    missing_packages : frozenset of str
        Python packages that are missing or cannot be loaded.
    scan_notes : tuple of str
        Sentences about them.
    facts : ActuatorFacts
        State of the player.
    skin_lines : tuple of str
        Predicted motion of the skin for the shown stroke, as text.
    """

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
    """Return the target of the selected output as `hnf stream --to` takes it; SPEAKERS for Blender's sound device."""
    settings = get_settings(context)
    return ACTUATOR.selected if isinstance(settings, Settings) else str(settings.output)


def select_output(target: str) -> None:
    """Select the output that strokes are played on from now on."""
    import bpy

    settings = get_settings()
    if isinstance(settings, Settings):
        ACTUATOR.selected = target
    elif settings.output != target:
        settings.output = target
        bpy.context.preferences.is_dirty = True


def needs_offline_player(target: str) -> bool:
    """Return whether `target` is a sound output that only Blender's sound reaches, since sounddevice is missing."""
    return target.partition(":")[0] == "audio" and (
        "sounddevice" in ACTUATOR.missing_packages or not _is_sounddevice_installed()
    )


def shares_blender_output(target: str) -> bool:
    """Return whether `target` is played where Blender's own sound is, so that both are heard together."""
    return target in (SPEAKERS, "audio") or needs_offline_player(target)


@lru_cache(maxsize=1)
def _is_sounddevice_installed() -> bool:
    return find_spec("sounddevice") is not None


def list_builtin_outputs() -> tuple[Output, ...]:
    """Return the outputs that exist without a search for devices."""
    return (
        Output(SPEAKERS, tr("Speakers (Blender)")),
        Output(VIRTUAL, tr("Virtual Actuator")),
        Output("audio", tr("Usual Output, Limited")),
    )


def list_outputs(context: Any = None) -> tuple[Output, ...]:
    """Return all selectable outputs, including the selected one if it was not found."""
    selected, outputs = get_selected_output(context), list(list_builtin_outputs())
    outputs += [output for output in ACTUATOR.outputs if output.target not in {builtin.target for builtin in outputs}]
    if selected not in {output.target for output in outputs}:
        outputs.append(Output(selected, selected))
    return tuple(outputs)


def find_output_title(target: str, context: Any = None) -> str:
    """Return the title of `target`, or `target` if it is unknown."""
    return next((output.title for output in list_outputs(context) if output.target == target), target)
