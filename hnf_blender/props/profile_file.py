"""An actuator's profile in a file beside the scene, such as `hnf actuators measure` writes."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from hnf_core.actuators.profile import ActuatorProfile
from hnf_core.errors import FileError, HnfError

from ..translations import tr

FILE = "file"
"""Of Scene.hnf.actuator: the profile is in Scene.hnf.actuator_file."""
LOOK_S = 2.0
"""Panels ask many times a second; the disk is asked this often whether the file has changed."""


def profile_in_file(path: str) -> ActuatorProfile:
    """Its name is the path: by that it is read again, with its response, where it is played. Where it cannot be read
    nothing is known of it, and source says why; playing on it is refused."""
    return _read(path, _changed(path, int(time.monotonic() / LOOK_S)))


@lru_cache(maxsize=4)
def _changed(path: str, _when: int) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=4)
def _read(path: str, _changed: int) -> ActuatorProfile:
    from hnf_core.actuators.profile_file import read_profile

    try:
        if not path.lower().endswith(".json"):
            raise FileError("no profile is chosen.", remedy="Choose the .json file that measuring your actuator gave.")
        return replace(read_profile(Path(path)), name=path, response=None)
    except HnfError as error:
        return ActuatorProfile(path, Path(path).name or tr("Measured actuator"), str(error))
