"""A Python outside Blender, named by the artist: whether it can train. It is asked; nothing is installed into it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from hnf_core.cli.health import MIN_TRAINING_PYTHON, TRAINING_PACKAGES

from ..state.outside_python import ExternalPython
from ..translations import tr
from .child import PROCESS_GROUP_OPTIONS, kill_process_group

CHECK_TIMEOUT_S = 60.0
"""A first import of torch reads a gigabyte."""
CHECK_PREFIX = "@hnf python "
CHECK_SCRIPT = f"""
import importlib, json, sys
found = {{}}
for name in sys.argv[1:]:
    try:
        found[name] = str(getattr(importlib.import_module(name), "__version__", "?"))
    except BaseException as error:
        found[name] = ""
print({CHECK_PREFIX!r} + json.dumps({{"version": list(sys.version_info[:3]), "found": found}}))
"""


def check_python(path: str, timeout_s: float = CHECK_TIMEOUT_S) -> ExternalPython:
    """Run it and ask. Waits for the answer, timeout_s at most; never raises."""
    if not Path(path).is_file():
        return _make_unusable(path, tr("There is no such file"))
    try:
        process = subprocess.Popen(
            [path, "-c", CHECK_SCRIPT, *TRAINING_PACKAGES],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=make_clean_environment(),
            **PROCESS_GROUP_OPTIONS,
        )
    except (OSError, ValueError) as error:
        return _make_unusable(
            path, tr("It cannot be started ({why})").format(why=getattr(error, "strerror", None) or error)
        )
    try:
        said, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        kill_process_group(process.pid)
        process.communicate()
        return _make_unusable(path, tr("It gave no answer within {seconds} s").format(seconds=f"{timeout_s:g}"))
    return _parse_output(path, said.decode("utf-8", "replace"))


def make_clean_environment() -> Mapping[str, str]:
    """Without what Blender, or whoever started it, tells its own Python."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _parse_output(path: str, output: str) -> ExternalPython:
    line = next((each for each in output.splitlines() if each.startswith(CHECK_PREFIX)), "")
    try:
        answer = json.loads(line.removeprefix(CHECK_PREFIX))
        version = tuple(int(part) for part in answer["version"])
        versions = {name: str(answer["found"][name]) for name in TRAINING_PACKAGES}
    except (ValueError, KeyError, TypeError):
        return _make_unusable(path, tr("It is not a Python"))
    text = ".".join(map(str, version))
    found = tuple((name, known) for name, known in versions.items() if known)
    missing = tuple(name for name, known in versions.items() if not known)
    if version < MIN_TRAINING_PYTHON:
        least = ".".join(map(str, MIN_TRAINING_PYTHON))
        problem = tr("It is Python {version}, and {least} or newer is needed").format(version=text, least=least)
        return ExternalPython(path, text, found, missing, problem)
    if not missing:
        return ExternalPython(path, text, found, missing, "")
    return ExternalPython(
        path, text, found, missing, tr("It lacks {packages}").format(packages=", ".join(missing)),
        format_install_command(path, missing),
    )  # fmt: skip


def format_install_command(path: str, missing: tuple[str, ...]) -> str:
    """What a person types into a terminal; the add-on never does."""
    return " ".join([f'"{path}" -m pip install', *(f'"{TRAINING_PACKAGES[name]}"' for name in missing)])


def _make_unusable(path: str, problem: str) -> ExternalPython:
    return ExternalPython(path, "", (), (), problem)
