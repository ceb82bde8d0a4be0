"""F_Θ evaluated where the action asks for it: as few states as keep the whole stroke within a tolerance.

The amplitudes follow the action, which is slow most of the time and turns within milliseconds where a hand lands or
reverses. So they are evaluated on a coarse grid of samples, then halfway between neighbours; and where halfway was not
what the straight line says, further, the worst places first, until the power that is missed all over the stroke is
within the tolerance. The reference evaluates every sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..kernel.contact import add_rows
from ..kernel.library import kernel
from .carriers import MODEL_RATE_HZ
from .field import Emission, FieldConfig
from .rendering import render_weights

Float = NDArray[np.float64]
Samples = NDArray[np.int64]
Evaluate = Callable[[Samples], Emission]
"""Samples of the model rate (m,) → what is emitted there."""

COARSEST, FINEST = 800, 2
"""Samples between evaluations at most and at least: 80 ms, and 0.2 ms."""
SAFETY = 0.5
"""Of the tolerance is aimed at: what a place misses is told from its middle alone, and a short stroke's noise is louder
here than there. On primitives and an artist's stroke on leather, brass and canvas the tolerance was then kept (tests
hold some)."""
_PARABOLA = 8.0 / 15.0
"""Mean square of what a parabola misses of its chord, over the square in the middle."""
AT_ONCE = 512
MOST = 40_000
"""Samples: 0.8 GB on the way. Who follows a stroke further than that asks for more than its states know."""


@dataclass(frozen=True)
class Sampled:
    """Emissions at samples at (m,), ascending; straight lines between them. missed: power left out, over that of all,
    as far as it can be told."""

    at: Samples
    emission: Emission
    missed: float

    def reading(self, sample: Samples) -> tuple[Float, Float]:
        """alpha (n, K) of the only head and sigma_dt (n, N) at any samples (n,), held beyond the ends."""
        row, share = self.place(sample)
        alpha = np.zeros((len(sample), self.emission.alpha.shape[-1]))
        self.add_alpha(row, share, np.ones(len(sample)), alpha)
        return alpha, _between(self.emission.sigma_dt, row, share)

    def place(self, sample: Samples) -> tuple[Samples, Float]:
        """The evaluation before each sample (n,), and how far it is on the way to the next, 0 … 1."""
        row = np.clip(np.searchsorted(self.at, sample, side="right") - 1, 0, len(self.at) - 2)
        return row, np.clip((sample - self.at[row]) / (self.at[row + 1] - self.at[row]), 0.0, 1.0)

    def add_alpha(self, row: Samples, share: Float, factor: Float, out: Float) -> None:
        """out (n, K) += factor (n,) times alpha between the evaluations row (n,) and the next."""
        alpha, compiled = self.emission.alpha[:, 0], kernel()
        if compiled is not None:
            add_rows(compiled, np.ascontiguousarray(alpha), row, share, factor, out)
        else:
            out += factor[:, None] * _between(alpha, row, share)


def _between(values: Float, row: Samples, share: Float) -> Float:
    return np.asarray(values[row] + share[:, None] * (values[row + 1] - values[row]))


def sample_emission(evaluate: Evaluate, count: int, tolerance: float, turns: Samples | None = None) -> Sampled:
    """Emissions over samples 0 … count of a field with one head.

    tolerance: root of the power that the straight lines miss over that of the stroke, 0 for as fine as FINEST. turns:
    samples that are asked for in any case, since something begins or ends there. At MOST samples it stops.
    """
    known = np.arange(0) if turns is None else turns[turns < count]
    at = np.unique(np.concatenate([np.arange(0, count, COARSEST), known, [count]]))
    emission = _evaluate(evaluate, at)
    pending = np.stack([at[:-1], at[1:]], axis=1)
    before = np.zeros(len(pending))
    settled, power, claimed = np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(0)
    while True:
        long = np.diff(pending, axis=1)[:, 0] > FINEST
        pending, before = pending[long], before[long]
        if len(pending):
            at, emission, halves, found = _halved(evaluate, at, emission, pending)
            settled, power = np.concatenate([settled, halves]), np.concatenate([power, np.tile(found, 2)])
            claimed = np.concatenate([claimed, np.tile(_of_a_half(found, before), 2)])
        loud = np.square(emission.alpha).sum(axis=(1, 2))
        total = float(np.sum(0.5 * (loud[1:] + loud[:-1]) * np.diff(at)))
        left_out = claimed * np.diff(settled, axis=1)[:, 0] * _PARABOLA
        order = np.argsort(left_out)
        so_far = np.cumsum(left_out[order])
        missed = float(so_far[-1] / total) if len(so_far) and total > 0.0 else 0.0
        worst = order[np.searchsorted(so_far, (SAFETY * tolerance) ** 2 * total, side="right") :]
        worst = worst[np.diff(settled[worst], axis=1)[:, 0] > FINEST]
        worst = worst[len(worst) - min(len(worst), max(MOST - len(at), 0) // 2) :]
        if len(worst) == 0:
            return Sampled(at, emission, missed)
        worst.sort()
        pending, before = settled[worst], power[worst]
        settled, power, claimed = np.delete(settled, worst, axis=0), np.delete(power, worst), np.delete(claimed, worst)


def _of_a_half(found: Float, before: Float) -> Float:
    """What each half of an interval misses in its own middle, as power (p,): found (p,) is the interval's in its
    middle, before (p,) that of the interval it is a half of, 0 where there was none.

    A parabola leaves a 16th to each half, a kink all of it to one half, a jump too: half of it each. Where the last
    halving made it no less than half, that is taken for one of them; else a quarter is.
    """
    share: Float = 0.5 * np.clip(found / np.maximum(before, 1e-300), 0.5, 1.0)
    return found * share


def _halved(
    evaluate: Evaluate, at: Samples, emission: Emission, pending: Samples
) -> tuple[Samples, Emission, Samples, Float]:
    """With the middles of the intervals pending (p, 2): at, emission, the halves (2p, 2), and what the straight line of
    each interval misses in its middle (p,), as power."""
    middle = pending.sum(axis=1) // 2
    found = _evaluate(evaluate, middle)
    line = Sampled(at, emission, 0.0).reading(middle)
    power = np.square(found.alpha).sum(axis=(1, 2))
    # Weights answer to densities one to one at most, so a density's error is one of the whole amplitude.
    missed = np.square(found.alpha[:, 0] - line[0]).sum(axis=1) + power * np.square(found.sigma_dt - line[1]).sum(
        axis=1
    )
    order = np.argsort(np.concatenate([at, middle]), kind="stable")
    both = Emission(
        np.concatenate([emission.alpha, found.alpha])[order], np.concatenate([emission.sigma_dt, found.sigma_dt])[order]
    )
    halves = np.concatenate([np.stack([pending[:, 0], middle], 1), np.stack([middle, pending[:, 1]], 1)])
    return np.concatenate([at, middle])[order], both, halves, missed


def _evaluate(evaluate: Evaluate, at: Samples) -> Emission:
    parts = [evaluate(at[low : low + AT_ONCE]) for low in range(0, len(at), AT_ONCE)]
    return Emission(np.concatenate([p.alpha for p in parts]), np.concatenate([p.sigma_dt for p in parts]))


def accumulated(config: FieldConfig, sampled: Sampled, count: int) -> tuple[Samples, Float]:
    """Knots (m,) in 0 … count and the amplitudes (m, K) there, over the past states of each (field.accumulate)."""
    lag = round(config.spacing_s * MODEL_RATE_HZ)
    # What bends now bends again in the nearest memory; of what lies further back a hundredth is left.
    at = np.unique(np.concatenate([sampled.at, np.minimum(sampled.at + lag, count)]))
    placed = [sampled.place(at - state * lag) for state in range(config.states)]
    densities = [_between(sampled.emission.sigma_dt[:, [n]], *place)[:, 0] for n, place in enumerate(placed)]
    weights = render_weights(np.stack(densities, axis=1))
    total = np.zeros((len(at), sampled.emission.alpha.shape[-1]))
    for state, place in enumerate(placed):
        sampled.add_alpha(*place, weights[:, state] * (at >= state * lag), total)
    return at, total
