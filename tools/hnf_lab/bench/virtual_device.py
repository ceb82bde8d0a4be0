"""A virtual serial device in its own process, as for a real device. A line on its standard input ends it.

It prints JSON lines: {"port": …} at the start and {"slipped": frames that its sample clock skipped} at the end.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hnf_core.actuators.virtual_port import VirtualPort


class PacedLine:
    """Pass bytes at the rate of a serial line, ten bits per byte; excess bytes wait. clock: time in s."""

    def __init__(self, baudrate: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._clock = baudrate / 10.0, clock
        self._waiting = b""
        self._allowed, self._last_time = 0.0, clock()

    def __call__(self, data: bytes) -> bytes:
        now = self._clock()
        self._waiting += data
        self._allowed = min(self._allowed + (now - self._last_time) * self._per_s, float(len(self._waiting)))
        self._last_time, count = now, int(self._allowed)
        self._allowed -= count
        passed, self._waiting = self._waiting[:count], self._waiting[count:]
        return passed


def main(baudrate: int, record: Path) -> None:
    """Run the device. record: .npy file of the played counts, (n, channels) int16, from the first sound to the last."""
    with VirtualPort() as port:
        port.from_host = PacedLine(baudrate)
        print(json.dumps({"port": port.path}), flush=True)
        sys.stdin.readline()
        np.save(record, port.recording.counts)
        print(json.dumps({"slipped": port.skipped_frames}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
