"""The limiter's law, one value at a time in plain Python: what limiter.py must equal, byte for byte."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from hnf_core.actuators.limits import FULL_SCALE_COUNTS, THERMAL_KNEE, LimiterParams, Limits, compute_limiter_params


@dataclass
class ChannelReference:
    """One channel's limiter. process() and soft_stop() take and give one frame. square: the mean square's bound from
    above, counts²."""

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
        """m/s² → counts."""
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
        """Counts of one frame of the fade to 0."""
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
            share = (self.grid_position + 1) / self.params.grid_frames
            level = level * (self.previous_gain + (self.gain - self.previous_gain) * share)
        aim = round(min(max(level + tail, -self.cap), self.cap))
        self.last = min(max(aim, self.last - self.params.max_step), self.last + self.params.max_step)
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
        room = (self.params.max_mean_square - self.params.grid_decay * self.mean_square) / self.params.pole_weight
        owed = self._compute_ramp_down_energy(abs(self.last))
        lowest, highest = 0, self.params.peak
        while lowest < highest:
            middle = (lowest + highest + 1) // 2
            if max(self._compute_ramp_down_energy(middle), owed) + self.params.grid_frames * float(middle) ** 2 <= room:
                lowest = middle
            else:
                highest = middle - 1
        return lowest

    def _compute_ramp_down_energy(self, level: int) -> float:
        return float(level) * float(level) * float(level) / (3.0 * self.params.max_step)


def limit(limits: Limits, rate_hz: float, frames: Sequence[Sequence[float]], channels: int) -> list[list[int]]:
    """frames of m/s², each of channels values → as many frames of counts, of a limiter that starts with them."""
    law = compute_limiter_params(limits, rate_hz)
    lanes = [ChannelReference(law) for _ in range(channels)]
    return [[lane.process(float(value)) for lane, value in zip(lanes, frame, strict=True)] for frame in frames]
