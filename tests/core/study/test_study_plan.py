"""Plans of studies: what is blinded, what stays as it was, in which order it is presented, and what is refused."""

from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_builders import build_study, write_methods, write_noise

from hnf_core.errors import HnfError
from hnf_core.export.wav import read_wav
from hnf_core.study.plan import (
    Pair,
    Plan,
    compare_files,
    compare_methods,
    find_stimulus,
    group_connected,
    load_key,
    load_plan,
    make_study,
    order_trials,
)

PARTICIPANTS = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,8}", fullmatch=True)


def plan_of(pairs: int, repeats: int, seed: int = 0) -> Plan:
    made = tuple(Pair(f"p{number:03d}", f"a{number}", f"b{number}", "") for number in range(pairs))
    return Plan(1, "?", False, repeats, seed, False, (), made)


@given(st.integers(1, 12), st.integers(1, 5), PARTICIPANTS)
def test_every_repeat_has_each_pair_once_in_both_orders(pairs: int, repeats: int, participant: str) -> None:
    plan = plan_of(pairs, repeats)
    trials = order_trials(plan, participant)
    assert [trial.number for trial in trials] == list(range(1, pairs * repeats + 1))
    sides: dict[str, list[str]] = {}
    for repeat in range(repeats):
        block = trials[repeat * pairs : (repeat + 1) * pairs]
        assert {trial.repeat for trial in block} == {repeat}
        assert sorted(trial.pair for trial in block) == [pair.id for pair in plan.pairs]
        swapped = sum(trial.first.startswith("b") for trial in block)
        assert abs(2 * swapped - pairs) <= 1
        for trial in block:
            sides.setdefault(trial.pair, []).append(trial.first)
    for firsts in sides.values():
        assert all(one != other for one, other in pairwise(firsts))


def test_orders_are_even_over_participants() -> None:
    """Of 2000 participants each pair comes first to some 1/5, and each stimulus of it is first to some 1/2."""
    plan = plan_of(5, 1)
    orders = [order_trials(plan, f"p{number}") for number in range(2000)]
    begins = Counter(trials[0].pair for trials in orders)
    firsts = Counter(trials[0].first[0] for trials in orders)
    follows = Counter((trials[0].pair, trials[1].pair) for trials in orders)
    assert max(abs(count - 400) for count in begins.values()) < 4 * np.sqrt(2000 * 0.2 * 0.8)
    assert abs(firsts["a"] - 1000) < 4 * np.sqrt(2000 * 0.25)
    assert len(follows) == 20
    assert max(abs(count - 100) for count in follows.values()) < 4.5 * np.sqrt(2000 * 0.05 * 0.95)


def test_another_seed_or_participant_has_another_order() -> None:
    orders = {
        tuple(trial.pair for trial in order_trials(plan_of(8, 1, seed), name)) for seed in (0, 1) for name in "ab"
    }
    assert len(orders) == 4


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=20))
def test_groups_are_what_edges_connect(edges: list[tuple[int, int]]) -> None:
    groups = group_connected(edges)
    assert sum(map(len, groups)) == len(set().union(*groups)) == len({item for edge in edges for item in edge})
    assert all(any({a, b} <= group for group in groups) for a, b in edges)
    for group in groups:  # no group can be split without an edge across
        for part in [{item} for item in group] if len(group) > 1 else []:
            assert any((a in part) != (b in part) for a, b in edges if a in group)


def test_nothing_blinded_names_a_method_and_samples_stay(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, seed=5)
    study = tmp_path / "study"
    text = (study / "study.json").read_text("utf-8")
    for word in ("alpha", "beta", "gamma", "texture", "secret", str(tmp_path)):
        assert word not in text
        assert all(word.encode() not in path.read_bytes() for path in (study / "stimuli").iterdir())
    assert len(plan.pairs) == 6
    for name, entry in key.items():
        found, original = read_wav(find_stimulus(study, name)), read_wav(Path(entry.source))
        assert (found.samples == original.samples).all()
        assert (found.sample_rate, entry.gain_db) == (original.sample_rate, 0.0)
        assert entry.rms_m_s2 == pytest.approx(original.rms)
    assert load_plan(study) == plan


def test_pairs_are_of_one_stimulus_and_two_methods(tmp_path: Path) -> None:
    plan, key = build_study(tmp_path, stimuli=3)
    pairs = Counter(
        (key[pair.a].name, frozenset({key[pair.a].method, key[pair.b].method}))
        for pair in plan.pairs
        if key[pair.a].name == key[pair.b].name
    )
    assert len(pairs) == 9
    assert set(pairs.values()) == {1}


def test_blinded_names_do_not_follow_the_order_of_files(tmp_path: Path) -> None:
    ranks = []
    for seed in range(30):
        folder = tmp_path / str(seed)
        _, key = build_study(folder, ("alpha", "beta"), 3, seed=seed)
        ranks.append(np.mean([int(name[1:]) for name, entry in key.items() if entry.method == "alpha"]))
    assert abs(np.mean(ranks) - 3.5) < 0.5
    assert np.std(ranks) > 0.3


def test_a_reference_is_compared_with_and_never_chosen(tmp_path: Path) -> None:
    folders = write_methods(tmp_path, ("alpha", "beta", "real"))
    plan, _ = make_study(tmp_path / "study", compare_methods(folders, reference="real"))
    key = load_key(tmp_path / "study", plan)
    assert len(plan.pairs) == 2
    for pair in plan.pairs:
        assert key[pair.reference].method == "real"
        assert {key[pair.a].method, key[pair.b].method} == {"alpha", "beta"}
        assert len({key[name].name for name in (pair.a, pair.b, pair.reference)}) == 1
    assert "nearer" in plan.question


