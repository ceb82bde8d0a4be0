"""How a stream is doing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

_BIN_MS = 0.01
_BINS = 10_000


class DurationHistogram:
    """A histogram of times in bins of 10 µs up to 100 ms: as large after a day as after a second."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)
        self.count = 0
        self.max_ms = 0.0

    def record(self, seconds: float) -> None:
        milliseconds = max(seconds * 1e3, 0.0)
        self._counts[min(int(milliseconds / _BIN_MS), _BINS)] += 1
        self.count += 1
        self.max_ms = max(self.max_ms, milliseconds)

    def percentile_ms(self, percent: float) -> float:
        """The upper edge of the bin that percent of all times lie in or below, never more than the longest; 0 where
        there are none. From 100 ms on it is the longest."""
        if self.count == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self._counts), self.count * percent / 100.0))
        return self.max_ms if place >= _BINS else min((place + 1) * _BIN_MS, self.max_ms)


@dataclass(frozen=True)
class StreamReport:
    """state: ready, playing, paused or ended. device: as it calls itself. blocks: made; frames: that the sink got.
    underruns: times that the device missed frames. errors: damaged or lost frames of the wire. compute_p99_ms: of a
    block, from its source to ready counts; compute_cpu_p99_ms: of that, what the thread computed. latency_p99_ms: from
    the moment a block was asked of the source until the sink had it; a resampler that is not prompt gives many blocks
    in one lump, whose last samples wait until the first are played. peak: largest level that left, as a share of full
    scale. limited_samples, nonfinite_samples: changed by the limiter. device_limited_samples: by the device's own
    limits, behind ours. played_s: by the device. level_m_s2: RMS of the last 20 ms or so.
    temperature_c: of the coil, where it is told. resampler: what converts the rate. realtime: the system
    granted both threads its real-time priority; never to a file. problem: why it ended, or "".
    """

    state: str = "ready"
    device: str = ""
    blocks: int = 0
    frames: int = 0
    underruns: int = 0
    errors: int = 0
    compute_p99_ms: float = 0.0
    compute_highest_ms: float = 0.0
    compute_cpu_p99_ms: float = 0.0
    latency_p99_ms: float = 0.0
    latency_highest_ms: float = 0.0
    peak: float = 0.0
    limited_samples: int = 0
    nonfinite_samples: int = 0
    device_limited_samples: int = 0
    played_s: float = 0.0
    level_m_s2: float = 0.0
    temperature_c: float | None = None
    resampler: str = ""
    realtime: bool = False
    problem: str = ""

    def to_json(self) -> dict[str, Any]:
        return asdict(self)
