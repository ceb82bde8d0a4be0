"""Where strokes sound on the timeline: frames and seconds, and one track mixed from many strokes. Pure numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.units import frame_to_seconds

Samples = NDArray[np.float32]

MAX_DRIFT_S = 0.1
"""Sound further than this from the picture is moved to it: Blender may drop or delay frames, sound does not."""


@dataclass(frozen=True)
class FrameClock:
    """Frames per second of a scene: fps / fps_base."""

    fps: float
    fps_base: float = 1.0

    def seconds(self, frame: float, start: float) -> float:
        """From start to frame; frames may be fractions."""
        return frame_to_seconds(frame, start, self.fps, self.fps_base)


@dataclass(frozen=True)
class PlacedSignal:
    """A stroke's samples at rate [Hz], the first of them at frame start."""

    start: float
    samples: Samples
    rate: float

    def end(self, clock: FrameClock) -> float:
        """Frame at which the last sample has sounded."""
        return self.start + len(self.samples) / self.rate * clock.fps / clock.fps_base


def mix_strokes(strokes: Sequence[PlacedSignal], frame: float, last_frame: float, clock: FrameClock) -> Samples:
    """What sounds from frame to the end of last_frame: the sum of the strokes, (n,) at their common rate.

    A stroke that has begun before is joined midway; empty where nothing sounds any more. Raises ValueError for
    strokes of several rates.
    """
    if not strokes:
        return np.zeros(0, dtype=np.float32)
    rates = {each.rate for each in strokes}
    if len(rates) > 1:
        raise ValueError(f"strokes of several sample rates: {sorted(rates)}")
    rate = rates.pop()
    most = max(round(clock.seconds(last_frame + 1.0, frame) * rate), 0)
    begins = [round(clock.seconds(each.start, frame) * rate) for each in strokes]
    length = max(min(max(begin + len(each.samples) for begin, each in zip(begins, strokes, strict=True)), most), 0)
    out = np.zeros(length, dtype=np.float32)
    for begin, each in zip(begins, strokes, strict=True):
        low, high = max(begin, 0), min(begin + len(each.samples), length)
        if low < high:
            out[low:high] += each.samples[low - begin : high - begin]
    return out


def has_jumped(frame: float, expected_s: float, start_frame: float, clock: FrameClock) -> bool:
    """Is the timeline elsewhere than the sound? expected_s: how long the sound plays since frame begun_at."""
    return abs(clock.seconds(frame, start_frame) - expected_s) > MAX_DRIFT_S + clock.seconds(1.0, 0.0)
