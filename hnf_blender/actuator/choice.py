"""Where strokes are played: kept in the preferences, since ports belong to a machine, never in the .blend."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from ..state.settings import Settings, get_settings
from ..translations import tr
from .state import ACTUATOR, SPEAKERS, VIRTUAL, Output


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
