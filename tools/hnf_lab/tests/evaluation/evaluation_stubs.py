"""A texture whose limits are known, and methods that know them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import ActionRange, Recording
from hnf_core.errors import FileError
from hnf_lab.baselines.interface import FittedMaterial, Form, MaterialRecordings

Float = NDArray[np.float64]
RATE = 10_000.0
LIMITS = ActionRange((0.05, 0.2), (0.5, 2.0))


def gaussian(action: Action, seed: int, stream: int, gain: float = 1.0) -> Float:
    """Stationary Gaussian noise with a hump at 200 Hz; louder along x where the process says so."""
    count = round(action.duration_s * RATE)
    white = np.random.default_rng([seed, stream]).standard_normal(count)
    hump = np.fft.rfftfreq(count, 1.0 / RATE) / 200.0
    return gain * np.fft.irfft(np.fft.rfft(white) * hump / (1.0 + hump**2), count)


@dataclass(frozen=True)
class GaussianTexture:
    """Process. directed: four times as loud along x as along y."""

    name: str = "gaussian"
    directed: bool = False

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        return [
            Recording(action, gaussian(action, seed, index, self.gain(action)), RATE, self.name, "test")
            for index, action in enumerate(actions)
        ]

    def gain(self, action: Action) -> float:
        return float(1.0 + 3.0 * action.direction[0, 0] ** 2) if self.directed else 1.0


@dataclass(frozen=True)
class Perfect:
    """Method and Fitted in one: the process itself, times `gain`."""

    gain: float = 1.0
    name: str = "perfect"
    form: Form = "natural"
    broken: bool = False

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        if self.broken:
            raise FileError("cannot learn this.", where=specimen.name, remedy="Give it up.")
        return self

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        return [gaussian(action, 123_456 + seed, index, self.gain) for index, action in enumerate(actions)]
