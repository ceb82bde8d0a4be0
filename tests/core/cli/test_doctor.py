"""`hnf doctor`: what is there, what is not, and what that costs; and what `hnf` alone, or a wrong command, says."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

import hnf_core
from hnf_core.cli import doctor
from hnf_core.cli.main import main
from hnf_core.diagnostics import OPTIONAL_PACKAGES, Package
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import without_kernel


def hnf(*words: str) -> int:
    def no_blender(arguments: Any) -> int:
        raise AssertionError("this needs no Blender")

    return main(list(words), no_blender)


def test_it_tells_versions_hashes_and_who_does_the_kernels_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("doctor", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["hnf"], told["numpy"]) == (hnf_core.__version__, np.__version__)
    assert told["field"] == load_field().identity
    assert len(told["material_library"]) == len(told["weights_for_pictures"]) == 32
    assert set(told["packages"]) == {each.name for each in OPTIONAL_PACKAGES}
    assert all(bool(each["version"]) != bool(each["without"]) for each in told["packages"].values())
    assert [key for key in told if not re.fullmatch("[a-z]+(_[a-z]+)*", key)] == []
    with without_kernel():
        assert hnf("doctor") == 0
    rows = capsys.readouterr().out
    assert "Compiled kernel" in rows
    assert "using slower numpy version" in rows


def test_a_missing_part_is_named_with_what_it_costs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "OPTIONAL_PACKAGES", (Package("no-such-package", "nothing is felt"),))
    assert hnf("doctor") == 0
    assert "no-such-package" in (said := capsys.readouterr().out)
    assert "not installed: nothing is felt" in said


def test_alone_it_shows_what_there_is_and_how_to_begin(capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf() == 2
    told = capsys.readouterr()
    assert told.err == ""
    for words in ("COMMAND", "hnf touch scene.blend --plan", "hnf synth --material", "doctor"):
        assert words in told.out
    assert "VERB" not in told.out


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("probe", "hnf touch SCENE --out DIR --at OBJECT:u,v"),
        ("toch", "Did you mean 'touch'?"),
        ("xyzzy", "Commands: touch, views, synth, "),
    ],
)
def test_a_command_that_is_none_is_answered_with_what_does_it(
    word: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf(word, "--json") == 2
    told = capsys.readouterr().err
    assert told.startswith(f"hnf: there is no command '{word}'. ")
    assert said in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(("option", "said"), [("--version", f"hnf {hnf_core.__version__}\n"), ("--help", "usage: hnf")])
@pytest.mark.parametrize("word", ["doctor", "xyzzy"])
def test_help_and_version_are_told_whatever_follows(
    option: str, said: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf(option, word) == 0
    told = capsys.readouterr()
    assert told.out.startswith(said)
    assert told.err == ""


def test_the_former_name_of_a_query_is_answered_with_the_new_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf("touch", "scene.blend", "--out", "result", "--probe", "Cup:0.5,0.25") == 2
    said = capsys.readouterr().err
    assert "--probe names the tip that touches" in said
    assert "--at Cup:0.5,0.25" in said
