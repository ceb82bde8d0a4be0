"""Does a method know which way the hand goes? Spectra by direction on one anisotropic material (HNF, fig. 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.smooth import make_steady_action
from ..baselines.method import FittedMaterial
from ..datasets.dataset import ActionRange
from ..datasets.recording import TextureProcess
from ..metrics.average_spectrum import select_compared_bins
from ..metrics.spectra import welch
from .reference import FREQUENCY_HZ, RATE_HZ

Float = NDArray[np.float64]

DIRECTION_COUNT = 8
"""Over half a circle, 22.5° apart: there and back feel nearly the same."""


@dataclass(frozen=True)
class DirectionSpectra:
    """angle: (8,) rad. truth: (8, 501) long-run densities. methods: name → (8, 501)."""

    material: str
    speed: float
    force: float
    angle: Float
    truth: Float
    methods: Mapping[str, Float]

    def compute_anisotropy_db(self) -> float:
        """Largest RMS level ratio of two directions' spectra, over the bins that count in both."""
        return max(
            _compute_rms(_compute_ratio_db(self.truth, i, j), self._count_bins(i, j))
            for i in range(DIRECTION_COUNT)
            for j in range(i + 1, DIRECTION_COUNT)
        )

    def compute_ratio_error_db(self, name: str) -> float:
        """RMS error of the level ratio of each direction's spectrum to the first one's."""
        spectra = self.methods[name]
        errors = [
            _compute_rms(_compute_ratio_db(spectra, i, 0) - _compute_ratio_db(self.truth, i, 0), self._count_bins(i, 0))
            for i in range(1, DIRECTION_COUNT)
        ]
        return float(np.sqrt(np.mean(np.square(errors))))

    def _count_bins(self, i: int, j: int) -> NDArray[np.bool_]:
        return select_compared_bins(self.truth[i], FREQUENCY_HZ) & select_compared_bins(self.truth[j], FREQUENCY_HZ)


def measure_directions(
    process: TextureProcess,
    limits: ActionRange,
    fitted: Mapping[str, FittedMaterial],
    seconds: float,
    draws: int,
    seed: int,
) -> DirectionSpectra:
    """Steady strokes at the middle speed and force in eight directions: `draws` of the truth and of each method."""
    speed, force = (float(np.sqrt(low * high)) for low, high in (limits.speed_m_s, limits.force_n))
    angle = np.arange(DIRECTION_COUNT) * np.pi / DIRECTION_COUNT
    actions = [make_steady_action(seconds, speed, force, float(each)) for each in angle]
    drawn = process.record([action for action in actions for _ in range(draws)], 900_000 + seed)
    truth = _average_spectra([each.samples for each in drawn])
    methods = {}
    for name, each in fitted.items():
        rendered = [each.render(actions, seed + 40 + draw) for draw in range(draws)]
        methods[name] = _average_spectra(
            [rendered[draw][index] for index in range(DIRECTION_COUNT) for draw in range(draws)]
        )
    return DirectionSpectra(process.name, speed, force, angle, truth, methods)


def _average_spectra(signals: list[Float]) -> Float:
    spectra = np.stack([welch(each, RATE_HZ)[1] for each in signals])
    return np.asarray(spectra.reshape(DIRECTION_COUNT, len(signals) // DIRECTION_COUNT, -1).mean(axis=1))


def _compute_ratio_db(spectra: Float, i: int, j: int) -> Float:
    floor = 1e-12 * float(spectra.max())
    return np.asarray(10.0 * np.log10(np.maximum(spectra[i], floor) / np.maximum(spectra[j], floor)))


def _compute_rms(values: Float, bins: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(np.square(values[bins])))) if bins.any() else 0.0
