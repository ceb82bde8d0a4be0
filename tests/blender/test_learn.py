"""Materials learned in a Python outside Blender: checks of that Python, and results of a training job."""

from __future__ import annotations

import importlib.util
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from job_scene import LIMIT_S, PLATE, finish, is_gone, kill, my_folders, small_scene
from panel_recorder import Recorder, context_of, rna_of
from touch_scene import place_data

from hnf_blender.bridge.scene.material_definition import get_artist_choice, set_definition
from hnf_blender.jobs import bake_job, manager
from hnf_blender.jobs.child_job import is_process_alive
from hnf_blender.jobs.learn_job import LearnJob, MaterialSlot, assign_to_slot, check_python, make_weights_path
from hnf_blender.ops import learn_ops as python_ops
from hnf_blender.ops.diagnose_ops import collect_diagnosis
from hnf_blender.ops.learn_ops import LAST_CHOICES, HNF_OT_learn, HNF_OT_learn_run
from hnf_blender.prefs import HnfPreferences, draw_external_python
from hnf_blender.preview.stroke_image import ImageStyle
from hnf_blender.preview.synthesis_thread import RenderCache, read_current_bake, synthesise_preview
from hnf_blender.state.addon_settings import Settings, get_learned_folder
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.stroke_bake import load_bake
from hnf_blender.ui.materials_panel import draw_learn
from hnf_core.datasets.registry import LICENCES
from hnf_core.field.synthesis import synthesise_by_field
from hnf_core.field.weights import load_field, read_trained_material
from hnf_core.material.hnf_file import from_library, read_hnf
from hnf_core.material.library import get_material
from hnf_core.training.learn import STAGE_GATHERING, LearnRequest

pytestmark = pytest.mark.usefixtures("operators")
NO_TORCH = importlib.util.find_spec("torch") is None
NAME = "CoarseMesh"
WIDEST = 55
"""Characters of a line that fit into the dialog; Blender cuts the middle out of longer ones."""


@pytest.fixture
def learned(tmp_path, monkeypatch) -> Path:
    """Where learned materials go."""
    place_data(monkeypatch, tmp_path / "data")
    folder = get_learned_folder()
    yield folder
    STATE.external_python = None
    LAST_CHOICES.clear()


@pytest.fixture
def name_python(monkeypatch):
    """What an artist types into the preferences."""

    def named(path: object) -> None:
        monkeypatch.setattr(python_ops, "get_settings", lambda: Settings(external_python=str(path)))

    return named


def program(path: Path, script: str) -> str:
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def lesson_of(folder: Path, epochs: int = 3) -> LearnRequest:
    """Three seconds of noise, as somebody wrote them down."""
    path = folder / "mine" / NAME / "one.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    time, noise = np.arange(30_000) / 1e4, np.random.default_rng(3).standard_normal(30_000)
    rows = np.stack([time, noise, 1.0 + 0.5 * np.sin(3.0 * time)], axis=1)
    np.savetxt(path, rows, "%.5g", ",", header="time [s],acceleration [m/s^2],force [N]", comments="")
    return LearnRequest("own", str(folder / "mine"), NAME, 5.0, epochs)


def begin(lesson: LearnRequest, python: str = sys.executable) -> LearnJob:
    return manager.start_job(lambda: LearnJob(python, lesson, MaterialSlot(PLATE, 0)))


