"""Edits during a bake: results that are still valid are committed, and the others are reported."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from job_scene import NOTHING, PLATE, kept, line_stroke, small_scene
from touch_scene import save_scene

from hnf_blender.jobs import bake_job
from hnf_blender.jobs.child_job import remove_job_folder
from hnf_blender.jobs.commit import commit_steps
from hnf_blender.jobs.job_runner import run_job
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY
from hnf_core.errors import HnfError


@pytest.fixture
def baked(warm_bake):
    """The plate with strokes "Along" and "Beside", worked on and not yet committed: (result, folder, place)."""
    plate, _ = small_scene()
    line_stroke("Beside", surface=plate, force=2.0)  # the same patches
    yield from worked_on()


def worked_on():
    prepared = bake_job.prepare_job(bpy.context.scene, bpy.context.view_layer)
    yield run_job(prepared.request, prepared.folder), prepared.folder, prepared.target
    remove_job_folder(prepared.folder)


def end(steps):
    while True:
        try:
            next(steps)
        except StopIteration as done:
            return done.value


def strokes_kept() -> list[str]:
    return sorted(kept()["bakes"])


def test_nothing_changed_and_all_is_committed(baked) -> None:
    committed = end(commit_steps(*baked))
    assert committed.refused == []
    assert sorted(committed.strokes) == strokes_kept() == ["Along", "Beside"]
    assert list(kept()["tokens"]) == committed.meshes == [PLATE]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH


def move(stroke) -> None:
    stroke.location.x += 1e-3


def press(stroke) -> None:
    stroke.hnf_stroke.seed += 1


@pytest.mark.parametrize(("change", "word"), [(move, "path"), (press, "force, seed or probe")])
def test_a_changed_stroke_is_said_and_costs_no_other(baked, change, word) -> None:
    change(bpy.data.objects["Along"])
    bpy.context.view_layer.update()
    committed = end(commit_steps(*baked))
    (refusal,) = committed.refused
    assert refusal.what == "Along"
    assert word in refusal.why
    assert strokes_kept() == ["Beside"]
    assert list(kept()["tokens"]) == [PLATE]  # the surface is what it was


def test_a_changed_surface_takes_its_strokes_and_tokens_along(baked) -> None:
    mesh = bpy.data.meshes[PLATE]
    before = tuple(mesh.vertices[0].co)
    mesh.vertices[0].co.z += 0.01
    mesh.update()
    bpy.context.view_layer.update()
    committed = end(commit_steps(*baked))
    assert len(committed.refused) == 3
    assert all("shape" in refusal.why for refusal in committed.refused if refusal.what != PLATE)
    assert kept() == NOTHING
    mesh.vertices[0].co = before  # undone by hand: what counts is how it is, not what happened
    mesh.update()
    bpy.context.view_layer.update()
    assert end(commit_steps(*baked)).refused == []


def test_another_material_chosen_meanwhile(baked) -> None:
    bpy.data.objects[PLATE].active_material.hnf_touch.library = "oak-wood"
    committed = end(commit_steps(*baked))
    assert [refusal.what for refusal in committed.refused] == ["Along", "Beside", PLATE]
    assert "material choice" in committed.refused[0].why
    assert kept() == NOTHING


def test_a_deleted_stroke_is_said(baked) -> None:
    bpy.data.objects.remove(bpy.data.objects["Along"])
    committed = end(commit_steps(*baked))
    (refusal,) = committed.refused
    assert "deleted" in refusal.why
    assert strokes_kept() == ["Beside"]


def test_a_commit_follows_a_renamed_stroke_and_not_its_name(baked) -> None:
    along = bpy.data.objects["Along"]
    along.name = "Other name"
    line_stroke("Along", surface=bpy.data.objects[PLATE], force=3.0)
    committed = end(commit_steps(*baked))
    assert committed.refused == []
    assert strokes_kept() == ["Beside", "Other name"]


def test_edit_mode_keeps_bakes_and_asks_for_tokens_later(baked) -> None:
    plate = bpy.data.objects[PLATE]
    bpy.context.view_layer.objects.active = plate
    bpy.ops.object.mode_set(mode="EDIT")
    committed = end(commit_steps(*baked))
    bpy.ops.object.mode_set(mode="OBJECT")
    (refusal,) = committed.refused
    assert "Edit Mode" in refusal.why
    assert strokes_kept() == ["Along", "Beside"]
    assert kept()["tokens"] == {}
    bpy.context.view_layer.update()
    ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    assert ended.ok
    assert list(kept()["tokens"]) == [PLATE]


def test_a_gone_scene_is_said(baked) -> None:
    scene = bpy.context.scene
    bpy.data.scenes.new("Other")
    bpy.data.scenes.remove(scene)
    with pytest.raises(HnfError, match="gone"):
        end(commit_steps(*baked))
    assert kept() == NOTHING


@pytest.mark.parametrize("kind", ["bake", "tokens"])
def test_damaged_results_change_nothing_at_all(baked, kind) -> None:
    _, folder, _ = baked
    (damaged,) = folder.glob(f"0000.{kind}")
    damaged.write_bytes(damaged.read_bytes()[:100])
    with pytest.raises(HnfError):
        end(commit_steps(*baked))
    assert kept() == NOTHING


def test_what_changes_while_it_is_compared_is_compared_again(baked) -> None:
    """The handlers tell of the change; here it happens after its stroke was found unchanged."""
    from hnf_blender.handlers import on_depsgraph_update

    bpy.app.handlers.depsgraph_update_post.append(on_depsgraph_update)
    try:
        steps = commit_steps(*baked)
        next(steps)
        next(steps)
        bpy.data.objects["Along"].location.x += 1e-3
        committed = end(steps)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(on_depsgraph_update)
    assert [refusal.what for refusal in committed.refused] == ["Along"]
    assert strokes_kept() == ["Beside"]


def test_restless_scenes_are_committed_in_one_go(baked) -> None:
    """Something changes between any two looks: in the end all looks are taken at once."""
    from hnf_blender.handlers import on_depsgraph_update

    bpy.app.handlers.depsgraph_update_post.append(on_depsgraph_update)
    bystander = add_plane("Bystander", 0.1, z=1.0)
    try:
        steps = commit_steps(*baked)
        while True:
            try:
                next(steps)
            except StopIteration as done:
                committed = done.value
                break
            bystander.location.z += 0.1
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(on_depsgraph_update)
    assert committed.refused == []
    assert strokes_kept() == ["Along", "Beside"]


def test_a_linked_mesh_is_heard_and_its_missing_tokens_are_said(tmp_path, warm_bake) -> None:
    small_scene()
    bpy.data.objects.remove(bpy.data.objects["Along"])
    library = save_scene(tmp_path / "library.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [PLATE]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    line_stroke("Along", surface=wanted.objects[0])
    ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    assert not ended.ok
    assert "linked from" in ended.message
    assert "local" in ended.message
    assert [obj.name for obj in bpy.data.objects if BAKE_PROPERTY in obj] == ["Along"]
    again = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    assert (again.ok, again.written) == (True, 0)
