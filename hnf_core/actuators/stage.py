"""What happens to a stream between its source and the limiter."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]


class Processor(Protocol):
    """A causal filter at the source's rate, where there are fewest samples, with memory of its own."""

    def process(self, block: Samples) -> Samples:
        """(n, channels) m/s² → as many."""
        ...
