"""Work is limited to what the strokes of a scene need: reads, builds and renders are counted, not timed.

docs/benchmarks.md lists every rule and where its test is.
"""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material
from touch_scene import PLATE, line_stroke, ridge_plate

from hnf_blender.bridge.scene import object_size
from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.bridge.stroke.read_stroke import find_nearest_surface
from hnf_blender.touch import patch_cache, session
from hnf_blender.touch.bake_storage import store_tokens
from hnf_blender.touch.report import Report
from hnf_blender.touch.synthesise import bake_strokes
from hnf_core.progress import count_work
from hnf_lab.blender_bench.scale import measure_open_file_bake

SHORT_M = 0.01
"""One close-up."""


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
def test_no_mesh_is_read_but_that_under_the_stroke(tmp_path, named, way) -> None:
    """Also where the stroke does not say what it touches: the others' boxes are too far. A hidden collection lies right
    under it, and a muted stroke on another object."""
    plate, other = ridge_plate(), add_plane("Other", 0.1, z=0.3)
    in_hidden_collection(add_plane("Under it", 0.1), way)
    line_stroke("Along", length=SHORT_M, **({"surface": plate} if named else {}))
    line_stroke("Quiet", centre=(0.0, 0.0, 0.3), surface=other, mute=True)
    with count_work() as work:
        cost = measure_open_file_bake(tmp_path)
    assert set(work.items["meshes"]) == {PLATE}
    assert (cost.work["renders"], cost.work["F_Θ calls"]) == (2, 1)  # a small view chooses the sampling


def test_collections_are_searched_once_for_any_object_count() -> None:
    planes = [add_plane(f"Plate {number}", 0.1) for number in range(6)]
    in_hidden_collection(planes[0], "disabled in renders")
    with count_work() as work:
        shown = object_size.filter_visible(bpy.context.scene.objects, bpy.context.view_layer)
    assert {obj.name for obj in shown} == {obj.name for obj in planes[1:]}
    asked = work.items["collections"]
    assert len(asked) == len(set(asked)) == 2
    planes[1].hide_render = True
    assert [object_size.is_visible(obj, bpy.context.view_layer) for obj in planes[:3]] == [False, False, True]


def test_the_next_surface_is_found_among_the_near_boxes() -> None:
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


def test_rays_meet_a_tree_of_the_faces_within_reach_alone(tmp_path) -> None:
    """A plate four times as large, as finely cut, gives the same tree, rays and renders."""
    trees, costs = [], []
    for cuts, size in ((40, 0.1), (80, 0.2)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        line_stroke("Along", length=SHORT_M, surface=grid(cuts, size))
        with count_work() as work:
            costs.append(measure_open_file_bake(tmp_path).work)
        trees += work.amounts["caster_triangles"]
    small, large = trees
    assert small == large
    assert 0 < small < 40 * 40
    assert costs[0] == costs[1]


def test_passes_are_rendered_of_the_touched_slot_alone(tmp_path) -> None:
    """And its images, shaders and nodes alone are copied: the others' materials have no tap."""
    plate = grid(4, 0.1)
    for number in range(3):
        plate.data.materials.append(bump_material(f"Not touched {number}", wavelength=3e-3, height=3e-5))
    for face in plate.data.polygons:
        face.material_index = 0 if face.center.y < 0.0 else 1 + face.index % 3
    line_stroke("Along", length=SHORT_M, centre=(0.0, -0.03, 0.0), surface=plate)
    with count_work() as work:
        measure_open_file_bake(tmp_path)
    assert {name.partition("_")[0] for name in work.items["passes"]} == {"hnf0"}


def test_a_map_is_rendered_for_its_token_and_not_for_the_path(tmp_path) -> None:
    """Two strokes over one place: one close-up, one token, and no sensor image beside E's own."""
    plate = ridge_plate()
    for seed in (1, 2):
        line_stroke(f"Seed {seed}", length=SHORT_M, surface=plate, seed=seed)
    with count_work() as work:
        cost = measure_open_file_bake(tmp_path)
    assert work.total("sensor_images") == work.total("tokens") == 1
    assert (cost.work["renders"], cost.work["F_Θ calls"]) == (2, 2)


def bake_open_file(folder):
    """The strokes as they are handed on one by one, with their maps, and as they wait for the end."""
    bpy.context.view_layer.update()
    found = session.make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
    jobs, report, handed_on = session.gather_jobs(found).jobs, Report("", 1.0, ""), []
    baked = bake_strokes(found, jobs, folder, report, lambda job, stroke, start_stage: handed_on.append(stroke))
    assert report.failed == []
    return handed_on, baked


def test_no_map_is_held_once_its_stroke_is_felt(tmp_path) -> None:
    """Only what the faces' tokens follow from waits for the end."""
    plate = ridge_plate()
    line_stroke("Along", length=SHORT_M, surface=plate)
    (felt,), held = bake_open_file(tmp_path)
    assert felt.records[0].height is not None
    (record,) = held[0].records
    assert (record.height, record.unlit, record.predicted, record.mask.size) == (None, None, None, 0)
    assert record.encoder
    store_tokens(held)
    assert read_tokens(plate.data).index.tolist() == [0]


def test_a_place_that_many_strokes_cross_is_unpacked_once(tmp_path) -> None:
    """Its own stroke has it in memory; the second one reads the file, and those after it find what that one read."""
    plate = ridge_plate()
    for number in range(4):
        line_stroke(f"Stroke {number}", length=SHORT_M, surface=plate)
    with count_work() as work:
        measure_open_file_bake(tmp_path)
    assert work.total("patch_files") == 1


def test_a_patch_in_memory_is_left_once_its_file_changes(tmp_path) -> None:
    line_stroke("Along", length=SHORT_M, surface=ridge_plate())
    (felt,), _ = bake_open_file(tmp_path / "cache")
    saved = felt.records
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