def test_in_abx_each_of_a_pair_is_the_reference_once(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path, ("alpha", "beta"), abx=True)
    assert Counter(pair.reference for pair in plan.pairs) == Counter(stimulus.id for stimulus in plan.stimuli)
    assert all(pair.reference in (pair.a, pair.b) for pair in plan.pairs)
    assert "same" in plan.question


def test_against_keeps_pairs_with_a_method_alone(tmp_path: Path) -> None:
    folders = write_methods(tmp_path, ("real", "alpha", "beta"), 1)
    assert {(each.a.method, each.b.method) for each in compare_methods(folders, ["real"])} == {
        ("real", "alpha"), ("real", "beta"),
    }  # fmt: skip


def test_levels_are_matched_to_the_reference(tmp_path: Path) -> None:
    folders = write_methods(tmp_path, ("alpha", "beta", "real"), 2)
    write_noise(tmp_path / "alpha" / "texture0.wav", 7, rms=9.0)
    comparisons = compare_methods(folders, reference="real")
    _, notes = make_study(tmp_path / "as-it-is", comparisons)
    assert "1 of 2 pairs differ by up to 12.6 dB" in notes[0]
    assert "--match-level" in notes[0]
    plan, notes = make_study(tmp_path / "study", comparisons, match_level=True)
    assert notes == []
    assert plan.level_matched
    key = load_key(tmp_path / "study", plan)
    for pair in plan.pairs:
        levels = [read_wav(find_stimulus(tmp_path / "study", name)).rms for name in (pair.a, pair.b, pair.reference)]
        assert levels == pytest.approx([key[pair.reference].rms_m_s2] * 3)
        assert key[pair.reference].gain_db == 0.0


def test_different_lengths_are_noted(tmp_path: Path) -> None:
    a, b = write_noise(tmp_path / "a.wav", 1), write_noise(tmp_path / "b.wav", 2, seconds=0.08)
    _, notes = make_study(tmp_path / "study", compare_files([(a, b)], None))
    assert "38% in duration" in notes[0]


def change_stimulus(folder: Path) -> None:
    path = next((folder / "study" / "stimuli").iterdir())
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))


def edit_plan(folder: Path, change) -> None:
    path = folder / "study" / "study.json"
    record = json.loads(path.read_text("utf-8"))
    change(record)
    path.write_text(json.dumps(record), "utf-8")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (change_stimulus, "is not the stimulus"),
        (lambda folder: next((folder / "study" / "stimuli").iterdir()).unlink(), "cannot be read"),
        (lambda folder: (folder / "study" / "study.json").unlink(), "hnf study make"),
        (lambda folder: (folder / "study" / "study.json").write_text("{"), "damaged"),
        (lambda folder: (folder / "study" / "key.json").unlink(), "--key"),
        (lambda folder: edit_plan(folder, lambda plan: plan.pop("repeats")), "needs 'repeats'"),
        (lambda folder: edit_plan(folder, lambda plan: plan.update(schema=2)), "another version"),
        (lambda folder: edit_plan(folder, lambda plan: plan.update(repeats=3)), "key of another study"),
        (lambda folder: edit_plan(folder, lambda plan: plan["pairs"][0].update(a="s900")), "do not match"),
        (lambda folder: edit_plan(folder, lambda plan: plan["stimuli"][0].update(id="../key")), "do not match"),
    ],
)
def test_a_changed_study_is_refused_in_one_line(spoil, words: str, tmp_path: Path) -> None:
    build_study(tmp_path)
    spoil(tmp_path)
    with pytest.raises(HnfError, match=words) as caught:
        load_key(tmp_path / "study", load_plan(tmp_path / "study"))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def write_plain_wav(path: Path) -> Path:
    import wave

    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 10_000, 0, "NONE", ""))
        file.writeframes(np.full(500, 3000, "<i2").tobytes())
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda at: compare_files([(at / "a.wav", write_noise(at / "b.wav", 2, rate_hz=8000.0))], None), "rate"),
        (lambda at: compare_files([(at / "a.wav", at / "none.wav")], None), "cannot be read"),
        (lambda at: compare_files([(at / "a.wav", at / "a.wav")], None), "with itself"),
        (lambda at: compare_files([(at / "a.wav", at / "b.wav")], at / "b.wav"), "with itself"),
        (lambda at: compare_files([(at / "a.wav", write_noise(at / "b.wav", 1, rms=0.0))], None), "silent"),
        (lambda at: compare_files([(at / "a.wav", write_plain_wav(at / "b.wav"))], None), "--full-scale"),
        (lambda at: compare_methods({"x": at}), "two methods"),
        (lambda at: compare_methods({"x": at, "y": at}, reference="x"), "two methods"),
        (lambda at: compare_methods({"x": at, "y": at}, ["z"]), "no method is called 'z'"),
        (lambda at: compare_methods({"x": at, "y": write_noise(at / "y" / "c.wav", 3).parent}), "lacks"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_refused_in_one_line(make, words: str, tmp_path: Path) -> None:
    write_noise(tmp_path / "a.wav", 1)
    with pytest.raises(HnfError, match=words) as caught:
        make_study(tmp_path / "study", make(tmp_path))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy
    assert not (tmp_path / "study" / "study.json").exists()


def test_a_study_is_never_overwritten(tmp_path: Path) -> None:
    build_study(tmp_path)
    before = (tmp_path / "study" / "study.json").read_bytes()
    with pytest.raises(HnfError, match="a study here already"):
        build_study(tmp_path, seed=1)
    assert (tmp_path / "study" / "study.json").read_bytes() == before
