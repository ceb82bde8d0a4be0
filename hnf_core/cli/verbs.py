"""The verbs of the command line, and what each is for: all that `hnf --help` needs to know of them.

What a verb loads and which options it takes stands in its own module, which is imported when the verb is asked for.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

COMMAND_MODULES = {
    "touch": "touch",
    "synth": "synth",
    "train": "train",
    "eval": "eval",
    "materials": "materials",
    "export": "export",
    "import": "import_file",
    "actuators": "actuators",
    "stream": "stream",
    "bench": "bench",
    "batch": "batch",
    "doctor": "doctor",
}
"""Verb → module of this package. Its add_parser(verbs) adds the verb; its run, where it has one, does it."""

HELP = {
    "touch": "bake a scene and write what each stroke feels like as WAV files",
    "synth": "write what one stroke on one material feels like as a WAV file",
    "train": "train a field on recordings of one material, or another of the networks",
    "eval": "measure fields and rivals by every metric, with the limits beside them",
    "materials": "list the library's materials",
    "export": "write a WAV in another format, and say what was lost",
    "import": "turn a haptic file of another program into a WAV in m/s²",
    "actuators": "list devices and profiles; measure an actuator",
    "stream": "play a WAV on an actuator",
    "bench": "measure time, memory and error, as a table",
    "batch": "run many of these commands on many workers; what is finished is not run again",
    "doctor": "say what is installed and at work, and what a missing part costs",
}

EXAMPLES = """examples:
  hnf touch scene.blend --plan                          what can be touched, and what it would take
  hnf touch scene.blend --out result                    a WAV and a picture for every stroke
  hnf synth --material oak-wood --stroke rub-slow --out rub.wav"""

COMMAND_HINTS = {"probe": "To ask about one place: hnf touch SCENE --out DIR --probe OBJECT:u,v"}
"""What people look for as a command of its own → what does it."""


def import_command(verb: str) -> ModuleType:
    """Where a verb's words stand."""
    return import_module(f".{COMMAND_MODULES[verb]}", __package__)
