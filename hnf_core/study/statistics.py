"""Statistics of paired comparisons: exact binomial tests, intervals and power, and the Bradley–Terry model.

Null hypothesis throughout is a proportion of 1/2. Tests count trials as independent; the bootstrap does not, since it
resamples participants.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError

Float = NDArray[np.float64]

ALPHA = 0.05
"""Level of tests; intervals are of 1 − ALPHA."""
PRIOR_WINS = 0.5
"""Choices added to both sides of each compared pair, so that a method which always won has a finite score."""
RESAMPLES = 2000
"""Number of bootstrap resamples."""
MIN_DETECTED, MAX_DETECTED = 0.55, 0.99
"""Proportions whose number of trials is searched for."""
MAX_TRIALS = 3000
CERTAIN_POWER = 0.9999
"""Power from which on more trials never have less than any wanted one."""
_STEPS = 20_000
_TOLERANCE = 1e-9


def compute_binomial_pmf(count: int, proportion: float) -> Float:
    """Return the probability (count + 1,) of each number of successes in `count` trials."""
    if proportion in (0.0, 1.0):
        return np.array(np.arange(count + 1) == round(count * proportion), dtype=np.float64)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, count + 1)))])
    k = np.arange(count + 1)
    log_choices = log_factorial[count] - log_factorial - log_factorial[::-1]
    return np.array(np.exp(log_choices + k * np.log(proportion) + (count - k) * np.log1p(-proportion)))


def compute_p_value(successes: int, count: int, *, greater: bool = False) -> float:
    """Return the exact binomial p of `successes` against 1/2: two-sided, or of so many or more successes."""
    pmf = compute_binomial_pmf(count, 0.5)
    if greater:
        return min(float(pmf[successes:].sum()), 1.0)
    return min(2.0 * float(pmf[max(successes, count - successes) :].sum()), 1.0)


def compute_interval(successes: int, count: int) -> tuple[float, float]:
    """Return the exact (Clopper–Pearson) interval of a proportion."""

    def solve(successes: int) -> float:
        """Return the proportion at which so many or more successes have probability ALPHA / 2."""
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            rare = compute_binomial_pmf(count, middle)[successes:].sum() < ALPHA / 2.0
            low, high = (middle, high) if rare else (low, middle)
        return 0.5 * (low + high)

    return (
        0.0 if successes == 0 else solve(successes),
        1.0 if successes == count else 1.0 - solve(count - successes),
    )


def compute_power(count: int, proportion: float, *, greater: bool = False) -> float:
    """Return the probability that `count` trials of a true proportion are significant."""
    tail = np.cumsum(compute_binomial_pmf(count, 0.5)[::-1])  # of so many successes, or more, from all down
    rejected = int(np.count_nonzero(tail <= (ALPHA if greater else ALPHA / 2.0)))
    pmf = compute_binomial_pmf(count, proportion)
    low = 0.0 if greater else float(pmf[:rejected].sum())
    return low + float(pmf[count + 1 - rejected :].sum())


def find_trial_count(proportion: float, power: float, *, greater: bool = False) -> int:
    """Return the least number of trials from which on a true proportion is found significant with a power.

    More trials never have less: an exact test's power falls a little between the counts at which it rises.

    Raises
    ------
    UsageError
        If the proportion or the power is out of range, or more than MAX_TRIALS are needed.
    """
    if not (MIN_DETECTED <= proportion <= MAX_DETECTED and 0.5 <= power <= 0.99):
        raise UsageError(
            f"--detect {100 * proportion:g} --power {100 * power:g}: no number of trials is known.",
            remedy=f"Give {100 * MIN_DETECTED:g} to {100 * MAX_DETECTED:g}, and 50 to 99.",
        )
    top = 8
    while top < MAX_TRIALS and compute_power(top, proportion, greater=greater) < CERTAIN_POWER:
        top = min(2 * top, MAX_TRIALS)
    found = top + 1
    while found > 1 and compute_power(found - 1, proportion, greater=greater) >= power:
        found -= 1
    if found > MAX_TRIALS:
        raise UsageError(
            f"to find {proportion:.0%} with a power of {power:.0%} takes more than {MAX_TRIALS} trials a pair.",
            remedy="Give a larger --detect or a smaller --power.",
        )
    return found


def fit_bradley_terry(wins: ArrayLike, compared: ArrayLike | None = None) -> Float:
    """Fit the Bradley–Terry model: P(i is chosen over j) = 1 / (1 + exp(score_j − score_i)).

    Parameters
    ----------
    wins : array_like, shape (…, k, k)
        Times that i was chosen over j.
    compared : array_like of bool, shape (k, k), optional
        Pairs that the study compares, to both sides of which PRIOR_WINS are added; by default those with choices. They
        must connect all methods.

    Returns
    -------
    ndarray, shape (…, k)
        Scores, whose mean is 0.

    Notes
    -----
    The MM algorithm of D. R. Hunter (2004), Annals of Statistics 32(1): s_i ← won_i / Σ_j n_ij / (s_i + s_j).
    """
    matrix = np.asarray(wins, dtype=np.float64)
    mask = (matrix + np.swapaxes(matrix, -1, -2) > 0.0) if compared is None else np.asarray(compared, dtype=bool)
    matrix = matrix + PRIOR_WINS * mask
    games, won = matrix + np.swapaxes(matrix, -1, -2), matrix.sum(axis=-1)
    scores = np.zeros(won.shape)
    for _ in range(_STEPS):
        strength = np.exp(scores)
        updated = np.log(won / (games / (strength[..., :, None] + strength[..., None, :])).sum(axis=-1))
        updated -= updated.mean(axis=-1, keepdims=True)
        change, scores = float(np.abs(updated - scores).max(initial=0.0)), updated
        if change < _TOLERANCE:
            break
    return scores


def bootstrap_bradley_terry(wins: ArrayLike, seed: int) -> tuple[Float, Float] | None:
    """Return the low and high end (k,) of each score's percentile interval, resampling participants.

    Parameters
    ----------
    wins : array_like, shape (participants, k, k)
        Each participant's choices of i over j.
    seed : int
        Seed of the resamples.

    Returns
    -------
    tuple of two ndarrays, or None
        None for a single participant, who says nothing about others.
    """
    matrix = np.asarray(wins, dtype=np.float64)
    if len(matrix) < 2:
        return None
    total = matrix.sum(axis=0)
    weights = np.random.default_rng(seed).multinomial(len(matrix), [1.0 / len(matrix)] * len(matrix), RESAMPLES)
    scores = fit_bradley_terry(np.einsum("rp,pij->rij", weights, matrix), total + total.T > 0.0)
    low, high = np.percentile(scores, [50.0 * ALPHA, 100.0 - 50.0 * ALPHA], axis=0)
    return low, high
