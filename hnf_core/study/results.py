"""Evaluation of a study: choices of each pair of methods, Bradley–Terry scores, checks of the responses, and power."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import pluralize
from .plan import KeyEntry, Plan, group_connected
from .responses import FIRST, Response
from .statistics import (
    bootstrap_bradley_terry,
    compute_interval,
    compute_p_value,
    compute_power,
    find_trial_count,
    fit_bradley_terry,
)

BIASED_P = 0.01
"""p below which a participant's share of first positions is reported."""


@dataclass(frozen=True)
class Share:
    """Share of some choices with its exact interval and p against 1/2."""

    count: int
    trials: int
    share: float
    low: float
    high: float
    p: float

    @classmethod
    def of(cls, chosen: Sequence[bool], *, greater: bool = False) -> Share:
        """Count the trials (at least one) in which something was chosen."""
        count, trials = sum(chosen), len(chosen)
        low, high = compute_interval(count, trials)
        return cls(count, trials, count / trials, low, high, compute_p_value(count, trials, greater=greater))

    def format(self) -> str:
        """Format as "78 of 120 (65.0 %, 95 % interval 55.8–73.5 %), p = 0.0013"."""
        p = f"p = {self.p:.2g}" if self.p >= 1e-4 else "p < 0.0001"
        interval = f"95 % interval {100 * self.low:.1f}–{100 * self.high:.1f} %"
        return f"{self.count} of {self.trials} ({100 * self.share:.1f} %, {interval}), {p}"


@dataclass(frozen=True)
class PairResult:
    """Choices of one method over another (in ABX: right responses), on all stimuli or on one."""

    a: str
    b: str
    name: str
    chosen: Share


@dataclass(frozen=True)
class Score:
    """Bradley–Terry score of a method; the interval resamples participants and is missing for a single one."""

    method: str
    score: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Power:
    """Power of a pair's trials to find a true proportion, and the trials that a wanted power takes."""

    detected: float
    wanted: float
    trials: int
    power: float
    trials_needed: int


@dataclass(frozen=True)
class StudyResults:
    """Results of a study.

    Attributes
    ----------
    study, question : str
        Id and question.
    abx, level_matched : bool
        As in the plan.
    participants, trials, missing_trials : int
        Participants with responses, their responses, and those that they still owe.
    pairs, by_stimulus : tuple of PairResult
        Choices by pair of methods, on all stimuli together and on each.
    scores : tuple of Score
        Bradley–Terry scores, best first; empty in ABX, or where the pairs do not connect all methods.
    first_position : Share
        Trials in which the first stimulus was chosen.
    repeats_alike : Share or None
        Successive repeats of a pair with the same choice; None without repeats.
    biased_participants : tuple of str
        Participants who chose one position more often than chance allows.
    limited_trials, underrun_trials : int
        Trials whose stimuli the actuator's limiter changed, or in which the device ran out of samples.
    power : Power
        For the pair with the fewest trials.
    """

    study: str
    question: str
    abx: bool
    level_matched: bool
    participants: int
    trials: int
    missing_trials: int
    pairs: tuple[PairResult, ...]
    by_stimulus: tuple[PairResult, ...]
    scores: tuple[Score, ...]
    first_position: Share
    repeats_alike: Share | None
    biased_participants: tuple[str, ...]
    limited_trials: int
    underrun_trials: int
    power: Power


def evaluate_study(
    plan: Plan, key: Mapping[str, KeyEntry], responses: Mapping[str, Sequence[Response]], *,
    detected: float = 0.65, wanted_power: float = 0.8,
) -> StudyResults:  # fmt: skip
    """Evaluate the responses of all participants.

    Parameters
    ----------
    plan : Plan
        The study.
    key : mapping of str to KeyEntry
        What each stimulus is.
    responses : mapping of str to sequence of Response
        Responses by participant; at least one in all.
    detected : float
        True proportion for the power estimate.
    wanted_power : float
        Power for the number of trials needed.

    Raises
    ------
    UsageError
        If `detected` or `wanted_power` is out of range.
    """
    everything = [row for rows in responses.values() for row in rows]
    pairs = _compare_pairs(plan, key, everything, by_stimulus=False)
    fewest = min(pair.chosen.trials for pair in pairs)
    first = {participant: Share.of([row.response == FIRST for row in rows]) for participant, rows in responses.items()}
    alike = [
        rows[earlier].chosen == rows[later].chosen
        for rows in responses.values()
        for earlier, later in _find_successive_repeats(rows)
    ]
    return StudyResults(
        study=plan.id,
        question=plan.question,
        abx=plan.abx,
        level_matched=plan.level_matched,
        participants=len(responses),
        trials=len(everything),
        missing_trials=len(responses) * len(plan.pairs) * plan.repeats - len(everything),
        pairs=pairs,
        by_stimulus=_compare_pairs(plan, key, everything, by_stimulus=True),
        scores=() if plan.abx else _score_methods(plan, key, responses),
        first_position=Share.of([row.response == FIRST for row in everything]),
        repeats_alike=Share.of(alike) if alike and not plan.abx else None,
        biased_participants=tuple(name for name, share in first.items() if share.p < BIASED_P),
        limited_trials=sum(row.limited_samples > 0 for row in everything),
        underrun_trials=sum(row.underruns > 0 for row in everything),
        power=Power(
            detected, wanted_power, fewest, compute_power(fewest, detected, greater=plan.abx),
            find_trial_count(detected, wanted_power, greater=plan.abx),
        ),
    )  # fmt: skip


