"""The product of the pipeline: a vibrotactile acceleration with its origin written on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Signal:
    """Acceleration a(t) in m/s², never normalised.

    samples: (n,) float32. sample_rate: Hz. seed: the carriers' seed.
    provenance: text facts (stroke, material, probe, model hash, routes) that exports carry along.
    """

    samples: NDArray[np.float32]
    sample_rate: float
    seed: int
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        return len(self.samples) / self.sample_rate

    @property
    def rms(self) -> float:
        """Root mean square in m/s²; 0 for an empty signal."""
        if len(self.samples) == 0:
            return 0.0
        return float(np.sqrt(np.mean(np.square(self.samples, dtype=np.float64))))
