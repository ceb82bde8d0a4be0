"""Nearest-neighbour playback: the recording itself, in grains taken where the hand did the same.

Each tenth of a second the k grains nearest in (direction, log speed, log force) are found, one of them is drawn, and it
is faded in and out with equal power. Levels are evened before and restored after by a power law of speed and force that
the recording itself shows, so that a grain played a little faster than it was recorded is a little louder.
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
"""Samples (0.1 s): a smooth hand is nearly steady, and the fade widens a spectral line by 10 Hz."""
GRAIN_STEP_SAMPLES = 200
"""Samples between the grains to choose from."""
COMPARED_AT = (0.15, 0.5, 0.85)
"""Places within a grain at which actions are compared."""
NEIGHBOUR_COUNT = 60
"""On three HaTT textures with 120 s: 12 play one steady second over and over (1.3 dB from the exact spectrum), 60 come
to 0.8 dB; 150 to 0.65 dB, but stand too far off on a stroke that changes."""
FORCE_WEIGHT, DIRECTION_WEIGHT = 0.5, 1.0
"""Of a factor e in force, and of a chord of 1, beside a factor e in speed: RMS ∝ v^0.94 and F^0.28 (HaTT)."""
MIN_SPEED_M_S = 1e-3
CONTACT_FORCE_N = 1e-3
SPEED_EXPONENT, FORCE_EXPONENT = (0.0, 2.0), (-0.5, 1.0)
"""What the 100 textures of HaTT show; a fit beyond is a recording with too little variation."""


@dataclass(frozen=True)
class LevelModel:
    """RMS = exp(offset) v^speed F^force, forces below least_n taken as that."""

    offset: float
    speed: float
    force: float
    least_n: float

    def evaluate(self, action: Action, count: int) -> Float:
        """(count,) RMS at samples of RATE_HZ, 0 out of contact; falls to 0 with the speed."""
        at = np.arange(count) / RATE_HZ
        v = np.interp(at, action.time, np.where(action.contact, action.speed, 0.0))
        force = np.interp(at, action.time, action.force)
        touching = np.clip(force / CONTACT_FORCE_N, 0.0, 1.0)
        rest = np.clip(v / MIN_SPEED_M_S, 0.0, 1.0)
        law = np.maximum(v, MIN_SPEED_M_S) ** self.speed * np.maximum(force, self.least_n) ** self.force
        return np.asarray(np.exp(self.offset) * law * rest * touching)


@dataclass(frozen=True)
class NearestNeighbour:
    """Method: nearest-neighbour playback."""

    name: str = "playback (nearest neighbour)"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Cut the recordings into grains; nothing is drawn. Raises FileError where none is in contact and moving."""
        del seed
        return build_grains(specimen.recordings)


