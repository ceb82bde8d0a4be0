"""Bakes in a child process: the same bytes as in line, and whatever is stopped or killed leaves nothing behind."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from job_scene import (
    NOTHING,
    bake,
    finish,
    is_gone,
    kept,
    kill,
    line_stroke,
    my_folders,
    reach,
    small_scene,
    start,
)

from hnf_blender.jobs import current, running
from hnf_blender.jobs.folder import PREFIX, is_alive, job_root, remove_abandoned
from hnf_blender.state.session import STATE

STAGES = ("starting", "opening", "reading", "Along", "Along: synthesis", "saving")


@pytest.fixture(autouse=True)
def alone(operators, tmp_path, monkeypatch):
    """A cache of its own, and nothing running before or after."""
    monkeypatch.setattr(running, "cache_folder", lambda: tmp_path / "cache")
    STATE.clear()
    yield
    current.cancel()
    assert my_folders() == []


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """The close-ups of small_scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder = tmp_path_factory.mktemp("rendered")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "cache_folder", lambda: folder)
        small_scene()
        running.bake_in_line(bpy.context.scene, bpy.context.view_layer)
    return folder


@pytest.fixture
def warm(rendered, tmp_path):
    """Close-ups of the small scene are there already: what is tested starts after them."""
    shutil.copytree(rendered, tmp_path / "cache")


def test_the_child_and_its_twin_in_line_give_equal_bytes(tmp_path) -> None:
    plate, _ = small_scene()
    line_stroke("Beside", surface=plate, centre=(0.0, 0.02, 0.0), force=2.0)
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    in_line = kept()
    assert sorted(in_line["bakes"]) == ["Along", "Beside"]
    assert list(in_line["tokens"]) == ["Plate"]
    assert bpy.ops.hnf.purge(what="ALL") == {"FINISHED"}
    assert kept() == NOTHING
    shutil.rmtree(tmp_path / "cache")
    ended = bake()
    assert ended.ok
    assert "4 close-ups" in ended.message
    assert kept() == in_line


def test_what_is_fresh_is_not_baked_again(warm) -> None:
    small_scene()
    first = bake()
    assert first.ok
    assert "close-up" not in first.message
    before = kept()
    again = bake()
    assert (again.ok, again.written) == (True, 0)
    assert "1 fresh already" in again.message
    assert kept() == before


def test_unsaved_changes_are_baked_and_the_open_file_stays_what_it_is(tmp_path, warm) -> None:
    _, stroke = small_scene()
    scene = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    stroke.hnf_stroke.seed = 7
    ended = bake()
    assert ended.ok
    assert bpy.data.filepath == str(scene)
    assert bpy.data.objects["Along"].hnf_stroke.seed == 7
    assert STATE.strokes["Along"].freshness.name == "FRESH"


@pytest.mark.parametrize("stage", STAGES)
def test_a_killed_child_is_told_and_costs_nothing(stage, warm) -> None:
    small_scene()
    running_now = start()
    assert reach(stage)
    if running_now.pid is not None:
        kill(running_now.pid)
    ended = finish(running_now)
    assert not current.is_running()
    assert STATE.job is None
    assert STATE.last_job == ended
    if ended.ok:  # it had said its last word before it was hit
        assert stage == "saving"
        assert list(kept()["bakes"]) == ["Along"]
        return
    assert "killed (signal 9)" in ended.message
    assert "Bake again" in ended.message
    assert kept() == NOTHING
    assert my_folders() == []


@pytest.mark.parametrize("stage", STAGES)
def test_a_cancelled_bake_leaves_neither_process_nor_folder(stage, warm) -> None:
    small_scene()
    pid = start().pid
    assert reach(stage)
    assert len(my_folders()) == 1
    assert bpy.ops.hnf.bake_cancel() == {"FINISHED"}
    assert my_folders() == []
    assert is_gone(pid)
    assert STATE.job is None
    assert "cancelled" in STATE.last_job.message
    assert kept() == NOTHING
    assert current.tick() is None


def test_one_bake_at_a_time() -> None:
    small_scene()
    start()
    with pytest.raises(RuntimeError, match="A bake is running"):
        bpy.ops.hnf.bake()
    current.cancel()
    with pytest.raises(RuntimeError, match="No bake is running"):
        bpy.ops.hnf.bake_cancel()


def test_without_strokes_the_button_says_what_to_do() -> None:
    for operator in (bpy.ops.hnf.bake, bpy.ops.hnf.plan):
        with pytest.raises(RuntimeError, match="has no stroke yet"):
            operator()


def test_the_child_of_a_dead_parent_ends_and_its_folder_is_found(tmp_path) -> None:
    script = Path(__file__).with_name("die_while_baking.py")
    done = subprocess.run([sys.executable, str(script), str(tmp_path)], capture_output=True, text=True, timeout=120)
    words = done.stdout.split()
    assert "CHILD" in words, done.stdout + done.stderr
    pid = int(words[words.index("CHILD") + 1])
    parent = int(words[words.index("PARENT") + 1])
    assert is_gone(pid)
    assert not is_alive(parent)
    assert remove_abandoned()
    assert not list(job_root().glob(f"{PREFIX}{parent}-*"))


def test_a_copy_that_cannot_be_opened_is_told(monkeypatch, warm) -> None:
    small_scene()
    monkeypatch.setattr(running, "save_copy", lambda path: path.write_bytes(b"BLENDER-v500 and then nothing"))
    ended = bake()
    assert not ended.ok
    assert kept() == NOTHING
