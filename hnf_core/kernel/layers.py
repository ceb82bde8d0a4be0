"""Compiled: the layers and heads of F_Θ (the twin in numpy is heads in field/network.py).

What a state gives follows from that state alone, to the last bit: not from how many are asked for at once, nor from the
number of cores. And weights that lie in the order in which they are used make a state cheaper than a BLAS that puts
them in order at every call: at H = 256 1.3 times with a hundred states at once, twice with sixteen.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..cores import parallel_for
from .library import get_address, pack_pointers

Float32 = NDArray[np.float32]

PANEL_WIDTH = 32
"""Outputs whose weights lie side by side, as in layers.c."""
STATES_PER_CALL = 96
"""States whose numbers on the way stay near the processor."""
MIN_MULTIPLICATIONS_PER_THREAD = 1 << 24
"""Multiplications: about a third of a millisecond."""


class Layers:
    """weights (outputs, inputs) and biases (outputs,) float32: the ReLU layers in their order, then the heads of α and
    of σ. Raises ValueError where these do not follow from one another, TypeError for other numbers."""

    def __init__(self, weights: Sequence[Float32], biases: Sequence[Float32]) -> None:
        shapes = [each.shape for each in weights]
        if len(weights) != len(biases) or len(weights) < 2:
            raise ValueError(f"{len(weights)} layers and heads with {len(biases)} biases")
        hidden = shapes[-3][0] if len(shapes) > 2 else shapes[0][1]
        fits = all(one[0] == other[1] for one, other in pairwise(shapes[:-2]))
        fits = fits and shapes[-1][1] == shapes[-2][1] == hidden
        if not fits or any(len(bias) != shape[0] for bias, shape in zip(biases, shapes, strict=True)):
            raise ValueError(f"layers of {shapes} do not follow from one another")
        if any(each.dtype != np.float32 for each in (*weights, *biases)):
            raise TypeError("the kernel takes layers of float32")
        self.inputs, self.outputs, self.densities = shapes[0][1], shapes[-2][0], shapes[-1][0]
        self.widths = np.array([shapes[0][1], *(shape[0] for shape in shapes)], dtype=np.int64)
        self.panels, self.biases = [_pack_panels(each) for each in weights], [_pad_rows(each) for each in biases]
        self._scratch_size = 2 * int(self.widths[:-2].max())
        self._min_states = max(MIN_MULTIPLICATIONS_PER_THREAD // sum(each.size for each in self.panels), 1)

    def evaluate(self, kernel: ctypes.CDLL, x: Float32) -> tuple[Float32, Float32]:
        """What the α head and the σ head say of inputs x (n, D), (n, …) each. Raises ValueError for another D."""
        if x.ndim != 2 or x.shape[1] != self.inputs:
            raise ValueError(f"inputs of {x.shape} for layers that take {self.inputs}")
        head, sigma = (np.empty((len(x), count), dtype=np.float32) for count in (self.outputs, self.densities))

        def part(low: int, high: int) -> None:
            room = self.allocate_scratch(min(high - low, STATES_PER_CALL))
            for at in range(low, high, STATES_PER_CALL):
                rows = slice(at, min(at + STATES_PER_CALL, high))
                kernel.hnf_layers(*self.make_arguments(x[rows], room, head[rows], sigma[rows]))

        parallel_for(part, len(x), self._min_states)
        return head, sigma

    def allocate_scratch(self, states: int) -> Float32:
        """What so many states at once are worked out in."""
        return np.empty(states * self._scratch_size, dtype=np.float32)

    def make_arguments(self, x: Float32, scratch: Float32, head: Float32, sigma: Float32) -> tuple[object, ...]:
        """What hnf_layers is called with; all of it is to be kept for as long as that."""
        addresses = (
            pack_pointers([each.__array_interface__["data"][0] for each in some]) for some in (self.panels, self.biases)
        )
        return (
            *addresses, get_address(self.widths, np.int64), len(self.panels) - 2, get_address(x, np.float32), len(x),
            get_address(scratch, np.float32), get_address(head, np.float32), get_address(sigma, np.float32),
        )  # fmt: skip


def _pack_panels(weight: Float32) -> Float32:
    """Weights (outputs, inputs) as (panels, inputs, PANEL)."""
    inputs = weight.shape[1]
    return np.ascontiguousarray(_pad_rows(weight).reshape(-1, PANEL_WIDTH, inputs).transpose(0, 2, 1))


def _pad_rows(values: Float32) -> Float32:
    """Rows of 0 after the last, to a whole number of panels."""
    filled = np.zeros((-(-len(values) // PANEL_WIDTH) * PANEL_WIDTH, *values.shape[1:]), dtype=np.float32)
    filled[: len(values)] = values
    return filled
