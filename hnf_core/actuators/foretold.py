"""What an actuator's limits will make of a signal, known before it plays: the very chain, run without a device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from .chain import SignalChain
from .limits import Limits

MIN_GAIN_DB, STEPS_PER_DB = -120.0, 10
"""Gains that are tried: those that factor() takes, in tenths."""
_BLOCK_FRAMES = 4096

ChainFactory = Callable[[Limits, float], SignalChain]
"""(limits, gain in dB) → the chain of all that will play."""


@dataclass(frozen=True)
class LimitingForecast:
    """share: 0–1 of the samples that the limits change; peak, slew, heat: of that, what each adds in this order.
    fits_db: the highest gain, in tenths of a dB, with which nothing is changed; None where none is low enough."""

    share: float
    peak: float
    slew: float
    heat: float
    max_gain_db: float | None


def predict_limiting(
    make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float
) -> LimitingForecast | None:
    """Of what plays with gain_db within limits; None where it fits. guess_db: a gain that may just fit and is tried
    first, since most that is too strong is so at its peak alone. Raises what the chain raises."""
    share = _compute_limited_share(make_chain(limits, gain_db))
    if share == 0.0:
        return None
    cold = replace(limits, sustained=1.0)
    peak = _compute_limited_share(make_chain(replace(cold, slew_per_s=math.inf), gain_db))
    steep = _compute_limited_share(make_chain(cold, gain_db))
    return LimitingForecast(
        share,
        peak,
        max(steep - peak, 0.0),
        max(share - steep, 0.0),
        _find_max_gain_db(make_chain, limits, gain_db, first_guess_db),
    )


def _compute_limited_share(chain: SignalChain) -> float:
    frames = 0
    while not chain.ended:
        frames += len(chain.render_block(_BLOCK_FRAMES))
    return _count_changed_samples(chain) / max(frames * chain.channels, 1)


def _find_max_gain_db(make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float) -> float | None:
    """The guess and its neighbour, then halves: of what it gives, nothing is limited, for that was tried."""
    lowest, high = round(MIN_GAIN_DB * STEPS_PER_DB), math.ceil(gain_db * STEPS_PER_DB)
    low, guess = lowest, math.floor(max(first_guess_db, MIN_GAIN_DB) * STEPS_PER_DB)
    first = [guess, guess + 1]
    while high - low > 1:
        middle = first.pop(0) if first else (low + high) // 2
        if low < middle < high:
            low, high = (middle, high) if _is_unlimited(make_chain(limits, middle / STEPS_PER_DB)) else (low, middle)
    if low == lowest and (low >= high or not _is_unlimited(make_chain(limits, low / STEPS_PER_DB))):
        return None
    return low / STEPS_PER_DB


def _is_unlimited(chain: SignalChain) -> bool:
    while not chain.ended and not _count_changed_samples(chain):
        chain.render_block(_BLOCK_FRAMES)
    return not _count_changed_samples(chain)


def _count_changed_samples(chain: SignalChain) -> int:
    return chain.limiter.limited + chain.nonfinite
