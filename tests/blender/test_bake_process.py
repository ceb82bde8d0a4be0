"""The process of a bake that waits for the next one: the bytes of a fresh one, and every way in which it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material
from job_scene import (
    NOTHING,
    PLATE,
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
from touch_scene import ridge_plate

from hnf_blender import handlers, jobs
from hnf_blender.jobs import bake_job, bake_process, manager
from hnf_blender.jobs.child_job import (
    PROCESS_FOLDER_PREFIX,
    ChildProgram,
    Failed,
    Finished,
    get_job_root,
    remove_abandoned_folders,
)
from hnf_blender.jobs.worker import NOTHING_TAKEN
from hnf_core import child_process
from hnf_core.touch_request import TouchQuery


def waiting() -> int:
    """The process that waits."""
    process = bake_process.get_process()
    assert process is not None
    return process.pid


def until_ended() -> int:
    """The exit code of the process that waits, once it has ended by itself."""
    process, until = bake_process._waiting_process, time.monotonic() + 30.0
    while process.exit_code() is None and time.monotonic() < until:
        time.sleep(0.01)
    return process.exit_code()


def baked_from(path: Path, *, fresh: bool) -> dict:
    """What a bake of a file keeps, by a new process or by the one that waits."""
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    if fresh:
        manager.close()
    assert (bake_process.get_process() is None) == fresh
    ended = bake()
    assert ended.ok, ended
    return kept()


def pictured_plate(path: Path, height: float) -> None:
    """A plate whose relief is a picture on the disk, with a stroke on it."""
    write_waves(path, height)
    plate = add_plane(PLATE, 0.12)
    material = bump_material("Pictured")
    plate.data.materials.append(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    picture, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
    picture.image = bpy.data.images.load(str(path))
    picture.image.colorspace_settings.name = "Non-Color"
    bump.inputs["Distance"].default_value = 1e-4
    links.new(picture.outputs["Color"], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    line_stroke("Pictured", surface=plate, length=0.01)


def write_waves(path: Path, height: float) -> None:
    image = bpy.data.images.new("waves", 512, 512, is_data=True)
    values = 0.5 + 0.5 * height * np.sin(np.arange(512) * 0.7)
    pixels = np.ones((512, 512, 4), dtype=np.float32)
    pixels[..., :3] = values[None, :, None]
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


@pytest.fixture
def two_files(tmp_path, lone_bake) -> tuple[Path, Path]:
    """Two files that share all names: one in another unit, with another surface, and on another frame."""
    paths = tmp_path / "one.blend", tmp_path / "other.blend"
    small_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(paths[0]))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plate = ridge_plate(height=20e-6)
    plate.data.materials[0].name = "Oak wood"
    plate.scale = (1.0, 1.3, 1.0)
    line_stroke("Along", surface=plate, along=(0.6, 0.8, 0.0), force=2.0, seed=3)
    pictured_plate(tmp_path / "waves.png", 1.0)
    bpy.context.scene.frame_set(17)
    bpy.context.scene.render.fps = 30
    bpy.ops.wm.save_as_mainfile(filepath=str(paths[1]))
    return paths


def test_a_warm_process_gives_the_bytes_of_fresh_ones(two_files, tmp_path, monkeypatch) -> None:
    """Two files in turn, the same one twice, each with an empty cache, and one whose picture changed on the disk."""
    rounds = iter(range(100))

    def anew(path: Path, *, fresh: bool) -> dict:
        # Folders of equal conditions: a cache that is empty again, in the place where it was.
        cache = bake_job.get_cache_folder()
        if cache.is_dir():
            cache.rename(tmp_path / f"old cache {next(rounds)}")
        return baked_from(path, fresh=fresh)

    one, other = two_files
    fresh = {path: anew(path, fresh=True) for path in two_files}
    assert fresh[one] != fresh[other]
    assert sorted(fresh[other]["bakes"]) == ["Along", "Pictured"]
    pid = waiting()
    for path in (one, other, other, one):
        assert anew(path, fresh=False) == fresh[path]
    assert waiting() == pid
    write_waves(tmp_path / "waves.png", 0.3)
    changed = anew(other, fresh=False)
    assert waiting() == pid
    assert changed["bakes"]["Pictured"] != fresh[other]["bakes"]["Pictured"]
    assert changed["bakes"]["Along"] == fresh[other]["bakes"]["Along"]
    assert anew(other, fresh=True) == changed


def test_one_process_does_bakes_and_queries(warm_bake) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pid = waiting()
    assert len(my_folders(PROCESS_FOLDER_PREFIX)) == 1
    assert my_folders() == []
    stroke.hnf_stroke.seed = 5
    again = start()
    assert again.pid == pid
    assert bake_process.get_process() is None  # it works, so that it does not wait
    assert finish(again).ok
    query = manager.start_bake(bpy.context.scene, bpy.context.view_layer, (), TouchQuery(PLATE, (0.0, 0.0)))
    assert query.pid == pid
    assert finish(query).ok
    assert waiting() == pid
    assert my_folders() == []


def test_it_ends_with_the_file_and_with_the_add_on(warm_bake) -> None:
    small_scene()
    for end in (handlers.on_load_pre, jobs.unregister):
        bpy.data.objects["Along"].hnf_stroke.seed += 1
        assert bake().ok
        pid = waiting()
        end()
        assert bake_process.get_process() is None
        assert is_gone(pid)
        assert my_folders(PROCESS_FOLDER_PREFIX) == []


def test_it_ends_by_itself_and_another_follows(warm_bake, monkeypatch) -> None:
    """After a while without a job, or with too much in its memory."""
    _, stroke = small_scene()
    for name, value in (("IDLE_S", 0.05), ("MAX_MEMORY_BYTES", 1e6)):
        with monkeypatch.context() as patch:
            patch.setattr(bake_process, name, value)
            stroke.hnf_stroke.seed += 1
            assert bake().ok
            assert until_ended() == NOTHING_TAKEN
            assert bake_process.get_process() is None
            assert my_folders(PROCESS_FOLDER_PREFIX) == []
    stroke.hnf_stroke.seed += 1
    assert bake().ok
    assert waiting()


def test_a_job_given_to_one_just_ending_is_done_by_another(warm_bake, monkeypatch) -> None:
    _, stroke = small_scene()
    monkeypatch.setattr(bake_process, "MAX_MEMORY_BYTES", 1e6)
    assert bake().ok
    until_ended()
    ended, before = bake_process.take_process(), kept()
    # As if it had been written to just before it looked at its memory.
    begin = [lambda folder, _: (ended.begin(folder), ended)[1], bake_job.begin_job]
    monkeypatch.setattr(bake_job, "begin_job", lambda *arguments: begin.pop(0)(*arguments))
    stroke.hnf_stroke.seed = 2
    job = start()
    assert job.pid == ended.pid
    assert finish(job).ok
    assert kept() != before


def test_one_that_died_while_it_waited_is_replaced(warm_bake) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pid = waiting()
    kill(pid)
    assert is_gone(pid)
    stroke.hnf_stroke.seed = 2
    assert bake().ok
    assert waiting() != pid
    assert len(my_folders(PROCESS_FOLDER_PREFIX)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="it stops a process")
def test_one_that_dies_before_it_begins_is_replaced(warm_bake) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pid, before = waiting(), kept()
    os.kill(pid, signal.SIGSTOP)  # so that it does not begin
    stroke.hnf_stroke.seed = 2
    job = start()
    assert job.pid == pid
    kill(pid)
    assert finish(job).ok
    assert kept() != before
    assert waiting() != pid


def test_one_that_dies_at_its_second_job_is_told_and_replaced(warm_bake) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pid, before = waiting(), kept()
    stroke.hnf_stroke.seed = 2
    job = start()
    assert job.pid == pid
    assert reach("Along")
    kill(pid)
    ended = finish(job)
    assert "killed (signal 9)" in ended.message
    assert kept() == before
    assert my_folders() == my_folders(PROCESS_FOLDER_PREFIX) == []
    assert bake().ok
    assert waiting() != pid


def test_one_whose_job_failed_or_was_cancelled_is_replaced(warm_bake, monkeypatch) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pid = waiting()
    stroke.hnf_stroke.seed = 2
    with monkeypatch.context() as patch:
        patch.setattr(bake_job, "save_copy", lambda path: path.write_bytes(b"BLENDER-v500 and then nothing"))
        assert not bake().ok
    assert is_gone(pid)
    assert bake().ok
    pid = waiting()
    stroke.hnf_stroke.seed = 3
    job = start()
    assert reach("opening")
    manager.cancel()
    assert is_gone(pid)
    assert job.pid is None
    assert bake_process.get_process() is None
    assert my_folders() == my_folders(PROCESS_FOLDER_PREFIX) == []


def test_one_whose_results_were_refused_is_ended(warm_bake) -> None:
    """Cancelled after its last word, while the window compares."""
    small_scene()
    job = start()
    pid = job.pid
    while not job.is_committing:
        assert manager.tick() is None
    assert waiting() == pid
    manager.cancel()
    assert is_gone(pid)
    assert kept() == NOTHING
    assert bake_process.get_process() is None


def test_other_conditions_need_another_process(warm_bake, tmp_path, monkeypatch) -> None:
    _, stroke = small_scene()
    assert bake().ok
    pids = [waiting()]

    def bake_again() -> int:
        stroke.hnf_stroke.seed += 1
        assert bake().ok
        pids.append(waiting())
        return pids[-1]

    assert bake_again() == pids[0]
    monkeypatch.setenv("HNF_TEST_OF_CONDITIONS", "1")
    assert bake_again() != pids[-2]
    assert is_gone(pids[-2])
    cache = tmp_path / "another cache"
    bake_job.get_cache_folder().rename(cache)
    monkeypatch.setattr(bake_job, "get_cache_folder", lambda: cache)
    assert bake_again() != pids[-2]
    files = bpy.context.preferences.filepaths
    monkeypatch.setattr(files, "use_scripts_auto_execute", not files.use_scripts_auto_execute)
    assert bake_again() != pids[-2]


def test_a_changed_add_on_is_another_condition(tmp_path) -> None:
    def listed() -> list:
        return sorted(bake_process._list_files(str(tmp_path)))

    (tmp_path / "sub").mkdir()
    (tmp_path / "__pycache__").mkdir()
    module = tmp_path / "sub" / "module.py"
    module.write_text("one = 1\n")
    first = listed()
    assert [Path(path) for path, _, _ in first] == [module]
    (tmp_path / "__pycache__" / "module.pyc").write_bytes(b"compiled")
    assert listed() == first
    module.write_text("one = 2\n")
    os.utime(module, ns=(1, 1))
    assert listed() != first


def test_scripts_of_a_file_end_it(warm_bake, monkeypatch) -> None:
    """What they left in Python would be there for the next job."""
    monkeypatch.setattr(bpy.context.preferences.filepaths, "use_scripts_auto_execute", True)
    _, stroke = small_scene()
    bpy.data.texts.new("notes.py").write("import bpy")
    assert bake().ok
    assert waiting()
    stroke.hnf_stroke.seed = 2
    bpy.data.texts[0].use_module = True
    assert bake().ok
    assert until_ended() == NOTHING_TAKEN


def test_one_that_waits_ends_with_its_parent(tmp_path, monkeypatch) -> None:
    root = tmp_path / "temporary"
    root.mkdir()
    monkeypatch.setenv("TMPDIR", str(root))
    monkeypatch.setattr(tempfile, "tempdir", None)
    script = Path(__file__).with_name("die_while_baking.py")
    command = [sys.executable, str(script), str(tmp_path), "waiting"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    words = done.stdout.split()
    assert "CHILD" in words, done.stdout + done.stderr
    assert is_gone(int(words[words.index("CHILD") + 1]))
    parent = words[words.index("PARENT") + 1]
    left = list(get_job_root().glob("hnf-*"))
    assert [each.name.split("-")[:3] for each in left] == [["hnf", "process", parent]]
    assert remove_abandoned_folders() == left
    assert not list(get_job_root().glob("hnf-*"))


HASTE = """
import select, sys, time
sys.stdin.readline()
print('@hnf Finished {}', flush=True)
time.sleep(0.5)
is_early = bool(select.select([0], [], [], 0)[0])
print('@hnf Waiting {}', flush=True)
sys.stdin.readline()
print('@hnf Failed {"why": "%s"}' % is_early, flush=True)
time.sleep(60)
"""
"""A process that takes a while to close its file, and looks whether a line came meanwhile."""


@pytest.mark.skipif(sys.platform == "win32", reason="select knows no pipes there")
def test_nothing_is_written_before_it_waits(lone_bake, tmp_path, monkeypatch) -> None:
    """A line would wake a thread of Python's beside Blender's operator."""
    program = ChildProgram([sys.executable, "-c", HASTE], "a process", "")
    monkeypatch.setattr(bake_process, "make_blender_program", lambda *_: program)
    small_scene()
    prepared = bake_job.prepare_job(bpy.context.scene, bpy.context.view_layer)
    process = bake_process.BakeProcess(bake_process.find_conditions(prepared.request))

    def next_message():
        until = time.monotonic() + 30.0
        while time.monotonic() < until:
            for message in process.messages():
                return message
            time.sleep(0.01)
        return None

    try:
        for expected in (Finished(), Failed("False")):
            assert process.begin(prepared.folder)
            assert next_message() == expected
    finally:
        process.end(prepared.folder)


def test_lines_are_whole_however_they_arrive(monkeypatch) -> None:
    import threading

    parts, lines, ended = [b'"a', b'b"\n"c"\n"', "ä".encode()[:1], "ä".encode()[1:] + b'"\n"cut', b""], [], []
    left = threading.Event()
    monkeypatch.setattr(os, "read", lambda *_: parts.pop(0))
    monkeypatch.setattr(os, "_exit", lambda code: (ended.append(code), left.set()))
    child_process.exit_with_parent(on_line=lines.append)
    assert left.wait(30.0)
    assert lines == ['"ab"', '"c"', '"ä"']
    assert ended == [child_process.EXIT_PARENT_GONE]


def test_memory_is_this_process_own() -> None:
    before = child_process.measure_memory()
    assert 1e7 < before < 1e11
    block = np.ones(20_000_000)
    assert child_process.measure_memory() > before + 0.5 * block.nbytes
