"""A linear system, sample by sample, by whole blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLOCK = 64
"""Samples that one product of matrices takes: few enough that half of each matrix being zeros costs little."""


@dataclass(frozen=True)
class Recursion:
    """s[n+1] = A s[n] + b u[n], the exact step of a linear system whose input is held between samples.

    transition: (S, S), A. entry: (S,), b. Channels are independent of each other and share both.
    """

    transition: Floats
    entry: Floats

    def run(self, start: Floats, inputs: Floats) -> Floats:
        """start: (S, C). inputs: (n, C). Returns (n + 1, S, C): every state from start on."""
        states = np.empty((len(inputs) + 1, *start.shape))
        states[0] = start
        free, forced = self._block
        for at in range(0, len(inputs), BLOCK):
            block = inputs[at : at + BLOCK]
            count = len(block)
            moved = np.einsum("nst,tc->nsc", free[:count], states[at])
            states[at + 1 : at + 1 + count] = moved + np.tensordot(forced[:count, :, :count], block, axes=1)
        return states

    def run_plain(self, start: Floats, inputs: Floats) -> Floats:
        """The reference of run(): one sample after the other."""
        states = [start]
        for value in inputs:
            states.append(self.transition @ states[-1] + np.outer(self.entry, value))
        return np.asarray(states)

    @cached_property
    def _block(self) -> tuple[Floats, Floats]:
        """(N, S, S): A^(n+1). (N, S, N): what the input at sample j has become in the state after sample n."""
        powers = [np.eye(len(self.entry))]
        for _ in range(BLOCK):
            powers.append(self.transition @ powers[-1])
        responses = np.asarray(powers[:-1]) @ self.entry
        forced = np.zeros((BLOCK, len(self.entry), BLOCK))
        for sample in range(BLOCK):
            forced[sample:, :, sample] = responses[: BLOCK - sample]
        return np.asarray(powers[1:]), forced
