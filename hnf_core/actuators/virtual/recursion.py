"""A linear system, sample by sample, by whole blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLOCK_SAMPLES = 64
"""Samples that one product of matrices takes: few enough that half of each matrix being zeros costs little."""


@dataclass(frozen=True)
class StateSpace:
    """s[n+1] = A s[n] + b u[n], the exact step of a linear system whose input is held between samples.

    transition: (S, S), A. entry: (S,), b. Channels are independent of each other and share both.
    """

    transition: Floats
    input_vector: Floats

    def simulate(self, start: Floats, inputs: Floats) -> Floats:
        """start: (S, C). inputs: (n, C). Returns (n + 1, S, C): every state from start on."""
        states = np.empty((len(inputs) + 1, *start.shape))
        states[0] = start
        free, forced = self._block_matrices
        for at in range(0, len(inputs), BLOCK_SAMPLES):
            block = inputs[at : at + BLOCK_SAMPLES]
            count = len(block)
            moved = np.einsum("nst,tc->nsc", free[:count], states[at])
            states[at + 1 : at + 1 + count] = moved + np.tensordot(forced[:count, :, :count], block, axes=1)
        return states

    def simulate_reference(self, start: Floats, inputs: Floats) -> Floats:
        """The reference of run(): one sample after the other."""
        states = [start]
        for value in inputs:
            states.append(self.transition @ states[-1] + np.outer(self.input_vector, value))
        return np.asarray(states)

    @cached_property
    def _block_matrices(self) -> tuple[Floats, Floats]:
        """(N, S, S): A^(n+1). (N, S, N): what the input at sample j has become in the state after sample n."""
        powers = [np.eye(len(self.input_vector))]
        for _ in range(BLOCK_SAMPLES):
            powers.append(self.transition @ powers[-1])
        responses = np.asarray(powers[:-1]) @ self.input_vector
        forced = np.zeros((BLOCK_SAMPLES, len(self.input_vector), BLOCK_SAMPLES))
        for sample in range(BLOCK_SAMPLES):
            forced[sample:, :, sample] = responses[: BLOCK_SAMPLES - sample]
        return np.asarray(powers[1:]), forced
