"""What leaves the preview is what the command line makes of the same scene, byte for byte."""

from __future__ import annotations

import shutil

import bpy
from job_scene import small_scene
from touch_scene import save_scene, set_keys, touch

from hnf_blender.preview import controller
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.strips_and_speakers import ID_PROPERTY, find_linked_strips, mark_linked
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.bake_status import Freshness


def exported(tmp_path) -> dict[str, bytes]:
    folder = tmp_path / "exported"
    shutil.rmtree(folder, ignore_errors=True)
    bpy.context.scene.hnf.export_folder = str(folder)
    assert bpy.ops.hnf.export() == {"FINISHED"}
    return {path.name: path.read_bytes() for path in folder.glob("*.wav")}


def touched(tmp_path, warm_bake, name: str) -> dict[str, bytes]:
    out = tmp_path / name
    shutil.copytree(warm_bake, out / "cache")
    code, _ = touch(save_scene(tmp_path / f"{name}.blend"), out)
    assert code == 0
    return {path.name: path.read_bytes() for path in out.glob("*.wav")}


def test_the_exported_wav_is_that_of_the_command_line(warm_bake, tmp_path) -> None:
    """As baked; and, without another bake, after force, probe and seed changed."""
    PREVIEW.clear()
    small_scene()
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    first = exported(tmp_path)
    assert first == touched(tmp_path, warm_bake, "first")
    stroke = bpy.data.objects["Along"]  # the file was opened anew
    set_keys(stroke, "force", (3.0, 2.7))
    stroke.hnf_stroke.seed, stroke.hnf_stroke.probe = 11, "finger"
    refresh_status(bpy.context.scene)
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FORCE
    second = exported(tmp_path)
    assert second.keys() == first.keys()
    assert second != first
    assert second == touched(tmp_path, warm_bake, "second")


def test_a_strip_is_linked_to_its_stroke_by_identity() -> None:
    """Renamed, and its name given to another; duplicated with its identity; marked before there were identities."""
    small_scene()
    scene, own = bpy.context.scene, bpy.data.objects["Along"]
    strips = [bpy.data.objects.new(f"strip {k}", None) for k in range(2)]  # what has properties can be marked
    strips[1]["hnf_stroke_name"] = "Along"
    assert find_linked_strips(own, scene, strips) == [strips[1]]
    mark_linked(strips[0], own, scene, "one")
    twin = own.copy()
    scene.collection.objects.link(twin)
    assert (find_linked_strips(own, scene, strips[:1]), find_linked_strips(twin, scene, strips[:1])) == (strips[:1], [])
    mark_linked(strips[1], twin, scene, "other")
    own.name, twin.name = "Renamed", "Along"
    assert twin[ID_PROPERTY] != own[ID_PROPERTY]
    assert (find_linked_strips(own, scene, strips), find_linked_strips(twin, scene, strips)) == (strips[:1], strips[1:])


def test_a_speaker_that_sounds_as_the_stroke_did_before_is_told(warm_bake) -> None:
    PREVIEW.clear()
    small_scene()
    scene, stroke = bpy.context.scene, bpy.data.objects["Along"]
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    bpy.context.view_layer.objects.active = stroke
    assert bpy.ops.hnf.add_speaker() == {"FINISHED"}

    def told() -> list[str]:
        controller.refresh(stroke, bpy.context, wait=True)
        controller.update_outdated_strips(stroke, scene)
        return [line for line in controller.update_facts("Along", scene).lines if "before the last change" in line]

    assert told() == []
    set_keys(stroke, "force", (3.0, 2.7))
    assert [line.partition(" still plays")[0] for line in told()] == ["'Along speaker'"]
    bpy.context.view_layer.objects.active = stroke
    assert bpy.ops.hnf.add_speaker() == {"FINISHED"}
    assert PREVIEW.outdated["Along"] == told() == []
