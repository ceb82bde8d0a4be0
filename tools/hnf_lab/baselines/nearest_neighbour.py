"""Baseline: playback of grains of the recording with the nearest action.

Every 50 ms one of the k grains nearest in (direction, log speed, log force) is drawn and cross-faded with equal power.
Levels are equalised before and restored after by a power law of speed and force fitted to the recording, so that a
grain played faster than it was recorded is louder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import FileError

from .interface import FittedMaterial, Form, MaterialRecordings, Segments, cut_segments

Float = NDArray[np.float64]

RATE_HZ = 10_000.0
GRAIN_SAMPLES = 1000
"""Samples of a grain (0.1 s): a smooth hand is nearly steady, and the fade widens a spectral line by 10 Hz."""
GRAIN_STEP_SAMPLES = 200
"""Samples between candidate grains."""
COMPARED_AT = (0.15, 0.5, 0.85)
"""Relative positions within a grain at which actions are compared."""
NEIGHBOUR_COUNT = 60
"""Number of candidate grains k.

On three HaTT textures with 120 s, 12 repeat one steady second (1.3 dB from the exact spectrum) and 60 reach 0.8 dB; 150
reach 0.65 dB but are too far off on a stroke that changes.
"""
FORCE_WEIGHT, DIRECTION_WEIGHT = 0.5, 1.0
"""Weight of log force and of direction (chord) relative to log speed: RMS ∝ v^0.94 and F^0.28 (HaTT)."""
MIN_SPEED_M_S = 1e-3
CONTACT_FORCE_N = 1e-3
SPEED_EXPONENT, FORCE_EXPONENT = (0.0, 2.0), (-0.5, 1.0)
"""Range of exponents in the 100 textures of HaTT; a fit outside comes from too little variation."""


@dataclass(frozen=True)
class LevelModel:
    """RMS = exp(offset) · v^speed · F^force, with forces below least_n replaced by it."""

    offset: float
    speed: float
    force: float
    least_n: float

    def evaluate(self, action: Action, count: int) -> Float:
        """Return the (count,) RMS at samples of RATE_HZ; 0 without contact, and falling to 0 with the speed."""
        time_s = np.arange(count) / RATE_HZ
        v = np.interp(time_s, action.time, np.where(action.contact, action.speed, 0.0))
        force = np.interp(time_s, action.time, action.force)
        contact_gain = np.clip(force / CONTACT_FORCE_N, 0.0, 1.0)
        speed_gain = np.clip(v / MIN_SPEED_M_S, 0.0, 1.0)
        level = np.maximum(v, MIN_SPEED_M_S) ** self.speed * np.maximum(force, self.least_n) ** self.force
        return np.asarray(np.exp(self.offset) * level * speed_gain * contact_gain)


@dataclass(frozen=True)
class NearestNeighbour:
    """Nearest-neighbour playback."""

    name: str = "playback (nearest neighbor)"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Cut the recordings into grains. Raises FileError if none is in contact and moving."""
        del seed
        return build_grains(specimen.recordings)


