"""The modules that commands load."""

import os
import shlex

import pytest

from hnf_core.cli.commands import COMMAND_MODULES, HELP
from hnf_core.cli.main import build_parser
from hnf_lab.bench.startup import HNF_CODE, run_process

pytestmark = pytest.mark.skipif(not hasattr(os, "wait4"), reason="no system call that tells what a process took")


@pytest.mark.parametrize("words", ["--help", "--version"])
def test_telling_what_there_is_loads_no_numpy(words):
    run = run_process(HNF_CODE, words)
    assert run.heavy_packages == ()
    assert [name for name in run.modules if name.startswith("hnf_core.") and not is_word(name)] == []
    assert run.output.startswith(("usage: hnf", "hnf "))


def is_word(module: str) -> bool:
    return module == "hnf_core.errors" or module in {"hnf_core.cli", "hnf_core.cli.main", "hnf_core.cli.commands"}


@pytest.mark.parametrize("words", ["materials --json", "synth --help", "train --help", "stream --help"])
def test_a_verb_loads_nothing_heavy_but_numpy(words):
    assert set(run_process(HNF_CODE, *shlex.split(words)).heavy_packages) <= {"numpy"}


def test_the_whole_command_line_is_what_its_verbs_say():
    """Asked for one verb, the parser knows the others by what they are for alone."""
    whole = build_parser(lambda _: 0).format_help()
    for only in ("", *COMMAND_MODULES):
        assert build_parser(lambda _: 0, only=only).format_help() == whole
    assert COMMAND_MODULES.keys() == HELP.keys()
