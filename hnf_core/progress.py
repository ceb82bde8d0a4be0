"""One line on a terminal that says what is being done, how far it is, and how long it will take."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TextIO


@dataclass(frozen=True)
class Progress:
    """stage: what is being done now. done of total: steps finished. share: of the step being done, 0 … 1."""

    stage: str
    done: int
    total: int
    share: float = 0.0


class ProgressBar:
    """Draws Progress on a terminal, and nothing where the stream is none."""

    WIDTH = 24

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._active = self._stream.isatty()
        self._start = time.monotonic()

    def show(self, progress: Progress) -> None:
        if not self._active:
            return
        share = (progress.done + progress.share) / max(1, progress.total)
        filled = round(self.WIDTH * share)
        elapsed = time.monotonic() - self._start
        left = f", {elapsed / share - elapsed:.0f} s left" if 0 < share < 1 else ""
        line = f"[{'█' * filled}{'·' * (self.WIDTH - filled)}] {progress.done}/{progress.total} {progress.stage}{left}"
        self._stream.write(f"\r\x1b[K{line[:110]}")
        self._stream.flush()

    def close(self) -> None:
        if self._active:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
