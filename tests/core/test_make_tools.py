"""The tools behind make: system libraries, environments, and the merged summary."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import merge_summary
import pytest
import run_tests
import setup_env
import system_libraries
from hypothesis import given
from hypothesis import strategies as st
from merge_summary import Case

TOTALS = re.compile(
    r"^=+ (?:(\d+) failed)?,? ?(?:(\d+) passed)?,? ?(?:(\d+) skipped)?,? ?(?:(\d+) errors?)? in [\d.]+s =+$"
)
CASES = st.lists(
    st.builds(
        Case, st.just("core"), st.from_regex(r"[a-z_]{1,8}", fullmatch=True), st.sampled_from(merge_summary.OUTCOMES),
        st.text(st.characters(min_codepoint=33, max_codepoint=1000), max_size=20),
    ),
    max_size=20,
)  # fmt: skip


@given(CASES.filter(len))
def test_the_last_line_counts_every_outcome_in_pytests_words(cases: list[Case]) -> None:
    last = merge_summary.format_summary(cases, 1.5).splitlines()[-1]
    match = TOTALS.match(last)
    assert match is not None, last
    counted = dict(zip(merge_summary.OUTCOMES, (int(group or 0) for group in match.groups()), strict=True))
    assert counted == {word: sum(case.outcome == word for case in cases) for word in merge_summary.OUTCOMES}


@given(CASES)
def test_failure_is_a_failed_test_an_error_or_no_test_at_all(cases: list[Case]) -> None:
    bad = {"failed", "error"} & {case.outcome for case in cases}
    assert merge_summary.has_failed(cases) == (bool(bad) or not cases)


def test_junit_round_trip(tmp_path: Path) -> None:
    cases = [
        Case("core", f"test_{word}", word, "why <&> not" if word != "passed" else "") for word in merge_summary.OUTCOMES
    ]
    merge_summary.write_cases(tmp_path / "core.xml", cases)
    assert merge_summary.read_cases(tmp_path / "core.xml") == cases


def test_summary_of_a_real_pytest_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "test_it.py").write_text(
        "import pytest\n"
        "def test_a(): pass\n"
        "def test_b(): assert 1 == 2\n"
        "@pytest.mark.skip(reason='no such machine')\n"
        "def test_c(): pass\n"
        "@pytest.fixture\n"
        "def broken(): raise OSError('gone')\n"
        "def test_d(broken): pass\n"
    )
    (tmp_path / "test_whole.py").write_text("import pytest\npytest.importorskip('no_such_module', reason='not here')\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--junitxml=x.xml", "--rootdir=."]
    subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60)
    assert merge_summary.main([str(tmp_path / "x.xml")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"==== 1 failed, 1 passed, 2 skipped, 1 error in [\d.]+s ====", lines[-1])
    assert "SKIPPED [1] x: no such machine" in lines
    assert "SKIPPED [1] x: not here" in lines
    assert any(line.startswith("FAILED x: test_it::test_b - assert 1 == 2") for line in lines)


def test_an_unreadable_result_is_an_error_not_a_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "core.xml").write_text("<testsuite><testcase")
    assert merge_summary.main([str(tmp_path / "core.xml"), str(tmp_path / "absent.xml")]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("==== 2 errors in ")


@pytest.mark.parametrize(
    ("body", "timeout_s", "word"),
    [
        ("import sys\ndef test_a(): assert sys.pycache_prefix and not sys.dont_write_bytecode\n", 60.0, "1 passed"),
        ("import os\ndef test_a(): os.abort()\n", 60.0, "ended with exit code -6, Aborted in test_it.py:2 test_a"),
        ("import time\ndef test_a(): time.sleep(60)\n", 3.0, "was ended after 3 s"),
        ("x = 1\n", 60.0, "ended with exit code 5"),
    ],
)
def test_a_check_that_crashes_hangs_or_finds_nothing_is_an_error(
    body: str, timeout_s: float, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    monkeypatch.setattr(run_tests, "build_command", lambda check: [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path),
        str(tmp_path / "test_it.py"), f"--junitxml={tmp_path / 'it.xml'}",
    ])  # fmt: skip
    (tmp_path / "test_it.py").write_text(body)
    cases, _ = run_tests.run(run_tests.Check("it", ".venv", (), timeout_s))
    assert word in merge_summary.format_summary(cases, 0.0)
    assert merge_summary.has_failed(cases) == (word != "1 passed")


@pytest.mark.parametrize("crashes", [1, 2])
def test_an_old_blender_that_crashed_is_run_once_more(
    crashes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    monkeypatch.setattr(run_tests, "build_command", lambda check: [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path),
        str(tmp_path / "test_it.py"), f"--junitxml={tmp_path / 'it.xml'}",
    ])  # fmt: skip
    (tmp_path / "test_it.py").write_text(
        "import os, pathlib\nruns = pathlib.Path(__file__).with_name('runs')\ndef test_a():\n"
        "    count = len(runs.read_text()) if runs.exists() else 0\n    runs.write_text('x' * (count + 1))\n"
        f"    if count < {crashes}:\n        os.abort()\n"
    )
    cases, log = run_tests.run(run_tests.Check("it", ".venv", (), 60.0, can_end=False))
    summary = merge_summary.format_summary(cases, 0.0)
    assert "ended with exit code -6, Aborted in test_it.py:7 test_a: run again" in summary
    assert "---- run again ----" in log
    assert merge_summary.has_failed(cases) == (crashes == 2)
    assert (tmp_path / "runs").read_text() == "xx"


def test_every_system_library_of_the_list_can_be_looked_for() -> None:
    assert set(system_libraries.read_packages()) == set(system_libraries.SONAMES) | set(system_libraries.PYTHON_MODULES)


def test_a_missing_library_gives_one_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(system_libraries.SONAMES, "libsm6", "libNoSuchThing.so.6")
    monkeypatch.setattr(
        system_libraries.shutil, "which", lambda name: "/usr/bin/apt-get" if name == "apt-get" else None
    )
    monkeypatch.setattr(system_libraries.os, "geteuid", lambda: 1000)
    assert system_libraries.main() == 1
    said = capsys.readouterr().err
    assert "sudo apt-get update && sudo apt-get install -y libsm6\n" in said
    assert "libNoSuchThing.so.6" in said


@pytest.mark.parametrize("name", sorted(setup_env.FOLDERS))
def test_the_stamp_follows_what_decides_the_environment(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").touch()
    assert not setup_env.is_fresh(tmp_path, name)
    setup_env.get_stamp_path(tmp_path, name).write_text(setup_env.compute_fingerprint(name))
    assert setup_env.is_fresh(tmp_path, name)
    changed = tmp_path / "requirements"
    changed.mkdir()
    for path in setup_env.REQUIREMENTS.iterdir():
        (changed / path.name).write_text(path.read_text() + "\nsix==1.17.0\n")
    monkeypatch.setattr(setup_env, "REQUIREMENTS", changed)
    assert not setup_env.is_fresh(tmp_path, name)


def test_an_environment_of_another_kind_is_never_deleted(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("mine")
    with pytest.raises(setup_env.SetupError, match="is no Python environment"):
        setup_env.ensure_interpreter(tmp_path)
    assert (tmp_path / "precious").read_text() == "mine"


def test_a_missing_python_leaves_its_tests_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setup_env, "ROOT", tmp_path)
    monkeypatch.setattr(setup_env, "OTHER_PYTHONS", {"blender-5.2": (3, 99)})
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    assert setup_env.ensure_in_turn(["blender-5.2"]) == []
    check = run_tests.Check("blender-5.2", ".venv-5.2", (), 60.0)
    (case,), _ = run_tests.run(check)
    assert case.outcome == "skipped"
    assert "Install python3.99 and python3.99-venv" in case.reason
    assert merge_summary.read_cases(tmp_path / "blender-5.2.xml") == [case]


@pytest.mark.parametrize(("name", "errors"), [("blender-5.2", 0), ("blender-4.5", 1)])
def test_only_a_set_of_another_python_may_fail(
    name: str, errors: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_name: str) -> None:
        raise subprocess.CalledProcessError(1, ["pip", "install"])

    monkeypatch.setattr(setup_env, "ROOT", tmp_path)
    monkeypatch.setattr(setup_env, "ensure_environment", fail)
    assert len(setup_env.ensure_in_turn([name])) == errors
    assert setup_env.get_reason_path(setup_env.FOLDERS[name]).is_file() == (errors == 0)


def test_what_a_file_says_of_itself_comes_before_the_totals(tmp_path: Path) -> None:
    path = tmp_path / "app.xml"
    path.write_text(
        '<testsuites><testsuite time="1.5"><properties><property name="blender" value="5.2.2 LTS"/>'
        '<property name="hypothesis-statistics-a.py::b" value="AAAA"/></properties>'
        '<testcase classname="a" name="b"/></testsuite></testsuites>',
        encoding="utf-8",
    )
    lines = merge_summary.format_summary(
        merge_summary.read_cases(path), 1.5, merge_summary.read_properties(path)
    ).splitlines()
    assert lines[1:] == ["app: blender 5.2.2 LTS", "==== 1 passed in 1.50s ===="]
