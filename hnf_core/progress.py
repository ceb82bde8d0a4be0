"""Progress of a long run, the terminal progress bar that shows the time left, and counts of the work done.

Long functions take a `ProgressCallback` and call it between steps, when no threads of theirs are running. A callback
may raise `Cancelled` to stop the work; any other exception would be taken for a fault of the current step.

Work is counted by `add_work` where it is done, for all who have opened `count_work`. Unlike times, counts are the same
on every machine, so that tests can limit them.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Literal, TextIO, get_args


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


WorkKind = Literal[
    "states", "samples", "sensor_images", "nearest_pairs", "splats", "reconstructions", "threads", "hashed_files",
    "meshes", "collections", "scenes", "caster_triangles", "images", "passes",
    "patch_files", "tap_spans", "mesh_reliefs", "objects",
    "close_ups", "renders", "rays", "network_calls", "tokens", "diffusion_calls",
]  # fmt: skip
"""Kinds of work that are counted. The last six are those of a report of `hnf touch`.

- states: states at which the layers of F_Θ are evaluated, offline or live.
- samples: samples whose carriers are rendered; the item is the first one.
- sensor_images: images of a touch sensor rendered from heights.
- nearest_pairs: pairs of a point and a triangle whose distance is computed.
- splats: splats whose color is evaluated for a view.
- reconstructions: splats from which a surface is reconstructed.
- threads: threads that are requested for a part of the work.
- hashed_files: files read to be hashed, such as the inputs of a batch job, the images of a shader or the signals of an
  earlier run; the item is the path.
- meshes: evaluated meshes read from Blender; the item is the object's name.
- collections: collections of Blender searched for rendered objects; the item is the name.
- scenes: temporary scenes made in Blender.
- caster_triangles: triangles given to a ray caster.
- images: images rendered by Blender for close-ups and views; the item is the width in pixels.
- passes: passes that a close-up is rendered with; the item is the name.
- patch_files: files of baked patches and predictions opened; the item is the path.
- tap_spans: spans around fast changes of force, in which the whole contact is integrated; the item is the first state.
- mesh_reliefs: views of a close-up's depth that are examined for the relief of a mesh.
- objects: objects looked at to list the strokes or surfaces of a scene; the item is the scene's name.
- close_ups: patches rendered.
- renders: renders of any kind.
- rays: rays and nearest-point queries.
- network_calls: strokes synthesized by F_Θ.
- tokens: tokens encoded.
- diffusion_calls: patches whose relief is predicted by D_φ.
"""


@dataclass(frozen=True, eq=False)
class WorkCount:
    """Work done while a `count_work` context lasts; the lists grow as it is done.

    Attributes
    ----------
    amounts : dict of list of int
        Amount of each portion of work, in order, by kind.
    items : dict of list of str or int
        Name or number of the thing that each of these portions was done on; "" where there is none.
    """

    amounts: dict[WorkKind, list[int]] = field(default_factory=lambda: {kind: [] for kind in get_args(WorkKind)})
    items: dict[WorkKind, list[str | int]] = field(default_factory=lambda: {kind: [] for kind in get_args(WorkKind)})

    def total(self, kind: WorkKind) -> int:
        """Return the amount of all work of a kind. Raises KeyError if there is no such kind."""
        return sum(self.amounts[kind])


_counts: tuple[WorkCount, ...] = ()
_counts_lock = threading.Lock()


@contextmanager
def count_work() -> Iterator[WorkCount]:
    """Count the work that this process does while the context lasts, in all its threads.

    Contexts may be nested; each counts all of the work.

    Examples
    --------
    >>> with count_work() as work:
    ...     add_work("rays", 100)
    >>> work.total("rays")
    100
    """
    global _counts
    work = WorkCount()
    with _counts_lock:
        _counts = (*_counts, work)
    try:
        yield work
    finally:
        with _counts_lock:
            _counts = tuple(count for count in _counts if count is not work)


def add_work(kind: WorkKind, amount: int = 1, item: str | int = "") -> None:
    """Add a portion of work to all open counts.

    Parameters
    ----------
    kind : WorkKind
        Kind of work.
    amount : int, default 1
        Number of things done.
    item : str or int, default ""
        Name or number of the thing that it was done on.
    """
    if _counts:  # Mostly nobody counts, and a live state has no time for a lock.
        with _counts_lock:
            for count in _counts:
                count.amounts[kind].append(amount)
                count.items[kind].append(item)
