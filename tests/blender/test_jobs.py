"""Bakes in a child process: the bytes of an in-line bake, and cleanup after a stop or a kill."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import bpy
import pytest
from job_scene import (
    NOTHING,
    bake,
    kept,
    line_stroke,
    reach,
    small_scene,
    start,
)

from hnf_blender.jobs import bake_job, manager
from hnf_blender.jobs.child_job import NICENESS
from hnf_blender.state.session_state import STATE

pytestmark = pytest.mark.usefixtures("lone_bake")


def test_the_child_and_its_twin_in_line_give_equal_bytes(lone_bake) -> None:
    plate, _ = small_scene()
    line_stroke("Beside", surface=plate, centre=(0.0, 0.02, 0.0), force=2.0)
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    in_line = kept()
    assert sorted(in_line["bakes"]) == ["Along", "Beside"]
    assert list(in_line["tokens"]) == ["Plate"]
    assert bpy.ops.hnf.purge(what="ALL") == {"FINISHED"}
    assert kept() == NOTHING
    shutil.rmtree(lone_bake)
    ended = bake()
    assert ended.ok
    assert "4 close-ups" in ended.message
    assert kept() == in_line


def test_what_is_fresh_is_not_baked_again(warm_bake) -> None:
    small_scene()
    first = bake()
    assert first.ok
    assert "close-up" not in first.message
    before = kept()
    again = bake()
    assert (again.ok, again.written) == (True, 0)
    assert again.message == "Nothing to bake: 1 stroke already up to date."
    assert kept() == before


def test_a_bake_includes_unsaved_changes_and_keeps_the_open_file(tmp_path, warm_bake) -> None:
    _, stroke = small_scene()
    scene = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    stroke.hnf_stroke.seed = 7
    ended = bake()
    assert ended.ok
    assert bpy.data.filepath == str(scene)
    assert bpy.data.objects["Along"].hnf_stroke.seed == 7
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness.name == "FRESH"


def test_one_bake_at_a_time() -> None:
    small_scene()
    start()
    with pytest.raises(RuntimeError, match="A job is running"):
        bpy.ops.hnf.bake()
    manager.cancel()
    with pytest.raises(RuntimeError, match="No bake is running"):
        bpy.ops.hnf.bake_cancel()


def test_without_strokes_the_button_says_what_to_do() -> None:
    for operator in (bpy.ops.hnf.bake, bpy.ops.hnf.plan):
        with pytest.raises(RuntimeError, match="has no stroke yet"):
            operator()


def test_a_copy_that_cannot_be_opened_is_told(monkeypatch, warm_bake) -> None:
    small_scene()
    monkeypatch.setattr(bake_job, "save_copy", lambda path: path.write_bytes(b"BLENDER-v500 and then nothing"))
    ended = bake()
    assert not ended.ok
    assert kept() == NOTHING


@pytest.mark.skipif(sys.platform != "linux", reason="it reads threads in /proc")
def test_the_child_comes_after_the_window_from_its_first_moment(warm_bake) -> None:
    small_scene()
    child = start().pid
    mine = os.getpriority(os.PRIO_PROCESS, 0)
    assert os.getpriority(os.PRIO_PROCESS, child) == mine + NICENESS
    assert reach("opening")
    every = [os.getpriority(os.PRIO_PROCESS, int(thread.name)) for thread in Path(f"/proc/{child}/task").iterdir()]
    assert every.count(mine + NICENESS) > 0.5 * len(every)  # all, but for one begun in the first microseconds
    manager.cancel()
