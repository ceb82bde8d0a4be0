"""Where strokes are played: kept in the preferences, since ports belong to a machine, never in the .blend."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from ..state.settings import Settings, settings
from ..translations import tr
from .state import ACTUATOR, SPEAKERS, VIRTUAL, Output


def chosen_output(context: Any = None) -> str:
    """Target of the chosen output as `hnf stream --to` takes it; SPEAKERS for Blender's sound device."""
    kept = settings(context)
    return ACTUATOR.chosen if isinstance(kept, Settings) else str(kept.output)


def choose_output(target: str) -> None:
    """From now on strokes are played there."""
    import bpy

    kept = settings()
    if isinstance(kept, Settings):
        ACTUATOR.chosen = target
    elif kept.output != target:
        kept.output = target
        bpy.context.preferences.is_dirty = True


def plays_whole(target: str) -> bool:
    """Is it a sound output that can only be reached through Blender's own sound, since sounddevice is missing?"""
    return target.partition(":")[0] == "audio" and ("sounddevice" in ACTUATOR.without or not _is_installed())


@lru_cache(maxsize=1)
def _is_installed() -> bool:
    return find_spec("sounddevice") is not None


def always_there() -> tuple[Output, ...]:
    """The outputs that need not be looked for."""
    return (
        Output(SPEAKERS, tr("Speakers (Blender)")),
        Output(VIRTUAL, tr("Virtual actuator")),
        Output("audio", tr("Usual sound output, within limits")),
    )


def outputs(context: Any = None) -> tuple[Output, ...]:
    """All that can be chosen now; the chosen one too where it was not found."""
    chosen, listed = chosen_output(context), list(always_there())
    listed += [each for each in ACTUATOR.outputs if each.target not in {one.target for one in listed}]
    if chosen not in {each.target for each in listed}:
        listed.append(Output(chosen, chosen))
    return tuple(listed)


def title_of(target: str, context: Any = None) -> str:
    return next((each.title for each in outputs(context) if each.target == target), target)
