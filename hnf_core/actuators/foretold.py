"""What an actuator's limits will make of a signal, known before it plays: the very chain, run without a device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from .chain import Chain
from .limits import Limits

LOWEST_DB, STEPS_PER_DB = -120.0, 10
"""Gains that are tried: those that factor() takes, in tenths."""
_FRAMES = 4096

Chained = Callable[[Limits, float], Chain]
"""(limits, gain in dB) → the chain of all that will play."""


@dataclass(frozen=True)
class Foretold:
    """share: 0–1 of the samples that the limits change; peak, slew, heat: of that, what each adds in this order.
    fits_db: the highest gain, in tenths of a dB, with which nothing is changed; None where none is low enough."""

    share: float
    peak: float
    slew: float
    heat: float
    fits_db: float | None


def foretell(chained: Chained, limits: Limits, gain_db: float, guess_db: float) -> Foretold | None:
    """Of what plays with gain_db within limits; None where it fits. guess_db: a gain that may just fit and is tried
    first, since most that is too strong is so at its peak alone. Raises what the chain raises."""
    share = _share(chained(limits, gain_db))
    if share == 0.0:
        return None
    cold = replace(limits, sustained=1.0)
    peak = _share(chained(replace(cold, slew_per_s=math.inf), gain_db))
    steep = _share(chained(cold, gain_db))
    return Foretold(
        share, peak, max(steep - peak, 0.0), max(share - steep, 0.0), _fits(chained, limits, gain_db, guess_db)
    )


def _share(chain: Chain) -> float:
    frames = 0
    while not chain.ended:
        frames += len(chain.block(_FRAMES))
    return _changed(chain) / max(frames * chain.channels, 1)


def _fits(chained: Chained, limits: Limits, gain_db: float, guess_db: float) -> float | None:
    """The guess and its neighbour, then halves: of what it gives, nothing is limited, for that was tried."""
    lowest, high = round(LOWEST_DB * STEPS_PER_DB), math.ceil(gain_db * STEPS_PER_DB)
    low, guess = lowest, math.floor(max(guess_db, LOWEST_DB) * STEPS_PER_DB)
    first = [guess, guess + 1]
    while high - low > 1:
        middle = first.pop(0) if first else (low + high) // 2
        if low < middle < high:
            low, high = (middle, high) if _passes(chained(limits, middle / STEPS_PER_DB)) else (low, middle)
    if low == lowest and (low >= high or not _passes(chained(limits, low / STEPS_PER_DB))):
        return None
    return low / STEPS_PER_DB


def _passes(chain: Chain) -> bool:
    while not chain.ended and not _changed(chain):
        chain.block(_FRAMES)
    return not _changed(chain)


def _changed(chain: Chain) -> int:
    return chain.limiter.limited + chain.nonfinite
