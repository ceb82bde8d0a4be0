"""Killed child processes at every stage, and a killed parent."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from job_scene import NOTHING, STAGES, finish, is_gone, kept, kill, my_folders, reach, small_scene, start

from hnf_blender.jobs import manager
from hnf_blender.jobs.child_job import get_job_root, is_process_alive, remove_abandoned_folders
from hnf_blender.state.session_state import STATE


@pytest.mark.parametrize("stage", STAGES)
def test_a_killed_child_is_told_and_costs_nothing(stage, warm_bake) -> None:
    for _ in range(5):
        small_scene()
        running_now = start()
        assert reach(stage)
        if running_now.pid is not None:
            kill(running_now.pid)
        ended = finish(running_now)
        assert not manager.is_running()
        assert STATE.job is None
        assert STATE.last_job == ended
        if not ended.ok:
            break
        assert list(kept()["bakes"]) == ["Along"]  # it had said its last word before it was hit
        if stage == "saving":
            return
    assert "killed (signal 9)" in ended.message
    assert "Bake again" in ended.message
    assert kept() == NOTHING
    assert my_folders() == []


def test_the_child_of_a_dead_parent_ends_and_its_folder_is_found(tmp_path, monkeypatch) -> None:
    root = tmp_path / "temporary"  # of its own: another process of these tests may clear the common one away first
    root.mkdir()
    monkeypatch.setenv("TMPDIR", str(root))
    monkeypatch.setattr(tempfile, "tempdir", None)
    script = Path(__file__).with_name("die_while_baking.py")
    done = subprocess.run([sys.executable, str(script), str(tmp_path)], capture_output=True, text=True, timeout=120)
    words = done.stdout.split()
    assert "CHILD" in words, done.stdout + done.stderr
    pid = int(words[words.index("CHILD") + 1])
    parent = int(words[words.index("PARENT") + 1])
    assert is_gone(pid)
    assert not is_process_alive(parent)
    left = sorted(get_job_root().glob("hnf-*"))
    assert [each.name.split("-")[1:3] for each in left] == [["job", str(parent)], ["process", str(parent)]]
    assert remove_abandoned_folders() == left
    assert not list(get_job_root().glob("hnf-*"))


def test_a_killed_touch_leaves_what_the_next_one_removes(tmp_path) -> None:
    """With all of Blender's own session; the next run need not even find its scene."""
    root, scene = tmp_path / "temporary", tmp_path / "plate.obj"
    root.mkdir()
    scene.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    command = [sys.executable, "-c", "import sys; from hnf_blender.cli import main; sys.exit(main(sys.argv[1:]))"]
    environment = {**os.environ, "TMPDIR": str(root)}
    words = [*command, "touch", str(scene), "--out", str(tmp_path / "out")]
    running = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        limit = time.monotonic() + 100.0
        while not list(root.glob(f"hnf-touch-{running.pid}-*/*")) and time.monotonic() < limit:
            assert running.poll() is None, "it ended before it was killed"
            time.sleep(0.01)
    finally:
        running.kill()
        running.wait()
    (left,) = root.iterdir()
    assert list(left.iterdir())
    words = [*command, "touch", str(tmp_path / "missing.obj"), "--out", str(tmp_path / "out")]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=100)
    assert done.returncode == 1
    assert "no such file" in done.stderr
    assert list(root.iterdir()) == []


def test_a_job_is_cleaned_up_when_no_thread_can_start(warm_bake, monkeypatch) -> None:
    """Python 3.12 and later begin none while they end, which is when Blender quits."""
    import threading

    small_scene()
    pid = start().pid

    def refused(_):
        raise RuntimeError("can't create new thread at interpreter shutdown")

    monkeypatch.setattr(threading.Thread, "start", refused)
    assert manager.cancel()
    monkeypatch.undo()
    assert is_gone(pid)
    assert my_folders() == []
