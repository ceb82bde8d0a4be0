"""Evaluation of simulated listeners: who choose by a model, by position, or tell apart; and CSVs that do not belong."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_builders import bradley_terry_listener, build_study, respond, store, write_noise

from hnf_core.errors import HnfError
from hnf_core.study.plan import compare_files, load_key, make_study
from hnf_core.study.results import (
    append_response,
    check_participant,
    evaluate_study,
    find_open_trials,
    format_results,
    get_responses_path,
    read_all_responses,
    read_responses,
)

SCORES = {"alpha": 1.0, "beta": 0.0, "gamma": -1.0}


def test_listeners_of_a_model_are_understood(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, stimuli=3, repeats=4)
    rng, listener = np.random.default_rng(2), bradley_terry_listener(key, SCORES)
    names = [f"p{number:02d}" for number in range(15)]
    for name in names:
        store(tmp_path / "study", name, respond(plan, name, listener, rng))
    results = evaluate_study(plan, key, read_all_responses(tmp_path / "study", plan))
    assert (results.participants, results.trials, results.missing_trials) == (15, 15 * 9 * 4, 0)
    assert [score.method for score in results.scores] == ["alpha", "beta", "gamma"]
    for score in results.scores:
        # One draw of listeners: an interval of 95 % misses in one of twenty, one of twice its width hardly ever.
        assert abs(SCORES[score.method] - 0.5 * (score.low + score.high)) < score.high - score.low
    assert [(pair.a, pair.b) for pair in results.pairs] == [("alpha", "beta"), ("alpha", "gamma"), ("beta", "gamma")]
    for pair in results.pairs:
        truth = 1.0 / (1.0 + np.exp(SCORES[pair.b] - SCORES[pair.a]))
        assert pair.chosen.trials == 15 * 3 * 4
        assert abs(truth - 0.5 * (pair.chosen.low + pair.chosen.high)) < pair.chosen.high - pair.chosen.low
        assert pair.chosen.p < 0.001
    assert len(results.by_stimulus) == 9
    assert sum(pair.chosen.count for pair in results.by_stimulus) == sum(pair.chosen.count for pair in results.pairs)
    assert results.first_position.p > 0.01
    assert results.biased_participants == ()
    text = format_results(results)
    for words in ("alpha chosen over gamma", "Bradley–Terry", "15 participants, 540 trials", "takes 97 trials a pair"):
        assert words in text


def test_who_chooses_by_position_prefers_nothing_and_is_named(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, stimuli=4)
    rng = np.random.default_rng(3)
    responses = {
        "stuck": respond(plan, "stuck", lambda trial, rng: True, rng),
        "fair": respond(plan, "fair", lambda trial, rng: bool(rng.random() < 0.5), rng),
    }
    results = evaluate_study(plan, key, responses)
    assert results.biased_participants == ("stuck",)
    alone = evaluate_study(plan, key, {"stuck": responses["stuck"]})
    assert all(pair.chosen.share == 0.5 for pair in alone.pairs)
    assert alone.first_position.share == 1.0
    assert alone.repeats_alike.share == 0.0
    assert [score.score for score in alone.scores] == pytest.approx([0.0] * 3, abs=1e-6)
    assert "stuck" in format_results(results)


def test_whoever_always_chooses_alike_is_consistent(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, repeats=3)
    rows = respond(plan, "p", lambda trial, rng: key[trial.first].method < key[trial.second].method, None)
    results = evaluate_study(plan, key, {"p": rows})
    assert results.repeats_alike.share == 1.0
    assert all(pair.chosen.share == 1.0 for pair in results.pairs)
    assert results.scores[0].low is None
    assert np.isfinite([score.score for score in results.scores]).all()


@pytest.mark.parametrize("hears", [True, False])
def test_abx_tells_whether_they_can_be_told_apart(hears: bool, tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, ("alpha", "beta"), abx=True, repeats=6)
    rng = np.random.default_rng(4)
    rows = respond(
        plan, "p", lambda trial, rng: (trial.first == trial.reference) if hears else bool(rng.random() < 0.5), rng
    )
    results = evaluate_study(plan, key, {"p": rows})
    (pair,) = results.pairs
    assert (pair.chosen.share == 1.0) == hears
    assert (pair.chosen.p < 0.001) == hears
    assert results.scores == ()
    assert "told apart" in format_results(results)


def test_pairs_that_do_not_meet_have_no_scores(tmp_path: Path) -> None:
    paths = [write_noise(tmp_path / f"{name}.wav", seed) for seed, name in enumerate("abcd")]
    plan, _ = make_study(tmp_path / "study", compare_files([paths[:2], paths[2:]], None))
    key = load_key(tmp_path / "study", plan)
    results = evaluate_study(plan, key, {"p": respond(plan, "p", lambda trial, rng: True, None)})
    assert results.scores == ()
    assert len(results.pairs) == 2
    assert "do not connect" in format_results(results)


def test_limited_trials_are_counted(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path)
    rows = respond(plan, "p", lambda trial, rng: True, None)
    rows[0] = replace(rows[0], limited_samples=9)
    results = evaluate_study(plan, key, {"p": rows[:5]})
    assert (results.limited_trials, results.missing_trials) == (1, 7)
    assert "limiter changed 1 trial" in format_results(results)


def test_responses_are_appended_and_the_rest_is_open(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    rows = respond(plan, "p01", lambda trial, rng: trial.number % 3 == 0, None)
    path = get_responses_path(tmp_path / "study", "p01")
    for done, row in enumerate(rows, 1):
        append_response(path, plan, row)
        assert read_responses(path, plan) == rows[:done]
        assert [trial.number for trial in find_open_trials(plan, "p01", rows[:done])] == [
            later.trial for later in rows[done:]
        ]
    with pytest.raises(HnfError, match="answered meanwhile"):
        append_response(path, plan, rows[0])
    assert list(path.parent.iterdir()) == [path]


def edit(path: Path, change) -> None:
    with path.open(newline="") as stream:
        table = list(csv.reader(stream))
    change(table)
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(table)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table[1].__setitem__(0, "0123456789abcdef"), "response to study '0123456789abcdef'"),
        (lambda table: table[2].__setitem__(6, "s999"), "trial 2 is none of 'p01'"),
        (lambda table: table.append(table[1]), "twice"),
        (lambda table: table[1].__setitem__(8, "both"), "neither first nor second"),
        (lambda table: table[1].__setitem__(2, "one"), "damaged"),
        (lambda table: table[1].__setitem__(10, "nan"), "out of range"),
        (lambda table: table[1].__setitem__(1, "p02"), "none of 'p01'"),
        (lambda table: table[0].__setitem__(8, "answer"), "columns"),
        (lambda table: table[3].pop(), "columns"),
        (lambda table: table[3].append("more"), "columns"),
        (lambda table: table.clear(), "no responses yet"),
    ],
)
def test_a_csv_that_does_not_belong_is_refused(change, words: str, tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    path = store(tmp_path / "study", "p01", respond(plan, "p01", lambda trial, rng: True, None))
    edit(path, change)
    with pytest.raises(HnfError, match=words) as caught:
        read_all_responses(tmp_path / "study", plan)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def test_a_renamed_csv_is_not_another_participant(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    path = store(tmp_path / "study", "p01", respond(plan, "p01", lambda trial, rng: True, None))
    path.rename(path.with_name("p02.csv"))
    with pytest.raises(HnfError, match="none of 'p02'"):
        read_all_responses(tmp_path / "study", plan)


@pytest.mark.parametrize("name", ["", "../p", "a/b", "a b", ".p", "x" * 41, "é", "a.csv", "-p"])
def test_a_name_that_could_leave_the_folder_is_refused(name: str) -> None:
    with pytest.raises(HnfError, match="participant"):
        check_participant(name)
