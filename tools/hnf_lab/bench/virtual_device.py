"""A virtual device in a program of its own, as a device is: a line on its standard input ends it.

Its own lines are JSON: {"port": …}, and at the end {"slipped": frames that its sample clock stood still}.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hnf_core.actuators.virtual.port import VirtualPort


class PacedLine:
    """Bytes as a line of baudrate carries them, ten bits each: those that come faster wait. clock: s."""

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
        through, self._waiting = self._waiting[:count], self._waiting[count:]
        return through


def main(baudrate: int, record: Path) -> None:
    """record: .npy, (n, channels) int16: what was played, from the first sound to the last."""
    with VirtualPort() as port:
        port.from_host = PacedLine(baudrate)
        print(json.dumps({"port": port.path}), flush=True)
        sys.stdin.readline()
        np.save(record, port.recording.counts)
        print(json.dumps({"slipped": port.skipped_frames}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