@dataclass(frozen=True)
class GrainSynthesiser:
    """samples: all recordings end to end, levels evened. start: (G,) of each grain. seen: (G, D) weighted features."""

    samples: Float
    start: NDArray[np.intp]
    features: Float
    level: LevelModel
    direction_weight: float

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Grains faded over one another; each action has its own stream of the seed."""
        return [
            self._render_action(action, np.random.default_rng([seed, index])) for index, action in enumerate(actions)
        ]

    def _render_action(self, action: Action, rng: np.random.Generator) -> Float:
        count, hop = round(action.duration_s * RATE_HZ), GRAIN_SAMPLES // 2
        starts = np.arange(-hop, count, hop)
        wanted = compute_features(action, starts, self.direction_weight)
        window = np.sin(np.pi * (np.arange(GRAIN_SAMPLES) + 0.5) / GRAIN_SAMPLES)
        out = np.zeros(count + 2 * GRAIN_SAMPLES)
        before = -(10**9)
        for first, want in zip(starts, wanted, strict=True):
            chosen = self._choose(want, before, rng)
            out[first + hop : first + hop + GRAIN_SAMPLES] += window * self.samples[chosen : chosen + GRAIN_SAMPLES]
            before = chosen
        return out[hop : hop + count] * self.level.evaluate(action, count)

    def _choose(self, want: Float, before: int, rng: np.random.Generator) -> int:
        """One of the nearest, but none that shares samples with the grain before: those would add in amplitude."""
        distance = np.sum(np.square(self.features - want), axis=1)
        distance[np.abs(self.start - before) < 2 * GRAIN_SAMPLES] += 1e6
        nearest = np.argpartition(distance, min(NEIGHBOUR_COUNT, len(distance) - 1))[:NEIGHBOUR_COUNT]
        return int(self.start[rng.choice(nearest)])


def build_grains(recordings: Sequence[Recording]) -> GrainSynthesiser:
    """Grains of all recordings. Raises FileError where there are none, or where the sample rate is not 10 kHz."""
    pieces = cut_segments(recordings, 0)
    if pieces.rate != RATE_HZ:
        raise FileError(f"it has {pieces.rate:g} Hz.", where=recordings[0].source, remedy="Resample it to 10 kHz.")
    level = fit_level(pieces)
    weight = DIRECTION_WEIGHT if all("direction" in recording.known for recording in recordings) else 0.0
    samples, starts, seen, offset = [], [], [], 0
    for recording in recordings:
        evened = level.evaluate(recording.action, len(recording.samples))
        loud = evened > 0.0
        samples.append(np.divide(recording.samples, evened, out=np.zeros_like(evened), where=loud))
        start = np.arange(0, len(evened) - GRAIN_SAMPLES + 1, GRAIN_STEP_SAMPLES)
        whole = np.concatenate([[0], np.cumsum(loud & (evened > 1e-3 * evened.max()))])
        start = start[whole[start + GRAIN_SAMPLES] - whole[start] == GRAIN_SAMPLES]
        starts.append(start + offset)
        seen.append(compute_features(recording.action, start, weight))
        offset += len(evened)
    start = np.concatenate(starts)
    if len(start) == 0:
        raise FileError(
            "no tenth of a second of it is in contact and moving.",
            where=recordings[0].source,
            remedy="Record longer strokes.",
        )
    return GrainSynthesiser(np.concatenate(samples), start, np.concatenate(seen), level, weight)


def compute_features(action: Action, start: NDArray[np.intp], direction_weight: float) -> Float:
    """(len(start), 12) what is compared of grains that begin at these samples of RATE_HZ."""
    at = (start[:, None] + np.array(COMPARED_AT) * GRAIN_SAMPLES) / RATE_HZ
    speed = np.interp(at, action.time, action.speed)
    force = np.interp(at, action.time, action.force)
    turned = np.stack([np.interp(at, action.time, action.direction[:, axis]) for axis in range(2)], axis=-1)
    columns = [
        np.log(np.maximum(speed, MIN_SPEED_M_S)),
        FORCE_WEIGHT * np.log(np.maximum(force, 0.02)),
        direction_weight * turned[..., 0],
        direction_weight * turned[..., 1],
    ]
    return np.concatenate(columns, axis=1)


def fit_level(segments: Segments) -> LevelModel:
    """Least squares of log RMS over log speed and log force, exponents kept to what textures show."""
    v, f = np.log(segments.speed), np.log(segments.force)
    level = 0.5 * np.log(np.mean(np.square(segments.body), axis=1) + 1e-12)
    columns = np.stack([np.ones_like(v), v - v.mean(), f - f.mean()], axis=1)
    # A ridge of one piece's weight: a recording at one speed says nothing of the exponent.
    _, a, b = np.linalg.solve(columns.T @ columns + np.diag([0.0, 1.0, 1.0]), columns.T @ level)
    a, b = float(np.clip(a, *SPEED_EXPONENT)), float(np.clip(b, *FORCE_EXPONENT))
    return LevelModel(float(np.mean(level - a * v - b * f)), a, b, float(segments.force.min()))
