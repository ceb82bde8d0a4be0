"""The evaluation harness: a perfect method scores as the oracle, each flaw in its own figure, and forms stay apart."""

from __future__ import annotations

import json

import numpy as np
import pytest
from evaluation_stubs import LIMITS, GaussianTexture, Perfect, gaussian

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.errors import UsageError
from hnf_core.metrics.spectra import welch
from hnf_lab.evaluation.materials import (
    EvaluatedMaterial,
    EvaluationSizes,
    MaterialResult,
    evaluate_material,
    make_column,
    measure_directions,
    score_method,
)
from hnf_lab.evaluation.methods import Budget, MethodEntry, list_entries, make_expected_magnitude_signal, select_entries
from hnf_lab.evaluation.report import Report, format_report, summarise
from hnf_lab.evaluation.scoring import (
    METRIC_NAMES,
    Reference,
    make_references,
    make_training_actions,
    make_trials,
    score_best,
    score_expected_magnitude,
    score_natural,
)

SIZES = EvaluationSizes(2.0, 32, 4, 4.0, 1, 1, 2)


@pytest.fixture(scope="module")
def reference() -> Reference:
    return make_references(GaussianTexture(), [("steady", make_steady_action(2.0, 0.1, 1.0))], 1, 32, 4)[0]


@pytest.fixture(scope="module")
def judged() -> MaterialResult:
    stubs = (
        MethodEntry("perfect", "wandering", lambda budget: Perfect()),
        MethodEntry("broken", "circular", lambda budget: Perfect(broken=True)),
        MethodEntry("half", "circular and primitives", lambda budget: Perfect(0.5, "half as loud")),
        MethodEntry(
            "lines", "wandering", lambda budget: Perfect(form="expected magnitude", name="noise as benchmark form")
        ),
        MethodEntry("blind", "wandering", lambda budget: Perfect(), needs_token=True),
    )
    return evaluate_material(
        EvaluatedMaterial(GaussianTexture(), LIMITS), stubs, SIZES, Budget(), 3, lambda stage: None
    )


def test_a_perfect_method_scores_as_the_oracle(reference: Reference) -> None:
    oracle, perfect = (
        score_natural(signals, reference)
        for signals in (reference.oracle, [gaussian(reference.action, 99, draw) for draw in range(4)])
    )
    for score in (oracle, perfect):
        assert score.mse_oracle == pytest.approx(1.0, abs=0.08)
        assert score.mse_best == pytest.approx(2.0, abs=0.16)
        assert score.power_bias_db == pytest.approx(0.0, abs=0.25)
        assert score.distance_db is not None
        assert score.distance_db < 0.6
        assert score.lsd_db == pytest.approx(7.6, abs=0.5)
    assert reference.limits[0].oracle_share == pytest.approx(0.429, abs=0.02)


def test_every_flaw_shows(reference: Reference) -> None:
    quiet = score_natural([0.5 * each for each in reference.oracle], reference)
    assert quiet.power_bias_db == pytest.approx(-6.02, abs=0.3)
    assert quiet.nine_band_db == pytest.approx(6.02, abs=0.3)
    silent = score_natural([np.zeros_like(reference.recording)], reference)
    assert silent.mse_oracle == pytest.approx(1.0 / 0.429, rel=0.05)
    assert silent.distance_db is not None
    assert silent.distance_db > 60.0
    looped = score_natural([np.tile(reference.recording[:2500], 8)], reference)
    assert looped.repetition == pytest.approx(1.0, abs=1e-6)
    same = score_natural([reference.recording], reference)
    assert (same.st_sim_tum, same.spqi, same.lsd_db) == (1.0, 1.0, 0.0)
    with pytest.raises(ValueError, match="rendering"):
        score_natural([reference.recording[:-1]], reference)
    with pytest.raises(ValueError, match="not finite"):
        score_natural([np.full_like(reference.recording, np.nan)], reference)


def test_expected_magnitude_scores_within_ten_percent_of_best(
    reference: Reference,
) -> None:
    density = np.mean([welch(each, 10_000.0)[1] for each in reference.draws], axis=0)[1:101]
    shown = score_expected_magnitude([make_expected_magnitude_signal(density[None, :], 20_000)], reference)
    assert 1.0 < (shown.mse_best or 0.0) <= 1.10
    assert (shown.distance_db, shown.power_bias_db, shown.nine_band_db, shown.repetition) == (None,) * 4
    best = score_best(reference)
    assert (best.mse_best, best.mse_oracle) == (1.0, 0.5)
    assert best.st_sim_tum is None


