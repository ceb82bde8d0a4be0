"""Work is limited to what the strokes of a scene need: reads, builds and renders are counted, not timed.

docs/benchmarks.md lists every rule and where its test is.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material
from touch_scene import PLATE, line_stroke, ridge_plate

from hnf_blender.bridge.render import closeup
from hnf_blender.bridge.scene import object_size
from hnf_blender.bridge.scene.meshes import evaluated_mesh
from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.bridge.stroke.read_stroke import find_nearest_surface
from hnf_blender.touch import bake_patches, bake_storage, patch_cache, session
from hnf_lab.blender_bench.scale import measure_open_file_bake

tokens_of = bake_storage.store_tokens
SHORT_M = 0.01
"""One close-up."""


@pytest.fixture
def read(monkeypatch):
    """Names of the objects whose evaluated mesh was read, wherever that is imported."""
    names = []

    def counted(evaluated, depsgraph):
        names.append(evaluated.name)
        return evaluated_mesh(evaluated, depsgraph)

    for module in [each for name, each in sys.modules.items() if name.startswith("hnf_blender.")]:
        if getattr(module, "evaluated_mesh", None) is evaluated_mesh:
            monkeypatch.setattr(module, "evaluated_mesh", counted)
    return names


HIDDEN = {
    "excluded": lambda layer: setattr(layer, "exclude", True),
    "its eye closed": lambda layer: setattr(layer, "hide_viewport", True),
    "disabled in viewports": lambda layer: setattr(layer.collection, "hide_viewport", True),
    "disabled in renders": lambda layer: setattr(layer.collection, "hide_render", True),
    "its objects disabled in renders": lambda layer: setattr(layer.collection.objects[0], "hide_render", True),
}
"""What an artist clicks beside the name of a collection, or of what is in it."""


def in_hidden_collection(obj, way: str) -> None:
    collection = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(collection)
    bpy.context.scene.collection.objects.unlink(obj)
    collection.objects.link(obj)
    HIDDEN[way](bpy.context.view_layer.layer_collection.children["Hidden"])


@pytest.mark.parametrize(("named", "way"), [(True, "excluded"), *((False, way) for way in HIDDEN)])
def test_no_mesh_is_read_but_that_under_the_stroke(tmp_path, read, named, way) -> None:
    """Also where the stroke does not say what it touches: the others' boxes are too far. A hidden collection lies right
    under it, and a muted stroke on another object."""
    plate, other = ridge_plate(), add_plane("Other", 0.1, z=0.3)
    in_hidden_collection(add_plane("Under it", 0.1), way)
    line_stroke("Along", length=SHORT_M, **({"surface": plate} if named else {}))
    line_stroke("Quiet", centre=(0.0, 0.0, 0.3), surface=other, mute=True)
    cost = measure_open_file_bake(tmp_path)
    assert set(read) == {PLATE}
    assert (cost.work["renders"], cost.work["F_Θ calls"]) == (1, 1)


def test_collections_are_searched_once_for_any_object_count(monkeypatch) -> None:
    planes = [add_plane(f"Plate {number}", 0.1) for number in range(6)]
    in_hidden_collection(planes[0], "disabled in renders")
    asked, rendered = [], object_size._iter_rendered_collections

    def counted(layer):
        asked.append(layer.name)
        return rendered(layer)

    monkeypatch.setattr(object_size, "_iter_rendered_collections", counted)
    shown = object_size.filter_visible(bpy.context.scene.objects, bpy.context.view_layer)
    assert {obj.name for obj in shown} == {obj.name for obj in planes[1:]}
    assert len(asked) == len(set(asked)) == 2
    planes[1].hide_render = True
    assert [object_size.is_visible(obj, bpy.context.view_layer) for obj in planes[:3]] == [False, False, True]


def test_the_next_surface_is_found_among_the_near_boxes(read) -> None:
    """Of ten plates below each other the stroke's own and, to compare, none farther than that is read."""
    for number in range(10):
        add_plane(f"Plate {number}", 0.1, z=-0.01 * number)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    asked = []

    def surfaces(obj):
        asked.append(obj.name)
        return session.read_surface(obj, depsgraph, 1.0)

    points = np.array([[-0.01, 0.0, -0.0301], [0.01, 0.0, -0.0301]])
    found = find_nearest_surface(points, bpy.context.scene, depsgraph, surfaces, 1.0, where="stroke")
    assert (found.name, asked) == ("Plate 3", ["Plate 3"])


def test_boxes_of_many_are_those_of_each() -> None:
    for number in range(4):
        obj = add_plane(f"Plate {number}", 0.1 + 0.1 * number)
        obj.location, obj.rotation_euler, obj.scale = (number, -2.0, 0.5), (0.3 * number, 0.2, 1.0), (1.0, 2.0, number)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    low, high = object_size.get_world_boxes(list(bpy.context.scene.objects), depsgraph, 0.01)
    assert low.shape == high.shape == (4, 3)
    for index, obj in enumerate(bpy.context.scene.objects):
        corners = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices]) * 0.01
        np.testing.assert_allclose([low[index], high[index]], [corners.min(axis=0), corners.max(axis=0)], atol=1e-7)
    assert [each.shape for each in object_size.get_world_boxes([], depsgraph)] == [(0, 3), (0, 3)]


