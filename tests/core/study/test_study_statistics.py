"""Binomial tests, intervals, power and the Bradley–Terry model against scipy, and against simulated choices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import UsageError
from hnf_core.study.results import (
    ALPHA,
    MAX_TRIALS,
    PRIOR_WINS,
    bootstrap_bradley_terry,
    compute_interval,
    compute_p_value,
    compute_power,
    find_trial_count,
    fit_bradley_terry,
)

COUNTS = st.integers(1, 400).flatmap(lambda count: st.tuples(st.integers(0, count), st.just(count)))
MATRICES = st.integers(2, 5).flatmap(
    lambda size: st.lists(st.lists(st.integers(0, 30), min_size=size, max_size=size), min_size=size, max_size=size)
)


@given(COUNTS)
@settings(deadline=None)
def test_p_and_interval_are_scipys(counts: tuple[int, int]) -> None:
    stats = pytest.importorskip("scipy.stats")
    successes, count = counts
    both = stats.binomtest(successes, count)
    assert compute_p_value(successes, count) == pytest.approx(both.pvalue, rel=1e-9)
    more = stats.binomtest(successes, count, alternative="greater").pvalue
    assert compute_p_value(successes, count, greater=True) == pytest.approx(more, rel=1e-9)
    exact = both.proportion_ci(0.95, "exact")
    assert compute_interval(successes, count) == pytest.approx((exact.low, exact.high), abs=1e-9)


@given(st.integers(1, 400), st.floats(0.01, 0.99))
@settings(deadline=None)
def test_power_is_the_chance_of_a_small_p(count: int, proportion: float) -> None:
    stats = pytest.importorskip("scipy.stats")
    pmf = stats.binom.pmf(np.arange(count + 1), count, proportion)
    for greater in (False, True):
        rejects = [compute_p_value(k, count, greater=greater) <= ALPHA for k in range(count + 1)]
        assert compute_power(count, proportion, greater=greater) == pytest.approx(pmf[rejects].sum(), abs=1e-9)


@given(st.integers(1, 1000))
def test_chance_alone_is_found_at_the_level_at_most(count: int) -> None:
    assert compute_power(count, 0.5) <= ALPHA + 1e-12
    assert compute_power(count, 0.5, greater=True) <= ALPHA + 1e-12


@pytest.mark.parametrize(("detected", "power"), [(0.65, 0.8), (0.75, 0.8), (0.55, 0.99), (0.99, 0.5), (0.6, 0.9)])
def test_from_that_many_trials_on_the_power_suffices(detected: float, power: float) -> None:
    for greater in (False, True):
        count = find_trial_count(detected, power, greater=greater)
        assert compute_power(count - 1, detected, greater=greater) < power
        later = [compute_power(n, detected, greater=greater) for n in range(count, min(count + 600, MAX_TRIALS))]
        assert min(later) >= power


@pytest.mark.parametrize(("detected", "power"), [(0.5, 0.8), (1.0, 0.8), (0.65, 1.0), (0.65, 0.1), (np.nan, 0.8)])
def test_a_power_without_trials_is_refused(detected: float, power: float) -> None:
    with pytest.raises(UsageError, match="no number of trials"):
        find_trial_count(detected, power)


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_two_methods_have_the_log_odds(wins: int, losses: int) -> None:
    scores = fit_bradley_terry([[0, wins], [losses, 0]], [[False, True], [True, False]])
    assert scores[0] - scores[1] == pytest.approx(np.log((wins + PRIOR_WINS) / (losses + PRIOR_WINS)), abs=1e-6)


@given(MATRICES, st.randoms())
@settings(deadline=None)
def test_scores_are_the_most_likely_and_follow_the_methods(rows: list[list[int]], random) -> None:
    """At the maximum each method is expected to be chosen as often as it was; renamed methods keep their scores."""
    wins = np.asarray(rows, dtype=float) * (1.0 - np.eye(len(rows)))
    compared = ~np.eye(len(rows), dtype=bool)
    scores = fit_bradley_terry(wins, compared)
    regularised = wins + PRIOR_WINS * compared
    games = regularised + regularised.T
    chance = 1.0 / (1.0 + np.exp(scores[None, :] - scores[:, None]))
    assert (games * chance).sum(axis=1) == pytest.approx(regularised.sum(axis=1), rel=1e-5)
    assert scores.mean() == pytest.approx(0.0, abs=1e-9)
    order = random.sample(range(len(rows)), len(rows))
    assert fit_bradley_terry(wins[np.ix_(order, order)], compared) == pytest.approx(scores[order], abs=1e-5)
    assert fit_bradley_terry(wins.T, compared) == pytest.approx(-scores, abs=1e-5)


def test_true_scores_lie_in_95_of_100_intervals() -> None:
    """40 studies of 12 participants; each score's interval holds the truth in some 95 %, by resampling participants."""
    truth = np.array([0.8, 0.1, -0.9])
    chance = 1.0 / (1.0 + np.exp(truth[None, :] - truth[:, None]))
    rng, held, errors = np.random.default_rng(1), [], []
    for study in range(40):
        upper = rng.binomial(10, np.triu(chance, 1), (12, 3, 3))
        wins = upper + np.tril(10.0 - np.swapaxes(upper, 1, 2), -1)
        low, high = bootstrap_bradley_terry(wins, study)
        held += ((low <= truth) & (truth <= high)).tolist()
        errors.append(fit_bradley_terry(wins.sum(axis=0)) - truth)
    assert 0.85 <= np.mean(held) <= 0.99
    assert np.abs(np.mean(errors, axis=0)).max() < 0.06


def test_one_participant_has_no_interval_and_the_seed_decides() -> None:
    wins = np.random.default_rng(0).integers(1, 9, (6, 3, 3)) * (1.0 - np.eye(3))
    assert bootstrap_bradley_terry(wins[:1], 0) is None
    first, again, other = (bootstrap_bradley_terry(wins, seed) for seed in (0, 0, 1))
    assert (np.array(first) == np.array(again)).all()
    assert (np.array(first) != np.array(other)).any()
