"""How a stream is doing, on a terminal: one line, redrawn; elsewhere a plain line now and then."""

from __future__ import annotations

import math
import shutil
import sys
import time
from typing import TextIO

from ..actuators.report import StreamReport

METER_MIN_DB = -60.0
PLAIN_LINE_INTERVAL_S = 5.0
METER_WIDTH = 12


class LevelMeter:
    """full_m_s2: where the meter ends. whole_s: how long it plays, None = until it is stopped."""

    def __init__(self, full_m_s2: float, duration_s: float | None, stream: TextIO | None = None) -> None:
        self._full, self._duration_s = full_m_s2, duration_s
        self._stream = stream or sys.stderr
        self._redraws = self._stream.isatty()
        self._next_s = time.monotonic() + PLAIN_LINE_INTERVAL_S

    def show(self, report: StreamReport) -> None:
        line = format_meter(report, self._full, self._duration_s)
        if self._redraws:
            columns = shutil.get_terminal_size().columns  # a line that wraps cannot be redrawn
            self._stream.write(f"\r\x1b[K{line[: columns - 1]}")
            self._stream.flush()
        elif time.monotonic() >= self._next_s:
            self._next_s += PLAIN_LINE_INTERVAL_S
            print(line, file=self._stream, flush=True)

    def close(self) -> None:
        if self._redraws:
            self._stream.write("\r\x1b[K")
            self._stream.flush()


def format_meter(report: StreamReport, full_m_s2: float, duration_s: float | None) -> str:
    """Time, RMS level in dB below full_m_s2 as a bar and a figure, underruns, samples that were limited."""
    of = f" of {duration_s:.1f}" if duration_s is not None else ""
    level_db = 20.0 * math.log10(report.level_m_s2 / full_m_s2) if report.level_m_s2 > 0.0 else -math.inf
    share = min(max(1.0 - level_db / METER_MIN_DB, 0.0), 1.0)
    filled = round(METER_WIDTH * share)
    level = f"{level_db:4.0f} dB" if level_db >= METER_MIN_DB else " silent"
    bar = f"{'█' * filled}{'·' * (METER_WIDTH - filled)}"
    counts = f"underruns {report.underruns}  limited {report.limited_samples}"
    return f"{report.played_s:6.1f}{of} s  {bar} {level} {report.level_m_s2:6.2f} m/s²  {counts}"