def test_one_that_fails_is_named_and_costs_nobody_else(judged: MaterialResult) -> None:
    assert [note.split(":")[0] for note in judged.notes] == ["broken on gaussian"]
    assert set(judged.cells) == {"oracle", "best", "perfect", "half", "lines"}
    for cells in judged.cells.values():
        assert {kind: len(found) for kind, found in cells.items()} == {"window": 2, "unseen": 2}


def test_tables_keep_the_forms_apart_and_always_show_the_limits(judged: MaterialResult) -> None:
    stubs = (
        MethodEntry("perfect", "wandering", lambda budget: Perfect()),
        MethodEntry(
            "lines", "wandering", lambda budget: Perfect(form="expected magnitude", name="noise as benchmark form")
        ),
    )
    found = make_column("a", "(a) Test", "A note.", ["window"], [judged], stubs, Budget())
    assert [row.key for row in found.rows] == ["oracle", "best", "perfect", "lines"]
    report = Report({"seed": 3}, (found,), notes=judged.notes, timings={"all": 1.0})
    text = format_report(report)
    natural, benchmark = text.index("Natural forms: signals"), text.index("Expected-magnitude forms: for")
    assert natural < text.index("oracle: the true process", natural) < text.index("| perfect", natural) < benchmark
    assert benchmark < text.index("| best: the true process's mean") < text.index("| noise as benchmark form")
    assert "cannot learn this" in text
    record = json.loads(json.dumps(report.to_json()))
    assert record["schema"] == 1
    rows = {row["key"]: row for row in record["columns"][0]["rows"]}
    assert rows["perfect"]["summary"]["mse_oracle"]["median"] == pytest.approx(1.0, abs=0.1)
    assert set(rows["perfect"]["cells"][0]) == {"material", "stroke", *METRIC_NAMES}
    assert "distance_db" not in rows["lines"]["summary"]


def test_a_summary_leaves_out_what_a_method_does_not_have(reference: Reference) -> None:
    cells = score_method(Perfect(), Perfect(), [reference, reference], 1, 0)
    found = summarise(cells)
    assert found["distance_db"]["count"] == 2
    assert found["distance_db"]["min"] <= found["distance_db"]["median"] <= found["distance_db"]["max"]
    assert summarise([]) == {}


def test_diets_stay_within_their_limits_and_hold_no_trial() -> None:
    for diet in ("wandering", "circular", "circular and primitives"):
        actions = make_training_actions(diet, LIMITS, 60.0, 0)
        seconds = 90.0 if diet == "circular and primitives" else 60.0
        assert sum(action.duration_s for action in actions) == pytest.approx(seconds, rel=0.25)
        if diet != "circular and primitives":
            for action in actions:
                assert (
                    LIMITS.speed_m_s[0] - 1e-9 <= action.speed.min() <= action.speed.max() <= LIMITS.speed_m_s[1] + 1e-9
                )
                assert LIMITS.force_n[0] - 1e-9 <= action.force.min() <= action.force.max() <= LIMITS.force_n[1] + 1e-9
    wandering = make_training_actions("wandering", LIMITS, 60.0, 0)
    for trial in make_trials(LIMITS, 2.0, 0):
        assert trial.action.duration_s == 2.0
        speeds = trial.action.speed
        assert not any(np.array_equal(speeds, action.speed[: len(speeds)]) for action in wandering)
    kinds = [trial.kind for trial in make_trials(LIMITS, 2.0, 0)]
    assert kinds == ["window", "window", "unseen", "unseen"]


def test_only_a_directed_method_recovers_the_anisotropy() -> None:
    class Knowing(Perfect):
        def render(self, actions, seed):  # type: ignore[no-untyped-def]
            texture = GaussianTexture(directed=True)
            return [gaussian(a, 5000 + seed, index, texture.gain(a)) for index, a in enumerate(actions)]

    measured = measure_directions(
        GaussianTexture(directed=True), LIMITS, {"knows": Knowing(), "blind": Perfect()}, 2.0, 8, 0
    )
    assert measured.compute_anisotropy_db() == pytest.approx(20.0 * np.log10(4.0), abs=0.5)
    assert measured.compute_ratio_error_db("knows") < 1.0
    assert measured.compute_ratio_error_db("blind") > 5.0


def test_methods_are_chosen_by_key() -> None:
    assert [entry.key for entry in select_entries(["ar", "field", "ar"])] == ["ar", "field"]
    assert [entry.key for entry in select_entries(None)] == [entry.key for entry in list_entries()]
    with pytest.raises(UsageError, match="field"):
        select_entries(["nonsense"])
