"""The whole command on one simulated material, as small as it goes: files, limits, pictures, and what it leaves out."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("torch")

from hnf_core.cli.main import main
from hnf_core.errors import UsageError
from hnf_lab.evaluation.materials import EvaluationSizes
from hnf_lab.evaluation.run import EvaluationOptions, run_evaluation

TINY = EvaluationSizes(1.0, 4, 1, 2.0, 1, 1, 1, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("eval")
    keys = ("shared", "playback", "shared-expected")
    run_evaluation(EvaluationOptions(out, TINY, keys=keys, workers=1, simulated=("brushed-metal",)))
    return out


def test_the_record_has_every_column_row_and_reason(folder: Path) -> None:
    record = json.loads((folder / "eval.json").read_text(encoding="utf-8"))
    assert [column["key"] for column in record["columns"]] == ["windows", "unseen"]
    for column in record["columns"]:
        assert [row["key"] for row in column["rows"]] == ["oracle", "best", "shared", "playback", "shared-expected"]
        oracle = column["rows"][0]["summary"]
        assert oracle["mse_oracle"]["mean"] == pytest.approx(1.0, abs=0.5)
        assert column["rows"][1]["summary"]["mse_best"]["median"] == 1.0
    extras = {extra["key"]: extra for extra in record["extras"]}
    assert set(extras["token_source"]["figures"]) == {"gelsight", "digit", "predicted map"}
    assert set(extras["direction"]["figures"]["ratio_error_db"]) == {"shared", "playback"}
    assert any("--hatt" in note for note in record["notes"])


def test_the_page_prints_no_number_for_what_does_not_exist(folder: Path) -> None:
    text = (folder / "eval.md").read_text(encoding="utf-8")
    assert "| bridged | needs --space FILE | – |" in text
    assert "Expected-magnitude forms: for benchmarks" in text
    for picture in folder.glob("*.png"):
        assert f"({picture.name})" in text
    assert {path.name for path in folder.glob("*.png")} == {
        "spectra-simulated-window.png", "spectra-simulated-unseen.png", "directions-brushed-metal.png",
    }  # fmt: skip


def test_wrong_words_are_refused_before_anything_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UsageError, match="playback"):
        run_evaluation(EvaluationOptions(tmp_path, TINY, keys=("nonsense",)))
    nothing = ["eval", "--out", str(tmp_path), "--methods", "nonsense"]
    assert main(nothing, lambda arguments: 0) == 2
    assert "Choose among" in capsys.readouterr().err
    assert main(["eval", "--out", str(tmp_path), "--workers", "0"], lambda arguments: 0) == 2
    assert main(["eval", "--out", str(tmp_path), "--hatt", str(tmp_path / "none")], lambda arguments: 0) == 1
    assert list(tmp_path.iterdir()) == []
