"""A Python outside Blender, named by the artist: whether it can train. It is asked; nothing is installed into it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from hnf_core.cli.train_needs import LEAST_PYTHON, PACKAGES

from ..state.outside_python import OutsidePython
from ..translations import tr
from .child import OWN_GROUP, end_group

TIMEOUT_S = 60.0
"""A first import of torch reads a gigabyte."""
MARK = "@hnf python "
ASK = f"""
import importlib, json, sys
found = {{}}
for name in sys.argv[1:]:
    try:
        found[name] = str(getattr(importlib.import_module(name), "__version__", "?"))
    except BaseException as error:
        found[name] = ""
print({MARK!r} + json.dumps({{"version": list(sys.version_info[:3]), "found": found}}))
"""


def look(path: str, timeout_s: float = TIMEOUT_S) -> OutsidePython:
    """Run it and ask. Waits for the answer, timeout_s at most; never raises."""
    if not Path(path).is_file():
        return _unfit(path, tr("There is no such file"))
    try:
        process = subprocess.Popen(
            [path, "-c", ASK, *PACKAGES],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=clean_environment(),
            **OWN_GROUP,
        )
    except (OSError, ValueError) as error:
        return _unfit(path, tr("It cannot be started ({why})").format(why=getattr(error, "strerror", None) or error))
    try:
        said, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        end_group(process.pid)
        process.communicate()
        return _unfit(path, tr("It gave no answer within {seconds} s").format(seconds=f"{timeout_s:g}"))
    return _understood(path, said.decode("utf-8", "replace"))


def clean_environment() -> Mapping[str, str]:
    """Without what Blender, or whoever started it, tells its own Python."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _understood(path: str, said: str) -> OutsidePython:
    line = next((each for each in said.splitlines() if each.startswith(MARK)), "")
    try:
        answer = json.loads(line.removeprefix(MARK))
        version = tuple(int(part) for part in answer["version"])
        versions = {name: str(answer["found"][name]) for name in PACKAGES}
    except (ValueError, KeyError, TypeError):
        return _unfit(path, tr("It is not a Python"))
    text = ".".join(map(str, version))
    found = tuple((name, known) for name, known in versions.items() if known)
    missing = tuple(name for name, known in versions.items() if not known)
    if version < LEAST_PYTHON:
        least = ".".join(map(str, LEAST_PYTHON))
        problem = tr("It is Python {version}, and {least} or newer is needed").format(version=text, least=least)
        return OutsidePython(path, text, found, missing, problem)
    if not missing:
        return OutsidePython(path, text, found, missing, "")
    return OutsidePython(
        path, text, found, missing, tr("It lacks {packages}").format(packages=", ".join(missing)),
        install_command(path, missing),
    )  # fmt: skip


def install_command(path: str, missing: tuple[str, ...]) -> str:
    """What a person types into a terminal; the add-on never does."""
    return " ".join([f'"{path}" -m pip install', *(f'"{PACKAGES[name]}"' for name in missing)])


def _unfit(path: str, problem: str) -> OutsidePython:
    return OutsidePython(path, "", (), (), problem)
