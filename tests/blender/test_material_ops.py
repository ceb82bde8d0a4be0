"""Material operators: suggestions, the artist's choice, and the return to automatic."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane, datablock_names

from hnf_blender.bridge.shader.closures import read_stated_appearance
from hnf_blender.bridge.shader.images import list_texture_names
from hnf_blender.compat import switch_nodes_on
from hnf_blender.ops.material_ops import (
    CLASSES,
    HNF_OT_material_choose,
    find_material_object,
    list_library_items,
)
from hnf_blender.registration import register_classes, unregister_classes
from hnf_blender.state.job_results import Relief
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import StatusTracker
from hnf_blender.touch.session import make_scene_session
from hnf_core.material.library import get_material, load_library
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route


@pytest.fixture(autouse=True)
def operators():
    STATE.clear()
    register_classes(CLASSES)
    yield
    unregister_classes(CLASSES)
    STATE.clear()


def material(name: str, **values: object) -> bpy.types.Material:
    made = bpy.data.materials.new(name)
    switch_nodes_on(made)
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket, value in values.items():
        shader.inputs[socket.replace("_", " ")].default_value = value
    return made


def touched(made: bpy.types.Material) -> bpy.types.Object:
    plane = add_plane()
    plane.data.materials.append(made)
    bpy.context.view_layer.objects.active = plane
    return plane


def test_stated_values_are_read_without_a_trace() -> None:
    made = material("Brass", Metallic=1.0, Roughness=0.25, Base_Color=(0.8, 0.6, 0.2, 1.0))
    before = datablock_names()
    appearance = read_stated_appearance(made)
    assert datablock_names() == before
    assert appearance.metallic == pytest.approx(1.0)
    assert appearance.roughness == pytest.approx(0.25)
    assert appearance.base_color == pytest.approx((0.8, 0.6, 0.2))


def test_what_a_texture_says_stays_unknown() -> None:
    made = material("Checked", Roughness=0.3)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(nodes.new("ShaderNodeTexChecker").outputs["Color"], shader.inputs["Base Color"])
    appearance = read_stated_appearance(made)
    assert appearance.base_color is None
    assert appearance.roughness == pytest.approx(0.3)


def test_a_value_node_is_a_stated_value() -> None:
    made = material("Waxed")
    nodes, links = made.node_tree.nodes, made.node_tree.links
    value = nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.125
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(value.outputs[0], shader.inputs["Roughness"])
    assert read_stated_appearance(made).roughness == pytest.approx(0.125)


def test_two_mixed_shaders_count_by_their_factor() -> None:
    made = material("Half rusty", Metallic=1.0)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    other, mix = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeMixShader")
    other.inputs["Metallic"].default_value = 0.0
    mix.inputs[0].default_value = 0.75
    links.new(shader.outputs[0], mix.inputs[1])
    links.new(other.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], made.node_tree.nodes["Material Output"].inputs["Surface"])
    assert read_stated_appearance(made).metallic == pytest.approx(0.25)


def test_suggestions_rank_the_whole_library_and_leave_no_trace() -> None:
    made = material("Old oak table")
    touched(made)
    before = datablock_names()
    assert bpy.ops.hnf.suggest() == {"FINISHED"}
    assert datablock_names() == before
    ranked = STATE.suggestions["Old oak table"]
    assert ranked[0].name == "oak-wood"
    assert len(ranked) == len(load_library())
    assert made.hnf_touch.library == ""  # it only suggests


def test_suggest_says_what_is_missing() -> None:
    with pytest.raises(RuntimeError, match="Select a mesh"):
        bpy.ops.hnf.suggest()
    bpy.context.view_layer.objects.active = add_plane()
    with pytest.raises(RuntimeError, match="no material"):
        bpy.ops.hnf.suggest()


def test_a_choice_is_kept_in_the_file_until_it_is_taken_back(tmp_path) -> None:
    touched(material("Seat"))
    assert bpy.ops.hnf.material_choose(material="Seat", name="leather") == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "seat.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "seat.blend"))
    assert bpy.data.materials["Seat"].hnf_touch.library == "leather"
    assert bpy.ops.hnf.material_auto(material="Seat") == {"FINISHED"}
    assert bpy.data.materials["Seat"].hnf_touch.library == ""


def test_a_linked_material_is_not_taken_for_its_namesake_here(tmp_path) -> None:
    path = tmp_path / "library.blend"
    bpy.data.libraries.write(str(path), {material("Seat")})
    bpy.data.materials.remove(bpy.data.materials["Seat"])
    own = material("Seat")
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.materials = ["Seat"]
    linked = wanted.materials[0]
    assert (linked.name, linked.name_full != own.name_full) == ("Seat", True)
    touched(linked)
    assert bpy.ops.hnf.suggest() == {"FINISHED"}
    assert list(STATE.suggestions) == [linked.name_full]
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.hnf.material_choose(material=linked.name_full, name="leather")
    assert own.hnf_touch.library == ""
    assert bpy.ops.hnf.material_choose(material=own.name_full, name="leather") == {"FINISHED"}
    assert (own.hnf_touch.library, linked.hnf_touch.library) == ("leather", "")


def test_a_choice_makes_its_strokes_worth_a_look() -> None:
    touched(material("Seat"))
    bpy.ops.hnf.material_choose(material="Seat", name="leather")
    assert "Seat" in STATE.dirty_names


def test_unknown_names_are_refused() -> None:
    touched(material("Seat"))
    with pytest.raises(TypeError, match="enum"):
        bpy.ops.hnf.material_choose(material="Seat", name="unobtainium")
    with pytest.raises(RuntimeError, match="no material 'Chair'"):
        bpy.ops.hnf.material_choose(material="Chair", name="leather")
    with pytest.raises(RuntimeError, match="no material 'Chair'"):
        bpy.ops.hnf.material_auto(material="Chair")


def test_a_linked_material_is_left_alone(tmp_path) -> None:
    touched(material("Seat"))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "seat.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "seat.blend"), link=True) as (_, wanted):
        wanted.materials = ["Seat"]
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.hnf.material_choose(material="Seat", name="leather")
    assert bpy.data.materials["Seat"].hnf_touch.library == ""


def test_a_suggestion_says_why_in_its_tooltip() -> None:
    touched(material("Old oak table"))
    bpy.ops.hnf.suggest()

    class Chosen:
        material, name = "Old oak table", "oak-wood"

        @staticmethod
        def is_property_set(_name: str) -> bool:
            return True

    assert HNF_OT_material_choose.description(bpy.context, Chosen).startswith("Oak wood: 'oak' in 'Old oak table'")
    Chosen.material = "Another"
    assert HNF_OT_material_choose.description(bpy.context, Chosen) == HNF_OT_material_choose.bl_description


def test_the_searchable_list_is_the_library_grouped_by_category() -> None:
    assert sorted(name for name, _, _ in list_library_items()) == sorted(material.name for material in load_library())
    categories = [label.split(" ▸ ")[0] for _, label, _ in list_library_items()]
    assert categories == sorted(categories)


def test_a_stroke_may_have_a_material_of_its_own() -> None:
    stroke = bpy.data.objects.new("Rub", bpy.data.curves.new("Rub", "CURVE"))
    with pytest.raises(RuntimeError, match="No stroke is selected"):
        bpy.ops.hnf.stroke_material(name=list_library_items()[0][0])
    bpy.context.scene.collection.objects.link(stroke)
    stroke.hnf_stroke.is_stroke = True
    assert bpy.ops.hnf.stroke_material(name=list_library_items()[0][0]) == {"FINISHED"}
    assert stroke.hnf_stroke.material == list_library_items()[0][0]
    assert bpy.ops.hnf.stroke_material_auto() == {"FINISHED"}
    assert stroke.hnf_stroke.material == ""


def test_the_object_that_is_felt() -> None:
    plane = touched(material("Seat"))
    assert find_material_object(bpy.context) == plane
    stroke = bpy.data.objects.new("Rub", bpy.data.curves.new("Rub", "CURVE"))
    bpy.context.scene.collection.objects.link(stroke)
    stroke.hnf_stroke.is_stroke = True
    bpy.context.view_layer.objects.active = stroke
    assert find_material_object(bpy.context) is None
    stroke.hnf_stroke.surface = plane
    assert find_material_object(bpy.context) == plane


def textured(name: str, picture: str) -> bpy.types.Material:
    """A material whose base colour is a picture of this name, seen through a node group."""
    made = bpy.data.materials.new(name)
    switch_nodes_on(made)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    group = bpy.data.node_groups.new("Look", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    inner = group.nodes.new("ShaderNodeTexImage")
    inner.image = bpy.data.images.new(picture, 4, 4)
    group.links.new(inner.outputs["Color"], group.nodes.new("NodeGroupOutput").inputs[0])
    holder = nodes.new("ShaderNodeGroup")
    holder.node_tree = group
    links.new(holder.outputs[0], shader.inputs["Base Color"])
    return made


def test_only_images_connected_to_the_shader_are_listed() -> None:
    made = textured("Material", "T_Oak_Planks_BaseColor.png")
    loose = made.node_tree.nodes.new("ShaderNodeTexImage")
    loose.image = bpy.data.images.new("steel.png", 4, 4)
    before = datablock_names()
    assert list_texture_names(made) == ("T_Oak_Planks_BaseColor.png",)
    assert list_texture_names(None) == ()
    assert datablock_names() == before


def test_a_picture_s_name_suggests_what_it_shows() -> None:
    made = textured("Material", "T_Oak_Planks_BaseColor.png")
    touched(made)
    assert bpy.ops.hnf.suggest() == {"FINISHED"}
    best = STATE.suggestions["Material"][0]
    assert best.name == "oak-wood"
    assert "'oak' in 'T_Oak_Planks_BaseColor.png'" in best.reason
    assert not made.hnf_touch.library


def test_a_measured_relief_is_evidence_until_a_material_change() -> None:
    made = material("Material")
    touched(made)
    token = get_material("corduroy").token
    STATE.reliefs["Material"] = Relief(Token(token, np.ones(len(token), dtype=bool)), Route.MEASURED)
    assert bpy.ops.hnf.suggest() == {"FINISHED"}
    assert STATE.suggestions["Material"][0].name == "corduroy"
    StatusTracker(bpy.context.scene, bpy.context.view_layer).mark_changed("Material")
    assert STATE.reliefs == {}


def test_picture_names_count_by_what_they_say(tmp_path) -> None:
    """The surface is the same; that another material is meant is known apart, so that a rename silences nothing."""
    made = textured("Material", "T_Oak_Planks_BaseColor.png")
    plane = touched(made)

    def hash_inputs():
        bpy.context.view_layer.update()
        session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
        return session._hash_inputs(plane.name, "", "", "")

    before = hash_inputs()
    bpy.data.images["T_Oak_Planks_BaseColor.png"].name = "T_Oak_Planks_BaseColor.001"
    assert hash_inputs() == before
    bpy.data.images["T_Oak_Planks_BaseColor.001"].name = "T_Steel.png"
    after = hash_inputs()
    assert after.names != before.names
    assert after.surface_key == before.surface_key
