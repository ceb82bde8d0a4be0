"""Libraries that only some ways to a device need: asked for when they are, missed in words of the next step."""

from __future__ import annotations

import importlib
from typing import Any

from ..errors import DeviceError

PIP_PACKAGES = {"serial": "pyserial", "sounddevice": "sounddevice", "pythonosc.udp_client": "python-osc"}


def import_optional(module: str) -> Any:
    """The module, imported. Raises DeviceError where it, or a system library below it, is not there."""
    package = PIP_PACKAGES[module]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise DeviceError(
            f"the Python package '{package}' is not installed.",
            remedy=f"Install it: pip install {package} (all of them: pip install 'hnf[device]').",
        ) from error
    except OSError as error:  # sounddevice without PortAudio
        raise DeviceError(
            f"'{package}' cannot be loaded: {error}.",
            remedy="Install the PortAudio library; on Debian and Ubuntu: apt install libportaudio2.",
        ) from error
