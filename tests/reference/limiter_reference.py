"""Reference limiter in plain Python, one value at a time; hnf_core.actuators.limiter must equal it byte for byte."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from hnf_core.actuators.limits import FULL_SCALE_COUNTS, THERMAL_KNEE, LimiterParams, Limits, compute_limiter_params


@dataclass
class ChannelReference:
    """Limiter of one channel; process() and soft_stop() return one frame each.

    mean_square is an upper bound of the mean square [counts²].
    """

    params: LimiterParams
    mean_square: float = 0.0
    last: int = 0
    limited: int = 0
    nonfinite: int = 0
    playing: bool = True
    fade_in_frames: int = 0
    fade_out_start: float = 0.0
    fade_out_frames_left: int = 0
    grid_position: int = 0
    grid_energy: int = 0
    gain: float = field(init=False)
    previous_gain: float = field(init=False)
    cap: int = field(init=False)

    def __post_init__(self) -> None:
        self.gain = self.previous_gain = self._compute_gain()
        self.cap = self._compute_level_cap()

    def process(self, value: float) -> int:
        """Limit one value [m/s²]; returns counts."""
        self.playing = True
        if not math.isfinite(value):
            self.nonfinite += 1
            value = 0.0
        level = min(max(value / self.params.full_scale_m_s2, -2.0), 2.0) * FULL_SCALE_COUNTS
        if self.fade_in_frames < len(self.params.ramp) - 1:
            self.fade_in_frames += 1
            level *= float(self.params.ramp[self.fade_in_frames])
        return self._limit(level)

    def soft_stop(self) -> int:
        """Return one frame of the fade to 0 [counts]."""
        if self.playing:
            self.playing = False
            self.fade_in_frames = 0
            self.fade_out_start = float(self.last)
            self.fade_out_frames_left = len(self.params.ramp) - 1
        return self._limit(0.0)

    def _limit(self, level: float) -> int:
        tail = 0.0
        if self.fade_out_frames_left > 0:
            self.fade_out_frames_left -= 1
            tail = self.fade_out_start * float(self.params.ramp[self.fade_out_frames_left])
        wanted = round(level + tail)
        if math.isfinite(self.params.max_mean_square):
            fraction = (self.grid_position + 1) / self.params.grid_frames
            level = level * (self.previous_gain + (self.gain - self.previous_gain) * fraction)
        target = round(min(max(level + tail, -self.cap), self.cap))
        self.last = min(max(target, self.last - self.params.max_step), self.last + self.params.max_step)
        self.limited += self.last != wanted
        if math.isfinite(self.params.max_mean_square):
            self._update_heat()
        return self.last

    def _update_heat(self) -> None:
        self.grid_energy += self.last * self.last
        self.grid_position += 1
        if self.grid_position == self.params.grid_frames:
            self.mean_square = self.params.grid_decay * self.mean_square + self.params.pole_weight * self.grid_energy
            self.grid_energy = self.grid_position = 0
            self.previous_gain, self.gain = self.gain, self._compute_gain()
            self.cap = self._compute_level_cap()

    def _compute_gain(self) -> float:
        return min(max((1.0 - self.mean_square / self.params.max_mean_square) / (1.0 - THERMAL_KNEE), 0.0), 1.0)

    def _compute_level_cap(self) -> int:
        if not math.isfinite(self.params.max_mean_square):
            return self.params.peak
        budget = (self.params.max_mean_square - self.params.grid_decay * self.mean_square) / self.params.pole_weight
        ramp_energy = self._compute_ramp_down_energy(abs(self.last))
        lowest, highest = 0, self.params.peak
        while lowest < highest:
            middle = (lowest + highest + 1) // 2
            if (
                max(self._compute_ramp_down_energy(middle), ramp_energy) + self.params.grid_frames * float(middle) ** 2
                <= budget
            ):
                lowest = middle
            else:
                highest = middle - 1
        return lowest

    def _compute_ramp_down_energy(self, level: int) -> float:
        return float(level) * float(level) * float(level) / (3.0 * self.params.max_step)


def limit(limits: Limits, rate_hz: float, frames: Sequence[Sequence[float]], channels: int) -> list[list[int]]:
    """Limit frames of m/s², each of `channels` values, from rest; returns as many frames of counts."""
    params = compute_limiter_params(limits, rate_hz)
    references = [ChannelReference(params) for _ in range(channels)]
    return [
        [reference.process(float(value)) for reference, value in zip(references, frame, strict=True)]
        for frame in frames
    ]
