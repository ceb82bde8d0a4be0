"""The paper's second table by one command, as small as it goes, and what its load cell adds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from hnf_core.action.synthetic_actions import make_circular_action
from hnf_core.cli.main import main
from hnf_core.datasets.recording import Recording
from hnf_lab.evaluation.published_table import TIP_KG, record_by_load_cell

ROWS = ("GACM (reconstruction)", "HNF", "HNF+", "this project's shared field")
TINY = (
    "--epochs",
    "1",
    "--hidden",
    "8",
    "--raw-epochs",
    "1",
    "--raw-hidden",
    "4",
    "--gacm-steps",
    "5",
    "--seconds",
    "1",
)


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda arguments: 0)


def test_every_cell_has_its_settings_after_the_limits(tmp_path: Path) -> None:
    small = ("--materials", "brushed-metal", "--realisations", "4", "--workers", "1")
    assert hnf("eval", "published", "--out", tmp_path, *TINY, *small) == 0
    record = json.loads((tmp_path / "published.json").read_text(encoding="utf-8"))
    (table,) = record["tables"]
    rows = table["rows"]
    assert [row["sensor"] for row in rows[:2]] == ["", ""]
    assert rows[0]["scores"]["mse_oracle"] == pytest.approx(1.0, abs=0.3)
    assert rows[1]["scores"]["mse_oracle"] == pytest.approx(0.5, abs=0.15)
    named = {(row["method"], row["sensor"], row["settings"]) for row in rows[2:]}
    assert {(method, sensor) for method, sensor, _ in named} == {(m, s) for m in ROWS for s in ("GelSight", "DIGIT")}
    for settings in ("H = 8, 1 epoch", "H = 4, 1 epoch; raw actions"):
        assert ("HNF+", "DIGIT", settings) in named
    for row in rows[2:]:
        assert all(np.isfinite(value) for value in row["scores"].values())
    text = (tmp_path / "published.md").read_text(encoding="utf-8")
    assert "GelSight ST-SIM ↑" in text
    assert text.count("| HNF+ | H = 8, 1 epoch |") == 1


def test_a_load_cell_feels_the_vibration_below_1_khz() -> None:
    action, time = make_circular_action(1.0, 0.1, 1.0, 0.02), np.arange(10_000) / 1e4
    tones = {hz: Recording(action, np.sin(2 * np.pi * hz * time), 1e4, "tone", "test") for hz in (200.0, 4000.0)}
    swing = {hz: np.std(record_by_load_cell(tone).force[1000:-1000]) for hz, tone in tones.items()}
    assert swing[200.0] == pytest.approx(TIP_KG * np.sqrt(0.5), rel=0.05)
    assert swing[4000.0] < 0.02 * swing[200.0]


@pytest.mark.parametrize("words", [("--epochs", "0"), ("--realisations", "1"), ("--seconds", "0.1")])
def test_impossible_sizes_are_refused(tmp_path: Path, capsys, words) -> None:
    assert hnf("eval", "published", "--out", tmp_path, *words) == 2
    assert not list(tmp_path.iterdir())
