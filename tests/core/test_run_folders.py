"""Temporary folders: those of killed processes go with the next run, whatever started them, and nothing else does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from hnf_core.files import is_process_alive, make_run_folder, remove_dead_folders

HOLD = """
import sys, time
from hnf_core.files import make_run_folder
folder = make_run_folder(sys.argv[1])
open(folder.name + "/work", "w").write("half done")
print(folder.name, flush=True)
time.sleep(60)
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder of the system, of its own."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


@pytest.fixture
def holders():
    """Start processes that hold a folder of a kind; all end with the test."""
    started: list[subprocess.Popen] = []

    def start(kind: str) -> tuple[subprocess.Popen, Path]:
        words = [sys.executable, "-c", HOLD, kind]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        started.append(process)
        return process, Path(process.stdout.readline().strip())

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_what_a_killed_process_left_goes_with_the_next_run(root, holders, how) -> None:
    killed = [holders(kind) for kind in ("touch", "batch")]
    living, kept = holders("scene")
    for process, folder in killed:
        assert (folder / "work").is_file()
        os.kill(process.pid, how)
        process.wait(timeout=10)
        assert folder.is_dir()
    with make_run_folder("virtual") as mine:
        assert sorted(root.iterdir()) == sorted([kept, Path(mine)])
    assert list(root.iterdir()) == [kept]
    assert is_process_alive(living.pid)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="only /proc tells a zombie")
def test_a_process_whose_parent_has_not_looked_is_dead(root, holders) -> None:
    process, folder = holders("touch")
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # still a zombie
    assert not is_process_alive(process.pid)
    assert remove_dead_folders() == [folder]


def test_only_folders_of_dead_processes_of_ours_are_removed(root, tmp_path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    others = [
        "hnf-notes",
        f"hnf-{gone.pid}",
        f"other-touch-{gone.pid}-x",
        f"hnf-touch-{os.getpid()}-x",
        "hnf-touch-x-1",
    ]
    for name in others:
        (root / name).mkdir()
    target = tmp_path / "precious"
    target.mkdir()
    (target / "file").write_text("mine")
    if sys.platform != "win32":
        (root / f"hnf-touch-{gone.pid}-link").symlink_to(target)
    (root / f"hnf-touch-{gone.pid}-full").mkdir()
    (root / f"hnf-touch-{gone.pid}-full" / "deep").mkdir()
    remove_dead_folders()
    assert {each.name for each in root.iterdir()} - {f"hnf-touch-{gone.pid}-link"} == set(others)
    assert (target / "file").read_text() == "mine"
