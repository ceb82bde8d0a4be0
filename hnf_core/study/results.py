"""Responses of a study and their evaluation: choices of each pair of methods, Bradley–Terry scores, checks, and power.

Responses are one CSV per participant, written after every trial, from a page or a terminal. Every row names the study
and repeats its trial, so that a row of another study or an edited one is noticed. The null hypothesis is a proportion
of 1/2 throughout. Tests count trials as independent; the bootstrap does not, since it resamples participants.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FileError, UsageError, pluralize
from ..files import write_text
from .plan import KeyEntry, Plan, Trial, group_connected, order_trials

RESPONSES_NAME = "responses"
FIRST, SECOND = "first", "second"


@dataclass(frozen=True)
class Response:
    """One row of a participant's CSV.

    Attributes
    ----------
    study, participant : str
        Id of the study; the participant's name for it.
    trial, pair, repeat, reference, first, second
        The trial, see `Trial`.
    response : str
        "first" or "second".
    plays : int
        How often the stimuli of the trial were presented.
    seconds : float
        Time from the first presentation to the response [s].
    limited_samples, underruns : int
        Samples that the actuator's limiter changed, and times that the device ran out of them; 0 from a page.
    time_utc : str
        Time of the response.
    """

    study: str
    participant: str
    trial: int
    pair: str
    repeat: int
    reference: str
    first: str
    second: str
    response: str
    plays: int
    seconds: float
    limited_samples: int
    underruns: int
    time_utc: str

    @property
    def chosen(self) -> str:
        """The stimulus that was chosen."""
        return self.first if self.response == FIRST else self.second


COLUMNS = tuple(field.name for field in fields(Response))


def check_participant(name: str) -> str:
    """Return the name of a participant; raise UsageError if it would make no file name."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", name):
        raise UsageError(
            f"--participant {name[:60]!r}: a name has up to 40 letters, digits, - and _.", remedy="Give e.g. p01."
        )
    return name


def get_responses_path(folder: Path, participant: str) -> Path:
    """Return the path of a participant's CSV."""
    return folder / RESPONSES_NAME / f"{check_participant(participant)}.csv"


def read_responses(path: Path, plan: Plan) -> list[Response]:
    """Read a participant's CSV.

    Raises
    ------
    FileError
        If it is damaged, belongs to another study, or holds a trial that this participant does not have.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline=""), strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Restore it from a copy.") from error
    responses, trials = [], {trial.number: trial for trial in order_trials(plan, path.stem)}
    for number, row in enumerate(rows, 2):
        where = f"{path}, line {number}"
        if tuple(row) != COLUMNS or None in row.values():
            raise FileError(
                "its columns are not those of a study.", where=where, remedy=f"They are {','.join(COLUMNS)}."
            )
        if row["study"] != plan.id:
            raise FileError(
                f"is a response to study {row['study'][:20]!r}, and this one is {plan.id}.",
                where=where,
                remedy="Move the file to the folder of its study.",
            )
        try:
            response = _parse_row(row)
        except ValueError as error:
            raise FileError(f"is damaged ({error}).", where=where, remedy="Restore it from a copy.") from error
        trial = trials.pop(response.trial, None)
        told = (response.trial, response.pair, response.repeat, response.reference, response.first, response.second)
        if response.participant != path.stem or trial is None or told != astuple(trial):
            raise FileError(
                f"trial {response.trial} is none of '{path.stem}', or is there twice.",
                where=where,
                remedy="Name the file after its participant, and leave its rows as they were written.",
            )
        responses.append(response)
    return responses


def read_all_responses(folder: Path, plan: Plan) -> dict[str, list[Response]]:
    """Read the responses of all participants of a study; raise FileError if there are none."""
    found = {path.stem: read_responses(path, plan) for path in sorted((folder / RESPONSES_NAME).glob("*.csv"))}
    responses = {participant: rows for participant, rows in found.items() if rows}
    if not responses:
        raise FileError(
            "there are no responses yet.",
            where=str(folder),
            remedy=f"Run it (hnf study run), or put the CSVs of its page into {folder / RESPONSES_NAME}.",
        )
    return responses


def append_response(path: Path, plan: Plan, response: Response) -> None:
    """Add a response to a participant's CSV; an earlier file is whole at every moment. Raises FileError."""
    earlier = read_responses(path, plan) if path.exists() else []
    if any(each.trial == response.trial for each in earlier):
        raise FileError(
            f"trial {response.trial} was answered meanwhile.",
            where=str(path),
            remedy="Run one session of a participant at a time.",
        )
    write_text(path, format_responses([*earlier, response]))


def format_responses(responses: list[Response]) -> str:
    """Format responses as CSV with a header."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(astuple(response) for response in responses)
    return out.getvalue()


def find_open_trials(plan: Plan, participant: str, responses: list[Response]) -> list[Trial]:
    """Return a participant's trials without a response, in their order."""
    done = {response.trial for response in responses}
    return [trial for trial in order_trials(plan, participant) if trial.number not in done]


def _parse_row(row: dict[str, str]) -> Response:
    kinds = {"int": int, "float": float, "str": str}
    response = Response(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Response)})
    if response.response not in (FIRST, SECOND):
        raise ValueError(f"{response.response[:20]!r} is neither {FIRST} nor {SECOND}")
    if not (0.0 <= response.seconds < 1e9 and response.plays >= 0 and response.limited_samples >= 0):
        raise ValueError("a number is out of range")
    return response


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
