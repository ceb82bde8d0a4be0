"""Progress of a long run, and the terminal line that shows the current stage, the fraction done and the time left."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TextIO


@dataclass(frozen=True)
class Progress:
    """State of a run.

    Attributes
    ----------
    stage : str
        Name of the current stage.
    done, total : int
        Finished steps, and all steps.
    share : float
        Finished fraction of the current step, 0 to 1.
    """

    stage: str
    done: int
    total: int
    share: float = 0.0


class ProgressBar:
    """A progress bar on a terminal; shows nothing if the stream is no terminal."""

    WIDTH = 24

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._active = self._stream.isatty()
        self._start = time.monotonic()

    def show(self, progress: Progress) -> None:
        """Draw a state over the last one."""
        if not self._active:
            return
        fraction = (progress.done + progress.share) / max(1, progress.total)
        filled = round(self.WIDTH * fraction)
        elapsed = time.monotonic() - self._start
        eta = f", {elapsed / fraction - elapsed:.0f} s left" if 0 < fraction < 1 else ""
        line = f"[{'█' * filled}{'·' * (self.WIDTH - filled)}] {progress.done}/{progress.total} {progress.stage}{eta}"
        self._stream.write(f"\r\x1b[K{line[:110]}")
        self._stream.flush()

    def close(self) -> None:
        """Erase the line."""
        if self._active:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