def _compare_pairs(
    plan: Plan, key: Mapping[str, KeyEntry], rows: Sequence[Response], *, by_stimulus: bool
) -> tuple[PairResult, ...]:
    """Return the choices of every pair of methods, in alphabetical order."""
    chosen: dict[tuple[str, str, str], list[bool]] = {}
    for row in rows:
        a, b = sorted((key[row.first].method, key[row.second].method))
        success = row.chosen == row.reference if plan.abx else key[row.chosen].method == a
        chosen.setdefault((a, b, key[row.first].name if by_stimulus else ""), []).append(success)
    return tuple(PairResult(*names, Share.of(each, greater=plan.abx)) for names, each in sorted(chosen.items()))


def _find_successive_repeats(rows: Sequence[Response]) -> list[tuple[int, int]]:
    """Return the places of each pair's successive repeats in a participant's rows."""
    places: dict[str, list[int]] = {}
    for place, row in enumerate(rows):
        places.setdefault(row.pair, []).append(place)
    return [(each[i], each[i + 1]) for each in places.values() for i in range(len(each) - 1)]


def _score_methods(
    plan: Plan, key: Mapping[str, KeyEntry], responses: Mapping[str, Sequence[Response]]
) -> tuple[Score, ...]:
    compared = {(key[row.first].method, key[row.second].method) for rows in responses.values() for row in rows}
    if len(group_connected(compared)) != 1:
        return ()
    methods = sorted({method for pair in compared for method in pair})
    wins = np.zeros((len(responses), len(methods), len(methods)))
    for index, rows in enumerate(responses.values()):
        for row in rows:
            other = row.second if row.chosen == row.first else row.first
            wins[index, methods.index(key[row.chosen].method), methods.index(key[other].method)] += 1.0
    scores, interval = fit_bradley_terry(wins.sum(axis=0)), bootstrap_bradley_terry(wins, plan.seed)
    ends = interval or ([None] * len(methods),) * 2
    listed = [
        Score(method, float(score), *(None if end is None else float(end) for end in each))
        for method, score, *each in zip(methods, scores, *ends, strict=True)
    ]
    return tuple(sorted(listed, key=lambda score: -score.score))


def format_results(results: StudyResults) -> str:
    """Format the results as text for a terminal."""
    lines = [
        f"Study {results.study}: {results.question}",
        f"{pluralize(results.participants, 'participant')}, {pluralize(results.trials, 'trial')}"
        + (f", {results.missing_trials} still to do" if results.missing_trials else "")
        + (", levels matched" if results.level_matched else ""),
        "",
    ]
    for pair in results.pairs:
        what = f"{pair.a} and {pair.b} told apart" if results.abx else f"{pair.a} chosen over {pair.b}"
        lines.append(f"{what}: {pair.chosen.format()}")
    if results.scores:
        lines += ["", "Bradley–Terry scores (95 % by resampling participants):"]
        width = max(len(score.method) for score in results.scores)
        for score in results.scores:
            ends = "" if score.low is None else f"  ({score.low:+.2f} … {score.high:+.2f})"
            lines.append(f"  {score.method:{width}}  {score.score:+.2f}{ends}")
        if results.scores[0].low is None:
            lines.append("  One participant says nothing about others: no intervals.")
    elif not results.abx:
        lines += ["", "No Bradley–Terry scores: the pairs do not connect all methods."]
    lines += ["", f"First position chosen: {results.first_position.format()}"]
    if results.repeats_alike is not None:
        lines.append(f"Repeats with the same choice: {results.repeats_alike.format()}")
    if results.biased_participants:
        lines.append(f"Chose one position more often than chance: {', '.join(results.biased_participants)}")
    if results.limited_trials or results.underrun_trials:
        lines.append(
            f"The limiter changed {pluralize(results.limited_trials, 'trial')}, the device ran out of samples in "
            f"{results.underrun_trials}: their stimuli were not those of the plan."
        )
    return "\n".join([*lines, "", format_power(results.power)])


def format_power(power: Power) -> str:
    """Format a power estimate as one line."""
    return (
        f"Power: {pluralize(power.trials, 'trial')} a pair find a true {power.detected:.0%} with a probability of "
        f"{power.power:.0%}; {power.wanted:.0%} takes {power.trials_needed} trials a pair."
    )
