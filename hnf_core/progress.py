"""Progress of a long run: the callback that receives it, and the terminal progress bar that shows the time left.

Long functions take a `ProgressCallback` and call it between steps, when no threads of theirs are running. A callback
may raise `Cancelled` to stop the work; any other exception would be taken for a fault of the current step.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO


@dataclass(frozen=True)
class Progress:
    """State of a long run: its stage, finished steps, and the fraction of the current step.

    Attributes
    ----------
    stage : str
        Name of the current stage, for people.
    done, total : int
        Finished steps, and all steps.
    share : float
        Finished fraction of the current step, 0 to 1.
    """

    stage: str
    done: int
    total: int
    share: float = 0.0

    @property
    def fraction(self) -> float:
        """Finished fraction of the whole run, 0 to 1."""
        return (self.done + self.share) / max(1, self.total)


class Cancelled(BaseException):  # as asyncio.CancelledError: it is no error
    """Raised by a progress callback to stop the work that called it.

    It is no `Exception`, since a run of many steps continues after any exception of a single step.
    """


ProgressCallback = Callable[[Progress], None]
"""Function that is called with the state of a run before each of its steps."""


def ignore_progress(progress: Progress) -> None:
    """Do nothing: the default progress callback."""


def nest_progress(
    progress: ProgressCallback, stage: str, done: int, total: int, share: float = 1.0
) -> ProgressCallback:
    """Return a callback for a sub-task, which forwards its progress as part of one step of the whole run.

    Parameters
    ----------
    progress : ProgressCallback
        Callback of the whole run.
    stage : str
        Name of the stage, in place of the sub-task's own stages.
    done, total : int
        Finished steps of the whole run, and all its steps.
    share : float, default 1.0
        Fraction of the step that the sub-task takes.

    Returns
    -------
    ProgressCallback

    Examples
    --------
    >>> nest_progress(print, "Stroke 1: close-ups", 0, 2, 0.5)(Progress("patches", 3, 4))
    Progress(stage='Stroke 1: close-ups', done=0, total=2, share=0.375)
    """
    return lambda inner: progress(Progress(stage, done, total, share * inner.fraction))


class ProgressBar:
    """Progress bar on a terminal; shows nothing if the stream is no terminal."""

    WIDTH = 24

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._active = self._stream.isatty()
        self._start = time.monotonic()

    def show(self, progress: Progress) -> None:
        """Draw the state of a run over the last one drawn."""
        if not self._active:
            return
        fraction = progress.fraction
        filled = round(self.WIDTH * fraction)
        elapsed = time.monotonic() - self._start
        eta = f", {elapsed / fraction - elapsed:.0f} s left" if 0 < fraction < 1 else ""
        line = f"[{'█' * filled}{'·' * (self.WIDTH - filled)}] {progress.done}/{progress.total} {progress.stage}{eta}"
        self._write(f"\r\x1b[K{line[:110]}")

    def close(self) -> None:
        """Erase the line of the progress bar."""
        if self._active:
            self._write("\r\x1b[K")

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the terminal may be closed, which must not stop the run
            self._stream.write(text)
            self._stream.flush()