@dataclass(frozen=True)
class GrainSynthesiser:
    """Recordings cut into grains.

    Attributes
    ----------
    samples
        All recordings concatenated, with equalised levels.
    start
        (G,) first sample of each grain.
    features
        (G, D) weighted features.
    """

    samples: Float
    start: NDArray[np.intp]
    features: Float
    level: LevelModel
    direction_weight: float

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Cross-fade grains; each action has its own random stream of the seed."""
        return [
            self._render_action(action, np.random.default_rng([seed, index])) for index, action in enumerate(actions)
        ]

    def _render_action(self, action: Action, rng: np.random.Generator) -> Float:
        count, hop = round(action.duration_s * RATE_HZ), GRAIN_SAMPLES // 2
        starts = np.arange(-hop, count, hop)
        target_features = compute_features(action, starts, self.direction_weight)
        window = np.sin(np.pi * (np.arange(GRAIN_SAMPLES) + 0.5) / GRAIN_SAMPLES)
        mixed = np.zeros(count + 2 * GRAIN_SAMPLES)
        previous = -(10**9)
        for first, target in zip(starts, target_features, strict=True):
            chosen = self._choose(target, previous, rng)
            mixed[first + hop : first + hop + GRAIN_SAMPLES] += window * self.samples[chosen : chosen + GRAIN_SAMPLES]
            previous = chosen
        return mixed[hop : hop + count] * self.level.evaluate(action, count)

    def _choose(self, want: Float, before: int, rng: np.random.Generator) -> int:
        """Draw a near grain that shares no samples with the previous one, as those would add in amplitude."""
        distance = np.sum(np.square(self.features - want), axis=1)
        distance[np.abs(self.start - before) < 2 * GRAIN_SAMPLES] += 1e6
        nearest = np.argpartition(distance, min(NEIGHBOUR_COUNT, len(distance) - 1))[:NEIGHBOUR_COUNT]
        return int(self.start[rng.choice(nearest)])


def build_grains(recordings: Sequence[Recording]) -> GrainSynthesiser:
    """Cut all recordings into grains. Raises FileError if there are none, or the rate is not 10 kHz."""
    segments = cut_segments(recordings, 0)
    if segments.rate != RATE_HZ:
        raise FileError(f"it has {segments.rate:g} Hz.", where=recordings[0].source, remedy="Resample it to 10 kHz.")
    level = fit_level(segments)
    weight = DIRECTION_WEIGHT if all("direction" in recording.known for recording in recordings) else 0.0
    samples, starts, features, offset = [], [], [], 0
    for recording in recordings:
        level_at_samples = level.evaluate(recording.action, len(recording.samples))
        is_sounding = level_at_samples > 0.0
        samples.append(
            np.divide(recording.samples, level_at_samples, out=np.zeros_like(level_at_samples), where=is_sounding)
        )
        start = np.arange(0, len(level_at_samples) - GRAIN_SAMPLES + 1, GRAIN_STEP_SAMPLES)
        valid_count = np.concatenate([[0], np.cumsum(is_sounding & (level_at_samples > 1e-3 * level_at_samples.max()))])
        start = start[valid_count[start + GRAIN_SAMPLES] - valid_count[start] == GRAIN_SAMPLES]
        starts.append(start + offset)
        features.append(compute_features(recording.action, start, weight))
        offset += len(level_at_samples)
    start = np.concatenate(starts)
    if len(start) == 0:
        raise FileError(
            "no tenth of a second of it is in contact and moving.",
            where=recordings[0].source,
            remedy="Record longer strokes.",
        )
    return GrainSynthesiser(np.concatenate(samples), start, np.concatenate(features), level, weight)


def compute_features(action: Action, start: NDArray[np.intp], direction_weight: float) -> Float:
    """Return (len(start), 12) features of grains that begin at these samples of RATE_HZ."""
    time_s = (start[:, None] + np.array(COMPARED_AT) * GRAIN_SAMPLES) / RATE_HZ
    speed = np.interp(time_s, action.time, action.speed)
    force = np.interp(time_s, action.time, action.force)
    direction = np.stack([np.interp(time_s, action.time, action.direction[:, axis]) for axis in range(2)], axis=-1)
    columns = [
        np.log(np.maximum(speed, MIN_SPEED_M_S)),
        FORCE_WEIGHT * np.log(np.maximum(force, 0.02)),
        direction_weight * direction[..., 0],
        direction_weight * direction[..., 1],
    ]
    return np.concatenate(columns, axis=1)


def fit_level(segments: Segments) -> LevelModel:
    """Fit log RMS over log speed and log force by least squares, with exponents limited to the range of HaTT."""
    v, f = np.log(segments.speed), np.log(segments.force)
    level = 0.5 * np.log(np.mean(np.square(segments.body), axis=1) + 1e-12)
    columns = np.stack([np.ones_like(v), v - v.mean(), f - f.mean()], axis=1)
    # A ridge with the weight of one segment, since a recording at one speed does not determine the exponent.
    _, a, b = np.linalg.solve(columns.T @ columns + np.diag([0.0, 1.0, 1.0]), columns.T @ level)
    a, b = float(np.clip(a, *SPEED_EXPONENT)), float(np.clip(b, *FORCE_EXPONENT))
    return LevelModel(float(np.mean(level - a * v - b * f)), a, b, float(segments.force.min()))
