"""The modules that commands load."""

import os
import shlex
import subprocess
import sys

import pytest

from hnf_core.cli.commands import COMMAND_GROUP, COMMAND_MODULES, HELP, find_plugins
from hnf_core.cli.main import build_parser
from hnf_lab.bench.startup import HNF_CODE, run_process

pytestmark = pytest.mark.skipif(not hasattr(os, "wait4"), reason="no system call that tells what a process took")


@pytest.mark.parametrize("words", ["--help", "--version"])
def test_telling_what_there_is_loads_no_numpy(words):
    run = run_process(HNF_CODE, words)
    assert run.heavy_packages == ()
    assert [name for name in run.modules if name.startswith("hnf_core.") and not is_word(name)] == []
    assert run.output.startswith(("usage: hnf", "hnf "))


def test_the_module_of_the_command_can_be_run():
    words = [sys.executable, "-m", "hnf_blender.cli", "--version"]
    assert subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout.startswith("hnf ")


def is_word(module: str) -> bool:
    return module == "hnf_core.errors" or module in {"hnf_core.cli", "hnf_core.cli.main", "hnf_core.cli.commands"}


@pytest.mark.parametrize("words", ["materials --json", "synth --help", "train --help", "stream --help"])
def test_a_verb_loads_nothing_heavy_but_numpy(words):
    assert set(run_process(HNF_CODE, *shlex.split(words)).heavy_packages) <= {"numpy"}


@pytest.mark.parametrize("words", ["materials --json", "synth --help", "train field --help"])
def test_no_other_package_is_looked_up_for_a_command_of_this_one(words):
    assert "importlib.metadata" not in run_process(HNF_CODE, *shlex.split(words)).modules


def test_a_table_of_an_action_needs_no_words_for_strokes(tmp_path):
    """Their patterns take longer to compile than a second of signal to synthesise."""
    table = tmp_path / "press.csv"
    table.write_text("time_s,direction_rad,speed_m_s,force_n\n0,0,0.1,1\n0.1,0,0.1,1\n", encoding="utf-8")
    run = run_process(
        HNF_CODE, "synth", "--material", "cork", "--action", str(table), "--out", str(tmp_path / "press.wav")
    )
    assert (tmp_path / "press.wav").is_file()
    assert "hnf_core.field.synthesis" in run.modules
    assert not {"hnf_core.action.parse_stroke", "hnf_core.action.stroke_tokens"} & set(run.modules)


def test_other_packages_are_looked_up_for_what_they_may_have():
    assert "importlib.metadata" in run_process(HNF_CODE, "train", "--help").modules


def test_the_whole_command_line_is_what_its_verbs_say():
    """Asked for one verb, the parser knows the others by what they are for alone."""
    whole = build_parser(lambda _: 0).format_help()
    assert build_parser(lambda _: 0, only="").format_help() == whole
    lines = {build_parser(lambda _: 0, only=verb).format_help() for verb in COMMAND_MODULES}
    assert len(lines) == 1
    assert set(lines.pop().splitlines()) <= set(whole.splitlines())
    assert COMMAND_MODULES.keys() == HELP.keys()


@pytest.mark.parametrize("words", [("bench",), ("eval",), ("train", "encoder", "--data", "x"), ("train", "alignment")])
def test_a_plain_install_says_where_the_laboratorys_commands_are(words, monkeypatch, capsys) -> None:
    """As where no package registers them."""
    from hnf_core.cli import commands, main, train

    for module in (commands, main, train):
        monkeypatch.setattr(module, "find_plugins", lambda group: {})
    assert main.main(list(words), lambda arguments: 1) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "source checkout" in said
    assert f"hnf {' '.join(words[:2])}" in said


def test_a_checkout_lists_them(capsys) -> None:
    from hnf_core.cli.main import main

    if not find_plugins(COMMAND_GROUP):
        pytest.skip("the laboratory is not installed here")
    assert main(["--help"], lambda arguments: 1) == 0
    shown = capsys.readouterr().out
    assert "bench" in shown
    assert "eval" in shown
    assert main(["train", "--help"], lambda arguments: 1) == 0
    shown = capsys.readouterr().out
    assert "alignment" in shown
    assert "encoder" in shown
    assert main(["benhc"], lambda arguments: 1) == 2
    assert "Did you mean 'bench'?" in capsys.readouterr().err
