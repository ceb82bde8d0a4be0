"""Nothing visible is left out unsaid: what has a surface is touched, the rest is named with its own reason."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane
from touch_scene import save_scene, touch

from hnf_blender.bridge.importers import open_scene
from hnf_blender.bridge.scene import touchable
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.bridge.scene.touchable import realise_instances
from hnf_blender.bridge.stroke.place_primitive import _measure_slots, choose_default_slots, place_primitive
from hnf_blender.bridge.stroke.read_stroke import read_stroke
from hnf_blender.touch.session import gather_jobs, make_scene_session
from hnf_core.action.contacts import find_contacts
from hnf_core.errors import SceneError

SIZE = 0.1


def give(obj, material: str):
    obj.data.materials.append(bpy.data.materials.new(material))
    return obj


def add_text(location=(0, 0, 0)):
    bpy.ops.object.text_add(location=location)
    bpy.context.object.data.extrude = 0.02
    return give(bpy.context.object, "Oak")


def add_ring(location=(0, 0, 0)):
    bpy.ops.curve.primitive_bezier_circle_add(radius=SIZE, location=location)
    bpy.context.object.data.bevel_depth = 0.02
    return give(bpy.context.object, "Rubber")


def add_blob(location=(0, 0, 0)):
    bpy.ops.object.metaball_add(radius=SIZE, location=location)
    return give(bpy.context.object, "Clay")


def add_patch(location=(0, 0, 0)):
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(radius=SIZE, location=location)
    return give(bpy.context.object, "Leather")


def skipped(tmp_path) -> dict[str, str]:
    scene = bpy.context.scene
    session = make_scene_session(scene, bpy.context.view_layer, tmp_path)
    return {entry.what: entry.why for entry in gather_jobs(session).skipped}


@pytest.mark.parametrize("add", [add_text, add_ring, add_blob, add_patch])
def test_what_blender_evaluates_to_a_mesh_is_touched(stroke_properties, add):
    obj = add((0.3, -0.2, 0.1))
    obj.rotation_euler = (0.2, 0.1, 0.7)
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    assert [(each.name, slot) for each, slot, _ in choose_default_slots(scene)] == [(obj.name, 0)]
    placed = place_primitive(scene, obj, None, "default", 1.0)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    stroke = read_stroke(placed.curve, scene, depsgraph, 1.0)
    assert stroke.object_name == obj.name
    contacts = find_contacts(stroke.samples, read_surface(obj, depsgraph, 1.0).mesh)
    assert contacts.on_surface.all()


def test_text_and_curve_are_reported_with_their_materials(stroke_properties, tmp_path):
    add_text((1, 0, 0))
    add_ring((0, 1, 0))
    code, report = touch(save_scene(tmp_path / "two.blend"), tmp_path / "out")
    assert code == 0
    assert {stroke["object"] for stroke in report["strokes"]} == {"Text", "BézierCircle"}
    assert report["skipped"] == []
    for stroke in report["strokes"]:
        assert sum(choice["time_share"] for choice in stroke["materials"]) == pytest.approx(1.0, abs=1e-3)
        for choice in stroke["materials"]:
            assert choice["shader"] == stroke["material"]
            assert choice["library_material"] == stroke["library_material"]
            assert choice["reason"]
            assert 0.0 < choice["confidence"] <= 1.0


def test_everything_else_is_named_with_its_own_reason(stroke_properties, tmp_path):
    give(add_plane("Plate", SIZE), "Steel")
    add_blob((0, 1, 0)).name = "Blob"
    bpy.ops.object.metaball_add(radius=SIZE, location=(0.1, 1, 0))
    bpy.context.object.name = "Blob.001"
    bpy.ops.curve.primitive_bezier_curve_add(location=(0, 2, 0))
    bpy.context.object.name = "Guide"
    add_mesh("Wire", [(0, 3, 0)], [])
    collapsed = add_plane("Flat", SIZE)
    collapsed.data.vertices.foreach_set("co", np.zeros(12, dtype=np.float32))
    collapsed.data.update()
    add_mesh("Line", [(0, 0, 0), (10, 0, 0), (20, 0, 0)], [(0, 1, 2)])
    fur = bpy.data.objects.new("Fur", bpy.data.hair_curves.new("Fur"))
    fog = bpy.data.objects.new("Fog", bpy.data.volumes.new("Fog"))
    kit = bpy.data.objects.new("Kit", None)
    kit.instance_type, kit.instance_collection = "COLLECTION", bpy.data.collections.new("Parts")
    head = give(add_plane("Head", SIZE, z=1.0), "Skin")
    head.modifiers.new("Beard", "PARTICLE_SYSTEM")
    head.particle_systems[0].settings.type = "HAIR"
    for obj in (fur, fog, kit):
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    reasons = skipped(tmp_path)
    expected = {
        "metaball 'Blob.001'": "part of the metaball 'Blob'",
        "curve 'Guide'": "without faces",
        "object 'Wire'": "no faces",
        "object 'Flat'": "none of its faces has any area",
        "object 'Line'": "none of its faces has any area",
        "hair 'Fur'": "hair has no surface",
        "volume 'Fog'": "a volume has no faces",
        "object 'Kit'": "instances of collection 'Parts'",
        "hair on 'Head'": "hair",
    }
    assert set(reasons) == set(expected)
    assert all(words in reasons[what] for what, words in expected.items())
    assert all(why.count(".") >= 2 for what, why in reasons.items() if "Blob" not in what)  # what is wrong; what to do


def test_point_cloud_is_named(stroke_properties, tmp_path):
    give(add_plane("Plate", SIZE), "Steel")
    if "pointcloud_random_add" not in dir(bpy.ops.object):
        pytest.skip("this Blender has no point clouds")
    bpy.ops.object.pointcloud_random_add()
    assert "point cloud has no faces" in skipped(tmp_path)["point cloud 'PointCloud'"]


@pytest.mark.parametrize("offset", [0.0, 4.4e5])
def test_map_coordinates_are_told_from_faces_without_area(stroke_properties, tmp_path, offset):
    plane = give(add_plane("Map", 0.2), "Asphalt")
    for vertex in plane.data.vertices:
        vertex.co = (vertex.co.x + offset, vertex.co.y + 11.0 * offset, 0.0)
    if not offset:
        assert skipped(tmp_path) == {}
        return
    with pytest.raises(SceneError, match=r"so far from 0 that they are rounded to steps of 0\.5") as error:
        skipped(tmp_path)
    assert "Subtract the map's offset" in str(error.value)


def test_far_coordinates_with_faces_left_are_noted(stroke_properties):
    plane = add_plane("Map", 50.0)
    for vertex in plane.data.vertices:
        vertex.co.x += 1e5
    bpy.context.view_layer.update()
    notes = read_surface(plane, bpy.context.evaluated_depsgraph_get(), 1.0).notes
    assert any("rounded to steps of 7.8 mm" in note for note in notes)


def test_missing_library_is_named(stroke_properties, tmp_path):
    add_plane("Part", SIZE)
    library = save_scene(tmp_path / "gone.blend")
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.objects = ["Part"]
    bpy.context.scene.collection.objects.link(into.objects[0])
    scene = save_scene(tmp_path / "scene.blend")
    library.unlink()
    code, report = touch(scene, tmp_path / "out")
    assert code == 1
    assert not report


def add_kit(count: int = 1, part_offset=(0.0, 0.0, 0.0)) -> list:
    """Empties that show a collection with one plate, moved, turned and scaled."""
    kit = bpy.data.collections.new("Kit")
    part = give(add_plane("Part", SIZE), "Granite")
    bpy.context.scene.collection.objects.unlink(part)
    kit.objects.link(part)
    part.location = part_offset
    holders = []
    for index in range(count):
        holder = bpy.data.objects.new(f"Holder{index}", None)
        holder.instance_type, holder.instance_collection = "COLLECTION", kit
        holder.location, holder.rotation_euler, holder.scale = (index, 2.0, 0.5), (0.3, 0.0, 0.9), (1.0, 2.0, 1.5)
        bpy.context.scene.collection.objects.link(holder)
        holders.append(holder)
    bpy.context.view_layer.update()
    return holders


def test_collection_instances_become_objects_where_they_were(stroke_properties):
    holders = add_kit(3, part_offset=(0.1, 0.2, 0.0))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    before = sorted(
        np.array(instance.matrix_world).round(5).tolist() for instance in depsgraph.object_instances
        if instance.is_instance
    )  # fmt: skip
    (note,) = realise_instances(bpy.context.scene, bpy.context.view_layer)
    assert "3 objects made of the instances of" in note
    depsgraph = bpy.context.evaluated_depsgraph_get()
    made = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    assert sorted(np.array(obj.evaluated_get(depsgraph).matrix_world).round(5).tolist() for obj in made) == before
    assert {obj.parent for obj in made} == set(holders)  # they move with what showed them
    assert len({obj.data for obj in made}) == 1
    assert realise_instances(bpy.context.scene, bpy.context.view_layer) == []  # none is left


def test_instances_beyond_the_limit_are_said(stroke_properties, monkeypatch, tmp_path):
    monkeypatch.setattr(touchable, "MAX_COPIES", 2)
    add_kit(3)
    (note,) = realise_instances(bpy.context.scene, bpy.context.view_layer)
    assert "1 more are left" in note
    assert sum("Make Instances Real" in why for why in skipped(tmp_path).values()) == 3


def scatter(ground, rock) -> None:
    """Put a rock on every vertex of the ground by Geometry Nodes."""
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    kinds = "NodeGroupInput", "GeometryNodeObjectInfo", "GeometryNodeInstanceOnPoints", "NodeGroupOutput"
    start, info, instance, end = (group.nodes.new(kind) for kind in kinds)
    info.inputs["Object"].default_value = rock
    info.inputs["As Instance"].default_value = True
    group.links.new(start.outputs[0], instance.inputs["Points"])
    group.links.new(info.outputs["Geometry"], instance.inputs["Instance"])
    group.links.new(instance.outputs[0], end.inputs[0])
    ground.modifiers.new("Scatter", "NODES").node_group = group


def test_instances_of_geometry_nodes_have_their_material(stroke_properties, tmp_path):
    rock = give(add_plane("Rock", SIZE), "Granite")
    rock.hide_render = True
    ground = give(add_plane("Ground", 1.0), "Sand")
    scatter(ground, rock)
    bpy.context.view_layer.update()
    with pytest.raises(SceneError, match="modifiers leave no face"):  # in the window, where nothing is made real
        skipped(tmp_path)
    (note,) = realise_instances(bpy.context.scene, bpy.context.view_layer)
    assert "'Ground' were realized" in note
    assert [(obj.name, name) for obj, _, name in choose_default_slots(bpy.context.scene)] == [("Ground", "Granite")]
    place_primitive(bpy.context.scene, ground, None, "default", 1.0)


USD_HEAD = '#usda 1.0\n(\n defaultPrim = "World"\n metersPerUnit = 1\n upAxis = "Z"\n)\n'
USD_TILE = """def Mesh "Tile" (
 prepend apiSchemas = ["MaterialBindingAPI"]
)
{
 int[] faceVertexCounts = [4]
 int[] faceVertexIndices = [0, 1, 2, 3]
 point3f[] points = [(0,0,0), (0.1,0,0), (0.1,0.1,0), (0,0.1,0)]
 rel material:binding = <MATERIAL>
}
"""
USD_INSTANCERS = {
    "points": """def Xform "World"
{
def Material "Oak"
{
}
def PointInstancer "Many"
{
 point3f[] positions = [(0,0,0), (1,0,0)]
 int[] protoIndices = [0, 0]
 rel prototypes = [</World/Many/Protos/Tile>]
 def Scope "Protos"
 {
 TILE
 }
}
}
""".replace("TILE", USD_TILE.replace("MATERIAL", "/World/Oak")),
    "scene": """def Xform "World"
{
def Xform "A" (
 instanceable = true
 references = </Proto>
)
{
 double3 xformOp:translate = (0,2,0)
 uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Xform "B" (
 instanceable = true
 references = </Proto>
)
{
}
}
def Xform "Proto"
{
 def Material "Oak"
 {
 }
 TILE
}
""".replace("TILE", USD_TILE.replace("MATERIAL", "/Proto/Oak")),
}


@pytest.mark.parametrize("kind", USD_INSTANCERS)
def test_instanced_prims_of_usd_are_touched(stroke_properties, tmp_path, kind):
    path = tmp_path / "instances.usda"
    path.write_text(USD_HEAD + USD_INSTANCERS[kind])
    scene = open_scene(path)
    realise_instances(scene, scene.view_layers[0])
    places = [obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world.translation.length
              for obj, _, material, _ in _measure_slots(scene, None) if material.startswith("Oak")]  # fmt: skip
    assert sorted(places)[-1] == pytest.approx({"points": 1.0, "scene": 2.0}[kind])
    assert not [why for why in skipped(tmp_path).values() if "instances" in why or "point cloud" in why]


def test_a_material_whose_shader_was_not_imported_is_told(stroke_properties, tmp_path):
    """As of MaterialX: the name is there and nothing else."""
    plate = give(add_plane("Plate", SIZE), "Brass")
    plate.data.materials[0].use_nodes = True
    plate.data.materials[0].node_tree.nodes.clear()
    code, report = touch(save_scene(tmp_path / "plate.blend"), tmp_path / "out")
    assert code == 0
    (stroke,) = report["strokes"]
    assert stroke["library_material"] == "brass"
    assert [note for note in report["warnings"] if "material 'Brass'" in note and "UsdPreviewSurface" in note]
