"""What tests of streams share: a signal, a source that fails, and what is left when a stream has ended."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.signal_chain import Samples

LIMITS = Limits(30.0, slew_per_s=2.0 * np.pi * 1000.0, sustained=0.3)
LONG_S = 20.0


def noise(seconds: float, rate: float = 10000.0, channels: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(5).normal(0.0, 5.0, (round(seconds * rate), channels)).astype(np.float32)


class Failing:
    """Noise that goes wrong after some blocks: action is called instead of the next."""

    def __init__(self, blocks: int, action: object) -> None:
        self.rate_hz, self.channels = 10000.0, 1
        self._left, self._action = blocks, action

    def read(self, frames: int) -> Samples:
        self._left -= 1
        if self._left < 0:
            self._action()  # type: ignore[operator]
        return np.full((frames, 1), 10.0, np.float32)


def comes(condition: Callable[[], bool]) -> bool:
    """Whether it becomes true; a minute is for a machine that is very busy."""
    until = time.monotonic() + 60.0
    while not condition() and time.monotonic() < until:
        time.sleep(0.002)
    return condition()


def at_rest() -> bool:
    """No thread of any stream is left, and the interpreter is as it was."""
    gone = comes(lambda: not any(thread.name.startswith("hnf-") for thread in threading.enumerate()))
    return gone and gc.get_freeze_count() == 0


def slope(counts: NDArray[np.int16]) -> int:
    """Largest change from frame to frame, from silence to silence."""
    return int(np.abs(np.diff(counts.astype(np.int64), axis=0, prepend=0, append=0)).max(initial=0))
