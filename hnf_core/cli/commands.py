"""Table of the commands with their help, and helpers that several commands share.

`hnf --help` needs only this module; options and imports of a command are in its own module, which is imported when the
command is used. Shared are the parsing of --seed, the prefix for commands shown to people, and the checks of `hnf
train`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from ..errors import SEED_LIMIT, HnfError, UsageError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

COMMAND_MODULES = {
    "touch": "touch",
    "views": "render_views",
    "synth": "synth",
    "train": "train",
    "materials": "materials",
    "describe": "describe",
    "export": "export",
    "import": "import_file",
    "actuators": "actuators",
    "stream": "stream",
    "study": "study",
    "batch": "batch",
    "doctor": "doctor",
}
"""Command → module of this package, which has `add_parser(verbs)` and usually `run`."""

HELP = {
    "touch": "bake a scene and write what each stroke feels like as WAV files",
    "views": "render a scene's cameras to files: color, depth, normals, ids, transforms.json",
    "synth": "write what one stroke on one material feels like as a WAV file",
    "train": "train a field on recordings of one material, or another of the networks",
    "materials": "list the library's materials",
    "describe": "decode a picture of a real GelSight or DIGIT: height, token, nearest materials",
    "export": "write a WAV in another format, and say what was lost",
    "import": "turn a haptic file of another program into a WAV in m/s²",
    "actuators": "list devices and profiles; measure an actuator",
    "stream": "play a WAV on an actuator",
    "study": "compare vibrations by people who do not know which is which, and evaluate it",
    "batch": "run many of these commands on many workers; what is finished is not run again",
    "doctor": "say what is installed and at work, and what a missing part costs",
}

LABORATORY_HELP = {
    "eval": "measure fields and rivals by every metric, with the limits beside them",
    "bench": "measure time, memory and error, as a table",
}
"""Help of the laboratory's commands (tools/hnf_lab), which are registered in `COMMAND_GROUP`."""
LABORATORY_SUBJECTS = {
    "encoder": "the network that turns views of a touch sensor into tokens",
    "alignment": "one space for looks and the touch of two sensors",
}
"""Subjects that `hnf train` has only in a checkout, registered in `SUBJECT_GROUP`."""
COMMAND_GROUP, SUBJECT_GROUP = "hnf.commands", "hnf.train_subjects"
"""Entry-point groups: a command's module with `add_parser` and `run`, and the `add_parser` of a subject of `hnf train`.
"""

EXAMPLES = """examples:
  hnf touch scene.blend --plan                          what can be touched, and what it would take
  hnf touch scene.blend --out result                    a WAV and a picture for every stroke
  hnf synth --material oak-wood --stroke rub-slow --out rub.wav"""

COMMAND_HINTS = {"probe": "To ask about one place: hnf touch SCENE --out DIR --at OBJECT:u,v"}
"""Word that people may try as a command → hint on what to use instead."""


def import_command(verb: str) -> ModuleType:
    """Import the module of a command of this package, or of one that another package has registered."""
    if verb in COMMAND_MODULES:
        return import_module(f".{COMMAND_MODULES[verb]}", __package__)
    module: ModuleType = find_plugins(COMMAND_GROUP)[verb].load()
    return module


def find_plugins(group: str) -> dict[str, EntryPoint]:
    """Return the Python entry points that installed packages register in a group, by name."""
    from importlib.metadata import entry_points  # takes some 50 ms, so it is imported only here

    return {point.name: point for point in entry_points(group=group)}


def make_laboratory_error(words: str) -> UsageError:
    """Return the error for a command (its words) that exists only in a checkout of the source code."""
    return UsageError(
        f"hnf {words} belongs to the laboratory, which comes with a source checkout alone.",
        remedy=f"In a checkout: make env-test, then .venv/bin/hnf {words}",
    )


def parse_seed(text: str) -> int:
    """Parse --seed for argparse. Raises UsageError unless it is a whole number from 0 to SEED_LIMIT − 1."""
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) < SEED_LIMIT):
        raise UsageError(f"--seed {text[:40]}: not a whole number from 0 to 2^63 − 1.", remedy="Give e.g. 0.")
    return int(text)


def get_command_prefix(argv: Sequence[str] | None = None) -> list[str]:
    """Return the words before a command: hnf as it was called, or Blender with its options.

    `argv` defaults to sys.argv.
    """
    first = (sys.argv if argv is None else argv)[0]
    name = Path(first).name.lower()
    if name.startswith("blender"):
        return [first, "-b", "--command", "hnf"]
    return [first] if name in {"hnf", "hnf.exe"} else ["hnf"]


@contextmanager
def require_torch(what: str) -> Iterator[None]:
    """Turn a failed import in this context into an HnfError that says `what` needs torch."""
    try:
        yield
    except ImportError as error:
        raise HnfError(
            f"{what} needs torch ({error}).",
            remedy="In a checkout: make env-test; elsewhere: pip install torch scipy pillow.",
        ) from error


def check_weights_name(out: Path) -> None:
    """Check --out of trained weights. Raises UsageError unless it ends in .safetensors."""
    if out.suffix != ".safetensors":
        raise UsageError(f"--out {out.name}: weights are .safetensors files.", remedy="Name it so.")