def grid(cuts: int, size: float):
    """A plate of cuts × cuts faces with ridges."""
    plate = add_plane(PLATE, size)
    plate.data.materials.append(bump_material("Ridges", wavelength=2e-3, height=6e-5))
    bpy.context.view_layer.objects.active = plate
    plate.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.subdivide(number_cuts=cuts - 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(plate.data.polygons) == cuts * cuts
    return plate


def test_rays_meet_a_tree_of_the_faces_within_reach_alone(tmp_path, monkeypatch) -> None:
    """A plate four times as large, as finely cut, gives the same tree, rays and renders."""
    trees, caster = [], closeup.make_ray_caster

    def counted(mesh):
        trees.append(len(mesh.triangles))
        return caster(mesh)

    monkeypatch.setattr(closeup, "make_ray_caster", counted)
    work = []
    for cuts, size in ((40, 0.1), (80, 0.2)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        line_stroke("Along", length=SHORT_M, surface=grid(cuts, size))
        work.append(measure_open_file_bake(tmp_path).work)
    small, large = trees
    assert small == large
    assert 0 < small < 40 * 40
    assert work[0] == work[1]


def test_passes_are_rendered_of_the_touched_slot_alone(tmp_path, monkeypatch) -> None:
    """And its images, shaders and nodes alone are copied: the others' materials have no tap."""
    taps, add = [], closeup.add_aovs
    monkeypatch.setattr(closeup, "add_aovs", lambda layer, found: (taps.extend(found), add(layer, found)))
    plate = grid(4, 0.1)
    for number in range(3):
        plate.data.materials.append(bump_material(f"Not touched {number}", wavelength=3e-3, height=3e-5))
    for face in plate.data.polygons:
        face.material_index = 0 if face.center.y < 0.0 else 1 + face.index % 3
    line_stroke("Along", length=SHORT_M, centre=(0.0, -0.03, 0.0), surface=plate)
    measure_open_file_bake(tmp_path)
    assert taps
    assert {tap.name.partition("_")[0] for tap in taps} == {"hnf0"}


def test_a_map_is_rendered_for_its_token_and_not_for_the_path(tmp_path, monkeypatch) -> None:
    """Two strokes over one place: one close-up, one token, and no sensor image beside E's own."""
    pictured = []
    monkeypatch.setattr(bake_patches, "render_sensor_image", lambda *parts: pictured.append(parts))
    plate = ridge_plate()
    for seed in (1, 2):
        line_stroke(f"Seed {seed}", length=SHORT_M, surface=plate, seed=seed)
    cost = measure_open_file_bake(tmp_path)
    assert pictured == []
    assert (cost.work["renders"], cost.work["F_Θ calls"]) == (1, 2)


def test_no_map_is_held_once_its_stroke_is_felt(tmp_path, monkeypatch) -> None:
    """Only what the faces' tokens follow from waits for the end."""
    held = []
    monkeypatch.setattr(bake_storage, "store_tokens", lambda strokes: (held.extend(strokes), tokens_of(strokes))[1])
    plate = ridge_plate()
    line_stroke("Along", length=SHORT_M, surface=plate)
    measure_open_file_bake(tmp_path)
    (record,) = held[0].records
    assert (record.height, record.unlit, record.predicted, record.mask.size) == (None, None, None, 0)
    assert record.encoder
    assert read_tokens(plate.data).index.tolist() == [0]


def test_a_place_that_many_strokes_cross_is_unpacked_once(tmp_path, monkeypatch) -> None:
    """Its own stroke has it in memory; the second one reads the file, and those after it find what that one read."""
    plate, unpacked = ridge_plate(), []
    for number in range(4):
        line_stroke(f"Stroke {number}", length=SHORT_M, surface=plate)
    np_load = patch_cache.np.load
    monkeypatch.setattr(
        patch_cache.np, "load", lambda path, **words: (unpacked.append(path), np_load(path, **words))[1]
    )
    measure_open_file_bake(tmp_path)
    assert len(unpacked) == 1


def test_a_patch_in_memory_is_left_once_its_file_changes(tmp_path, monkeypatch) -> None:
    saved = []
    monkeypatch.setattr(bake_patches, "save_patch", lambda folder, key, record: saved.append(record))
    line_stroke("Along", length=SHORT_M, surface=ridge_plate())
    measure_open_file_bake(tmp_path)
    patch_cache.save_patch(tmp_path, "place", saved[0])
    kept = patch_cache.load_patch(tmp_path, "place")
    assert kept is patch_cache.load_patch(tmp_path, "place")
    with pytest.raises(ValueError, match="read-only"):
        kept.height[0] = 0.0
    patch_cache.save_patch(tmp_path, "place", replace(saved[0], height=saved[0].height + 1e-6))
    np.testing.assert_array_equal(patch_cache.load_patch(tmp_path, "place").height, saved[0].height + 1e-6)
    path = tmp_path / "place.npz"
    path.write_bytes(path.read_bytes()[:-100])
    assert patch_cache.load_patch(tmp_path, "place") is None
    path.unlink()
    assert patch_cache.load_patch(tmp_path, "place") is None
