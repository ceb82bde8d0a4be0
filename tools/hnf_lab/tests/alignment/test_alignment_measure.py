"""Evaluation of aligned encoders: probes, retrieval, pseudo-triplets, intervals, and the table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("torch", reason="alignment trains with torch")

from hnf_core.errors import FileError
from hnf_lab.alignment.linear_probes import (
    IMAGES,
    REFITTED,
    TOUCH,
    VISION,
    Hits,
    ProbeInput,
    choose_linear_probe,
    cross_validate_probes,
    estimate_accuracy,
    estimate_ratio,
    evaluate_probes,
    fit_linear_probe,
)
from hnf_lab.alignment.results import (
    CrossSensorRetrieval,
    Measurement,
    compute_label_agreement,
    compute_ranks,
    compute_recall,
    find_nearest,
    format_report,
    load_measurement,
    make_pseudo_triplets,
    make_report,
    save_measurement,
)


def unit(rng: np.random.Generator, n: int, d: int = 8) -> np.ndarray:
    rows = rng.standard_normal((n, d)).astype(np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def clouds(rng: np.random.Generator, classes: int, each: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    label = np.repeat(np.arange(classes), each)
    return 3.0 * np.eye(6)[label] + spread * rng.standard_normal((len(label), 6)), label


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([1e-3, 1e-1]))
def test_no_step_away_from_the_probe_costs_less(seed: int, ridge: float) -> None:
    """The problem is convex, so a point that no small step betters is the solution."""
    rng = np.random.default_rng(seed)
    x, label = clouds(rng, 3, 30, 2.0)
    probe = fit_linear_probe(x, label, 3, ridge)

    def cost(weight: np.ndarray, bias: np.ndarray) -> float:
        logits = (x - probe.mean) / probe.scale @ weight + bias
        likely = np.exp(logits)[np.arange(len(x)), label] / np.exp(logits).sum(axis=1)
        return float(-np.log(likely).mean() + 0.5 * ridge * np.sum(weight**2))

    least = cost(probe.weight, probe.bias)
    for _ in range(20):
        moved = 1e-2 * rng.standard_normal(probe.weight.shape), 1e-2 * rng.standard_normal(3)
        assert cost(probe.weight + moved[0], probe.bias + moved[1]) > least


def test_a_probe_learns_what_is_linear_and_nothing_else() -> None:
    rng = np.random.default_rng(0)
    x, label = clouds(rng, 4, 60, 0.4)
    fresh, truth = clouds(rng, 4, 60, 0.4)
    probe, ridge = choose_linear_probe(x, label, np.arange(len(x)), 4)
    assert np.mean(probe.predict(fresh) == truth) > 0.98
    assert ridge > 0
    noise = rng.standard_normal((400, 6))
    mixed, _ = choose_linear_probe(noise, rng.integers(0, 4, 400), np.arange(400), 4)
    assert np.mean(mixed.predict(rng.standard_normal((2000, 6))) == rng.integers(0, 4, 2000)) == pytest.approx(
        0.25, abs=0.05
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 600), st.integers(0, 2**31))
def test_ranks_are_those_of_a_full_sort(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    queries, gallery = unit(rng, n), unit(rng, n + 3)
    order = np.argsort(-(queries @ gallery.T), axis=1, kind="stable")
    assert np.array_equal(compute_ranks(queries, gallery), (order == np.arange(n)[:, None]).argmax(axis=1))


def test_recall_of_the_same_the_blind_and_chance() -> None:
    rng = np.random.default_rng(0)
    rows = unit(rng, 1000)
    assert compute_recall(rows, rows, (1, 5)) == {1: 1.0, 5: 1.0}
    blind = np.tile(rows[:1], (1000, 1))
    assert compute_recall(blind, blind, (1, 10)) == {1: 0.0, 10: 0.0}
    by_chance = compute_recall(unit(rng, 1000), rows, (10, 1000))
    assert by_chance[10] == pytest.approx(0.01, abs=0.012)
    assert by_chance[1000] == 1.0


def test_triplets_take_nearest_and_mutual_neighbours() -> None:
    rng = np.random.default_rng(1)
    gelsight, digit = unit(rng, 700), unit(rng, 300)
    rows, cosine = find_nearest(gelsight, digit)
    assert np.array_equal(rows, (gelsight @ digit.T).argmax(axis=1))
    every, sure = make_pseudo_triplets(gelsight, digit), make_pseudo_triplets(gelsight, digit, mutual=True)
    assert np.array_equal(every.digit, rows)
    assert np.array_equal(every.cosine, cosine)
    assert 0 < len(sure.gelsight) < 301
    assert len(set(sure.digit)) == len(sure.digit)
    back, _ = find_nearest(digit, gelsight)
    assert np.array_equal(back[sure.digit], sure.gelsight)
    shuffled = rng.permutation(700)
    found = make_pseudo_triplets(gelsight[shuffled], gelsight)
    assert np.array_equal(found.digit, shuffled)
    assert compute_label_agreement(found, shuffled, np.arange(700)) == 1.0


def test_intervals_have_coverage_and_widen_for_grouped_views() -> None:
    rng = np.random.default_rng(2)
    inside = 0
    for trial in range(100):
        hits = Hits(rng.uniform(size=120) < 0.7, np.arange(120))
        one = estimate_accuracy(hits, trial)
        inside += one.low <= 0.7 <= one.high
    assert 0.88 <= inside / 100 <= 0.99
    correct = np.repeat(rng.uniform(size=50) < 0.5, 6)
    apart, together = (
        estimate_accuracy(Hits(correct, np.arange(300))),
        estimate_accuracy(Hits(correct, np.repeat(np.arange(50), 6))),
    )
    assert together.value == apart.value
    assert together.high - together.low > 1.8 * (apart.high - apart.low)
    assert (together.items, together.groups) == (300, 50)


def test_a_ratio_is_paired() -> None:
    rng = np.random.default_rng(3)
    group = np.repeat(np.arange(80), 4)
    base = rng.uniform(size=320) < np.repeat(rng.uniform(size=80), 4)
    same = estimate_ratio(Hits(base, group), Hits(base, group))
    assert (same.value, same.low, same.high) == (1.0, 1.0, 1.0)
    fewer = base & (rng.uniform(size=320) < 0.9)
    less = estimate_ratio(Hits(fewer, group), Hits(base, group))
    assert less.value == fewer.sum() / base.sum()
    assert less.low < less.value < less.high < 1.0
    with pytest.raises(ValueError, match="same items"):
        estimate_ratio(Hits(base, group), Hits(base, group[::-1]))


def seen(rng: np.random.Generator, label: np.ndarray, turn: np.ndarray, noise: float = 0.1) -> ProbeInput:
    """Looks that show the class, touches that show it through a turn of the space."""
    looks = np.eye(8)[label] + noise * rng.standard_normal((len(label), 8))
    touches = (np.eye(8)[label] + noise * rng.standard_normal((len(label), 8))) @ turn
    return ProbeInput(looks, touches, label, np.arange(len(label)) // 2, 4)


def test_only_a_refitted_probe_works_on_a_turned_sensor() -> None:
    rng = np.random.default_rng(4)
    turns = {"gelsight": np.eye(8), "digit": np.roll(np.eye(8), 1, axis=1)}
    label = np.tile(np.repeat(np.arange(4), 2), 20)
    fitted = {name: seen(rng, label, turn) for name, turn in turns.items()}
    tested = {name: seen(rng, label, turn) for name, turn in turns.items()}
    found = {cell: float(hits.correct.mean()) for cell, hits in evaluate_probes(fitted, tested, ("gelsight",)).items()}
    assert found[VISION, IMAGES] > 0.99
    assert found[TOUCH, "gelsight"] > 0.99
    assert found[TOUCH, "digit"] < 0.3
    assert found[REFITTED, "digit"] > 0.99
    assert set(found) == {(VISION, IMAGES), *((head, name) for head in (TOUCH, REFITTED) for name in turns)}
    across = cross_validate_probes(tested, ("digit",))
    assert across[TOUCH, "digit"].correct.mean() > 0.9
    assert len(across[TOUCH, "digit"].correct) == len(label)


def test_folds_never_see_the_pieces_they_judge() -> None:
    """Labels that a piece carries by chance, and looks that are the piece itself: only a leak could tell them."""
    rng = np.random.default_rng(5)
    piece = np.repeat(np.arange(160), 4)
    label = rng.integers(0, 4, 160)[piece]
    looks = rng.standard_normal((160, 8))[piece]
    found = cross_validate_probes({"gelsight": ProbeInput(looks, looks, label, piece, 4)}, ("gelsight",))
    assert found[TOUCH, "gelsight"].correct.mean() == pytest.approx(0.25, abs=0.1)


def measured(trained_on: str, shares: dict[str, float]) -> Measurement:
    rng = np.random.default_rng(6)
    group = np.repeat(np.arange(100), 4)
    cells = {(VISION, IMAGES): 0.8, **{(TOUCH, name): value for name, value in shares.items()}}
    hits = {cell: Hits(np.sort(rng.permutation(400) < 400 * value)[::-1], group) for cell, value in cells.items()}
    found = {name: {"look to touch": {1: 0.1, 5: 0.3}, "touch to look": {1: 0.2, 5: 0.4}} for name in shares}
    return Measurement(trained_on, hits, {}, found, 400, CrossSensorRetrieval(50, 0.6, 0.1, 0.03, 20, 0.8))


def test_the_table_compares_with_the_same_sensors_own_training() -> None:
    told = make_report(
        [measured("gelsight", {"gelsight": 0.8, "digit": 0.2}), measured("digit", {"gelsight": 0.3, "digit": 0.5}),
         measured("both", {"gelsight": 0.8, "digit": 0.45})],
        {"known": 0.04},
    )  # fmt: skip
    kept = {(each.trained_on, each.tested_on): each.ratio.value for each in told.kept}
    assert kept == pytest.approx(
        {("gelsight", "digit"): 0.4, ("digit", "gelsight"): 0.375, ("both", "gelsight"): 1.0, ("both", "digit"): 0.9}
    )
    words = format_report(told)
    assert "chance 4.0 %" in words
    assert "| touch | both | DIGIT | 45.0 (" in words
    assert "| both | DIGIT | 90.0 (" in words
    assert "| both | 50 | 60.0 | 10.0 | 3.0 | 20 | 80.0 |" in words
    record = told.to_json()
    assert len(record["accuracy"]) == 9
    assert record["accuracy"][0]["accuracy"]["items"] == 400
    assert record["recall"]["both"]["digit"]["look to touch"][5] == 0.3


def test_what_was_measured_is_kept_for_these_weights_only(tmp_path) -> None:
    path, sums = tmp_path / "measured.json", {"touch": "a", "vision": "b"}
    assert load_measurement(path, sums) is None
    before = measured("both", {"gelsight": 0.8, "digit": 0.45})
    save_measurement(path, before, sums)
    after = load_measurement(path, sums)
    assert after is not None
    assert make_report([after], {"known": 0.1}).to_json() == make_report([before], {"known": 0.1}).to_json()
    assert load_measurement(path, {**sums, "touch": "c"}) is None
    path.write_text(path.read_text()[:-50])
    with pytest.raises(FileError, match="Delete it"):
        load_measurement(path, sums)
