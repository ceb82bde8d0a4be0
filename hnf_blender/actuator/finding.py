"""Looking for devices, in a process of its own: sound systems take their time, print what they like, and see a device
that was plugged in later only when they are started anew."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping

from hnf_core.errors import FileError

from ..translations import tr
from .process import LineProcess, list_worker_commands
from .state import ACTUATOR, Output
from .worker import LIST_DEVICES, WRONG_PYTHON

SCAN_TIMEOUT_S = 20.0
"""A driver that has not answered by then will not."""


class DeviceScanner:
    """One search at a time."""

    def __init__(self) -> None:
        self._process: LineProcess | None = None
        self._commands: list[list[str]] = []
        self._deadline = 0.0

    def start(self) -> None:
        """Begin to look; ACTUATOR has the outcome some ticks later. Raises DeviceError where no process can be
        started."""
        if self._process is not None:
            return
        self._commands = list(list_worker_commands(LIST_DEVICES, ()))
        self._process = LineProcess(self._commands.pop(0))
        self._deadline = time.monotonic() + SCAN_TIMEOUT_S
        ACTUATOR.is_scanning = True

    def tick(self) -> bool:
        """True where the search has ended."""
        process = self._process
        if process is None:
            return False
        code = process.exit_code()
        if code is None and time.monotonic() < self._deadline:
            return False
        if code == WRONG_PYTHON and self._commands:
            self._process = LineProcess(self._commands.pop(0))
            return False
        self.stop()
        said = [line for line in process.lines() if line.startswith("{")]
        try:
            store_scan_result(said[-1] if said else "")
        except FileError as error:
            why = process.last_line or str(error)
            ACTUATOR.scan_notes = (tr("Devices could not be looked for: {why}").format(why=why),)
        return True

    def stop(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None
        ACTUATOR.is_scanning = False


def store_scan_result(line: str) -> None:
    """ACTUATOR as the search says it is. Raises FileError where the line is none of worker.tell_devices()."""
    try:
        found = json.loads(line)
        outputs = tuple(Output(str(each["target"]), format_device_title(each)) for each in found["devices"])
        without, missing = ([str(each) for each in found[name]] for name in ("without", "missing"))
    except (ValueError, KeyError, TypeError) as error:
        raise FileError("the search for devices gave no answer.", remedy="Look again.") from error
    ACTUATOR.outputs, ACTUATOR.is_scanned = outputs, True
    ACTUATOR.missing_packages, ACTUATOR.scan_notes = frozenset(without), tuple(missing)


def format_device_title(device: Mapping[str, object]) -> str:
    """What a device calls itself, and the port or the facts by which it is told from one of the same name."""
    kind, _, port = str(device["target"]).partition(":")
    more = port if kind == "serial" else str(device["facts"])
    title = str(device["title"])
    return f"{title} ({more})" if more and more != title else title


DEVICE_SCANNER = DeviceScanner()
