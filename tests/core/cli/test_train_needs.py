"""What every `hnf train` refuses in the same words, before anything is read or torch is asked for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hnf_core.cli.commands import require_torch
from hnf_core.cli.main import main
from hnf_core.errors import HnfError

SUBJECTS = {
    "field": ("--data", "simulated", "--material", "cloth"),
    "encoder": ("--data", "pairs"),
    "tactile-map": ("--data", "pairs"),
}


def no_blender(_arguments: object) -> int:
    raise AssertionError("no scene here")


@pytest.mark.parametrize("subject", SUBJECTS)
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "w.safetensors", "--seed", "-1"), "--seed -1: not a whole number from 0"),
        (("--out", "w.pth"), "--out w.pth: weights are .safetensors files. Name it so."),
    ],
)
def test_a_seed_or_a_file_that_will_not_do_is_told(
    subject: str, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", subject, *SUBJECTS[subject], *words], no_blender) == 2
    assert said in capsys.readouterr().err


def test_minutes_that_never_pass_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "w.safetensors")
    assert main(["train", "tactile-map", "--data", "pairs", "--out", out, "--minutes", "nan"], no_blender) == 2
    assert "--minutes must be more than 0" in capsys.readouterr().err


def test_without_torch_it_is_said_where_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with (
        pytest.raises(
            HnfError, match=r"^training needs torch \(.*torch.*make env-test.*pip install torch scipy pillow"
        ),
        require_torch("training"),
    ):
        import torch  # noqa: F401


def test_other_errors_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ZeroDivisionError), require_torch("training"):
        raise ZeroDivisionError