def reach(stage: str, done: int) -> int:
    """Tick until so many steps of a stage are done; how many that are."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        assert manager.tick() is None, STATE.last_job
        if STATE.job is not None and STATE.job.stage == stage and STATE.job.done >= done:
            return STATE.job.done
        time.sleep(0.005)
    raise AssertionError(f"not reached: {STATE.job}")


def test_a_python_that_lacks_something_is_told_what_to_type(tmp_path) -> None:
    bare = program(tmp_path / "bare", f'exec "{sys.executable}" -S -I "$@"')
    found = check_python(bare)
    assert found.version == ".".join(map(str, sys.version_info[:3]))
    assert found.missing == ("numpy", "safetensors", "soxr", "torch")
    assert found.problem == "It lacks numpy, safetensors, soxr, torch"
    assert found.command.startswith(f'"{bare}" -m pip install "numpy>=')
    assert '"torch==' in found.command


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("echo Hello", "It is not a Python"),
        ('echo \'@hnf python {"version": "x"}\'', "It is not a Python"),
        ('echo \'@hnf python {"version": [3, 9, 1], "found": {"numpy": "1", "safetensors": "", "soxr": "", '
         '"torch": ""}}\'',
         "It is Python 3.9.1, and 3.11 or newer is needed"),
    ],
)  # fmt: skip
def test_what_cannot_learn_is_said(tmp_path, script, problem) -> None:
    found = check_python(program(tmp_path / "other", script))
    assert (found.problem, found.command) == (problem, "")


def test_what_cannot_be_run_is_said(tmp_path) -> None:
    (tmp_path / "text").write_text("no program")
    assert check_python(str(tmp_path / "none")).problem == "There is no such file"
    assert check_python(str(tmp_path / "text")).problem.startswith("It cannot be started")


def test_an_unresponsive_python_is_ended_with_its_children(tmp_path) -> None:
    noted = tmp_path / "pid"
    found = check_python(program(tmp_path / "slow", f"sleep 60 & echo $! > {noted}; wait"), timeout_s=0.5)
    assert found.problem == "It gave no answer within 0.5 s"
    assert is_gone(int(noted.read_text()))


def test_the_preferences_say_what_was_found_and_diagnose_too(tmp_path, name_python, learned) -> None:
    """Drawing runs nothing: what is shown is what the button found."""
    with pytest.raises(RuntimeError, match="Set an external Python"):
        bpy.ops.hnf.python_check()
    bare = program(tmp_path / "bare", f'exec "{sys.executable}" -S -I "$@"')
    name_python(bare)
    assert "not checked" in dict(collect_diagnosis())["External Python"]
    assert bpy.ops.hnf.python_check() == {"FINISHED"}
    said = Recorder()
    preferences = SimpleNamespace(
        bl_rna=SimpleNamespace(properties=HnfPreferences.__annotations__), external_python=bare
    )  # fmt: skip
    draw_external_python(said, preferences)
    assert "It lacks numpy" in said.words
    assert "-m pip install" in said.words
    assert said.operators == ["hnf.python_check", "hnf.python_copy"]
    assert "It lacks numpy" in dict(collect_diagnosis())["External Python"]
    preferences.external_python = "/another"
    draw_external_python(again := Recorder(), preferences)
    assert "It lacks" not in again.words
    with pytest.raises(RuntimeError, match="lacks a package"):
        bpy.ops.hnf.learn_run(kind="simulated", library="oak-wood")


def test_the_panel_has_the_button_once_a_python_is_set(name_python) -> None:
    shown = []
    for path in ("", "/anywhere/python"):
        name_python(path)
        draw_learn(layout := Recorder())
        shown.append(layout.operators)
    assert shown == [[], ["hnf.learn"]]


def test_without_a_python_the_button_says_why(lone_bake) -> None:
    with pytest.raises(RuntimeError, match="Set an external Python"):
        bpy.ops.hnf.learn()


@pytest.mark.parametrize("kind", ["simulated", *sorted(set(LICENCES) - {"simulated"})])
def test_the_dialog_shows_the_licence_of_what_is_learned(kind) -> None:
    said = Recorder()
    HNF_OT_learn.draw(SimpleNamespace(layout=said, kind=kind, bl_rna=rna_of("hnf.learn")), context_of())
    licence = "yours (your own recordings)" if kind == "own" else LICENCES[kind]
    assert f"License: {licence}" in " ".join(said.words.split("\n"))
    assert max(map(len, said.words.split("\n"))) <= WIDEST
    assert ("folder" in said.props) == (kind != "simulated")


@pytest.mark.skipif(NO_TORCH, reason="needs a Python with torch: make env-test")
def test_training_resumes_after_a_cancel_and_assigns_its_result(warm_bake, learned, tmp_path) -> None:
    """Esc leaves the checkpoint and nothing else; the second run ends with the material in the slot; the stroke over it
    is what the field of that material says, from the bake and from the preview alike."""
    plate, stroke = small_scene()
    lesson = lesson_of(tmp_path)
    pid = begin(lesson).pid
    assert len(my_folders()) == 1
    done = reach("epoch", 1)
    assert manager.cancel()
    assert is_gone(pid)
    assert STATE.job is None
    assert "with the same choices to resume" in STATE.last_job.message
    assert {path.suffix for path in learned.iterdir()} == {".checkpoint"}
    assert get_artist_choice(plate.active_material) == ""

    again = begin(lesson)
    reach("epoch", done + 1)
    ended = finish(again)
    assert ended.ok, ended
    assert (ended.written, ended.details[0]) == (1, LICENCES["own"])
    assert "no speed was recorded: 0.1 m/s assumed" in ended.details[1]
    assert [path.name for path in learned.iterdir()] == [f"{NAME} (own).hnf"]
    material = get_artist_choice(plate.active_material)
    assert material == read_hnf(learned / f"{NAME} (own).hnf")
    assert (material.name, material.licence) == (NAME, LICENCES["own"])

    assert bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer).ok
    bake = load_bake(stroke)
    assert {read_trained_material(field, "").name for field in bake.stroke.fields} == {NAME}
    assert any("its shader's relief is not felt" in note for note in bake.notes)
    wanted = synthesise_by_field(load_field(), bake.stroke, seed=bake.seed).signal.samples
    shared = synthesise_by_field(load_field(), replace(bake.stroke, fields=()), seed=bake.seed).signal.samples
    heard = synthesise_preview(read_current_bake(stroke, bpy.context.scene), ImageStyle(), RenderCache()).signal
    assert heard.samples.tobytes() == wanted.tobytes()
    assert not np.array_equal(wanted, shared)
    assert float(np.abs(wanted).max()) > 0.0


def test_a_killed_lesson_is_told(lone_bake, learned, tmp_path) -> None:
    """While recordings are gathered: of the simulator, which takes its time."""
    small_scene()
    job = begin(LearnRequest("simulated", "", "oak-wood", 60.0, 1))
    reach(STAGE_GATHERING, 0)
    kill(job.pid)
    ended = finish(job)
    assert not ended.ok
    assert "killed (signal 9)" in ended.message
    assert "same choices" in ended.message
    assert list(learned.iterdir()) == []


@pytest.mark.parametrize(
    ("lesson", "said"),
    [
        (LearnRequest("simulated", "", "unobtainium", 5.0, 1), "unobtainium"),
        (LearnRequest("hatt", "/nowhere", "ABS Plastic", 5.0, 1), "/nowhere"),
        (LearnRequest("own", str(Path(__file__).parent), "felt", 5.0, 1), "no CSV table"),
    ],
)
def test_a_lesson_that_cannot_be_is_told_in_its_own_words(lone_bake, learned, name_python, lesson, said) -> None:
    small_scene()
    ended = finish(begin(lesson))
    assert not ended.ok
    assert said in ended.message
    assert list(learned.iterdir()) == []


def test_a_python_that_is_none_leaves_nothing(lone_bake, learned, tmp_path, name_python) -> None:
    name_python(tmp_path / "gone")
    with pytest.raises(RuntimeError, match=r"the external Python could not be started.*preferences"):
        bpy.ops.hnf.learn_run(kind="simulated", library="oak-wood")
    with pytest.raises(RuntimeError, match="No folder is chosen"):
        bpy.ops.hnf.learn_run(kind="hatt", name="ABS Plastic")
    assert my_folders() == []
    assert manager.cancel() is False


def test_the_dialog_tells_what_is_missing_and_no_traceback(lone_bake, learned, tmp_path, name_python, capfd) -> None:
    name_python(tmp_path / "gone")
    with pytest.raises(RuntimeError, match="No folder is chosen") as missing:
        bpy.ops.hnf.learn(kind="hatt", name="ABS Plastic")
    with pytest.raises(RuntimeError, match="the external Python could not be started") as gone:
        bpy.ops.hnf.learn(kind="simulated", library="oak-wood")
    assert not any("Traceback" in str(told.value) for told in (missing, gone))
    assert "Traceback" not in capfd.readouterr().err


def test_the_dialog_opens_with_what_was_asked_for_last(lone_bake, learned, tmp_path, name_python) -> None:
    """What a script names goes before it."""
    name_python(tmp_path / "gone")
    with pytest.raises(RuntimeError):
        bpy.ops.hnf.learn(kind="lmt", name=NAME, effort="QUICK")
    operator = SimpleNamespace(properties=SimpleNamespace(is_property_set=lambda name: name == "name"), name="Wood")
    context = SimpleNamespace(window_manager=SimpleNamespace(invoke_props_dialog=lambda *_, **__: {"RUNNING_MODAL"}))
    assert HNF_OT_learn.invoke(operator, context, None) == {"RUNNING_MODAL"}
    assert (operator.kind, operator.effort, operator.name) == ("lmt", "QUICK", "Wood")


def test_a_lessons_parent_that_dies_takes_it_along(tmp_path) -> None:
    """Its standard input ends."""
    import subprocess

    from hnf_blender.jobs.child_job import make_python_command
    from hnf_core.json_io import encode_json

    lesson = encode_json(LearnRequest("simulated", "", "oak-wood", 60.0, 1))
    words = make_python_command("learn", lesson, str(tmp_path / "out"))
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdin is not None
    while b"gathering" not in process.stdout.readline():
        assert process.poll() is None
    process.stdin.close()
    assert process.wait(timeout=20.0) == 3
    process.stdout.close()
    assert not is_process_alive(process.pid)


def test_a_slot_with_a_choice_is_not_overwritten_by_training(tmp_path) -> None:
    plate, _ = small_scene()
    made, kept = from_library(get_material("slate")), tmp_path / "kept.hnf"
    for said in ("library", "definition"):
        material = plate.active_material
        if said == "library":
            material.hnf_touch.library = "oak-wood"
        else:
            set_definition(material, from_library(get_material("oak-wood")))
        text = assign_to_slot(made, MaterialSlot(PLATE, 0), kept)
        assert str(kept) in text
        offered = next(each for each in bpy.data.materials if each.use_fake_user)
        assert get_artist_choice(offered) == made
        assert plate.active_material == material
        bpy.data.materials.remove(offered)
    for nowhere in (MaterialSlot(), MaterialSlot("Gone"), MaterialSlot(PLATE, 7)):
        assign_to_slot(made, nowhere, kept)
        assert get_artist_choice(plate.active_material) != made
    plate.active_material = None
    assert PLATE in assign_to_slot(made, MaterialSlot(PLATE, 0), kept)
    assert get_artist_choice(plate.active_material) == made


def test_equal_choices_meet_at_one_place_and_others_elsewhere(learned) -> None:
    lesson = LearnRequest("hatt", "/data", "ABS Plastic", 480.0, 40)
    assert make_weights_path(lesson) == make_weights_path(replace(lesson))
    assert (
        len({make_weights_path(each) for each in (lesson, replace(lesson, epochs=41), replace(lesson, kind="lmt"))})
        == 3
    )


def test_nothing_is_half_undone() -> None:
    """One undo step, made when the material is given; the dialog that asks makes none."""
    assert "UNDO" in HNF_OT_learn_run.bl_options
    assert not getattr(HNF_OT_learn, "bl_options", set())
