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

PROFILE_FROM_FILE = "file"
"""Of Scene.hnf.actuator: the profile is in Scene.hnf.actuator_file."""
CHECK_INTERVAL_S = 2.0
"""Timers ask many times a second; the disk is asked this often whether the file has changed."""

_profiles: dict[str, ActuatorProfile] = {}
"""By path."""


def read_file_profile(path: str) -> ActuatorProfile:
    """Its name is the path: by that it is read again, with its response, where it is played. Where it cannot be read
    nothing is known of it, and source says why; playing on it is refused."""
    _profiles[path] = _read_profile(path, _read_mtime(path, int(time.monotonic() / CHECK_INTERVAL_S)))
    return _profiles[path]


def get_cached_profile(path: str) -> ActuatorProfile:
    """For panels, which ask no disk: as profile_in_file() found it last. A timer asks for what windows show."""
    return _profiles.get(path) or ActuatorProfile(path, _make_title(path), tr("Not read yet"))


@lru_cache(maxsize=4)
def _read_mtime(path: str, _when: int) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=4)
def _read_profile(path: str, _mtime: int) -> ActuatorProfile:
    from hnf_core.actuators.profile_file import read_profile

    try:
        if not path.lower().endswith(".json"):
            raise FileError("no profile is chosen.", remedy="Choose the .json file that measuring your actuator gave.")
        return replace(read_profile(Path(path)), name=path, response=None)
    except HnfError as error:
        return ActuatorProfile(path, _make_title(path), str(error))


def _make_title(path: str) -> str:
    return Path(path).name or tr("Measured actuator")
