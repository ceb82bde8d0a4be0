"""What a method is held against: one recording, the long-run spectrum, and the limits of the process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import TextureProcess
from ..metrics.limits import REALISATION_COUNT, MetricBounds, compute_bounds
from ..metrics.magnitudes import window_magnitudes
from ..metrics.spectra import WINDOW_SAMPLES, welch

Float = NDArray[np.float64]

RATE_HZ = 10_000.0
FREQUENCY_HZ = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / RATE_HZ)
WINDOW_OFFSETS = (0, 250, 500, 750)
"""Window offsets at which expected-magnitude forms are tried: a natural form does not care."""


@dataclass(frozen=True)
class Reference:
    """One stroke on one material.

    draws: (R, n) realisations of the true process; the first stands for *the* recording. oracle: further ones, from
    another seed, that no figure of the reference was taken from.
    """

    material: str
    stroke: str
    action: Action
    draws: Float
    oracle: tuple[Float, ...]

    @property
    def recording(self) -> Float:
        return np.asarray(self.draws[0])

    @cached_property
    def density(self) -> Float:
        """(501,) Welch average over all draws: the long-run spectrum."""
        return np.asarray(np.mean([welch(each, RATE_HZ)[1] for each in self.draws], axis=0))

    @cached_property
    def limits(self) -> tuple[MetricBounds, ...]:
        """One for each window offset of OFFSETS."""
        return tuple(
            compute_bounds([window_magnitudes(each[offset:]) for each in self.draws]) for offset in WINDOW_OFFSETS
        )


def make_references(
    process: TextureProcess, strokes: Sequence[tuple[str, Action]], seed: int, realisations: int, renders: int
) -> list[Reference]:
    """One Reference per named stroke, all equally long. Two seeds for the draws (one for few), another for the oracle:
    none stands on a single piece of surface."""
    actions = [action for _, action in strokes]
    half = -(-realisations // 2) if realisations >= REALISATION_COUNT else realisations
    drawn = [
        _record_draws(process, actions, 3 * seed + part, count) for part, count in ((0, half), (1, realisations - half))
    ]
    oracle = _record_draws(process, actions, 3 * seed + 2, renders)
    return [
        Reference(
            process.name,
            name,
            action,
            np.concatenate([part[index] for part in drawn if len(part[index])]),
            tuple(oracle[index]),
        )
        for index, (name, action) in enumerate(strokes)
    ]


def _record_draws(process: TextureProcess, actions: Sequence[Action], seed: int, times: int) -> list[Float]:
    """(times, n) per action, all in one call: the simulator's cost is by the call."""
    if times == 0:
        return [np.zeros((0, 0))] * len(actions)
    recordings = process.record([action for action in actions for _ in range(times)], seed)
    samples = np.stack([recording.samples for recording in recordings])
    return [samples[index * times : (index + 1) * times] for index in range(len(actions))]
