"""Ways to change a scene (of shaders and pictures: shader_changes.py). Each is a generator that arranges the file that
is open, the plate of touch_scene with stroke "Along" on it, yields, and then changes one thing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np
from builders import bump_material
from touch_scene import PLATE

Change = Callable[[Path], Iterator[None]]
FELT: dict[str, Change] = {}
"""What the plate's relief follows from: its close-up is made anew."""
UNFELT: dict[str, Change] = {}
"""What nothing felt follows from: nothing is done."""


def felt(change: Change) -> Change:
    FELT[change.__name__] = change
    return change


def unfelt(change: Change) -> Change:
    UNFELT[change.__name__] = change
    return change


def plate():
    return bpy.data.objects[PLATE]


def tree():
    return plate().data.materials[0].node_tree


def node(kind: str):
    return next(each for each in tree().nodes if each.bl_idname == kind)


def add_node(kind: str, output: int | str = 0, **settings):
    """A node whose output is added to the plate's height."""
    made, bump = tree().nodes.new(kind), node("ShaderNodeBump")
    for name, value in settings.items():
        setattr(made, name, value)
    added = tree().nodes.new("ShaderNodeMath")
    links = tree().links
    links.new(bump.inputs["Height"].links[0].from_socket, added.inputs[0])
    links.new(made.outputs[output], added.inputs[1])
    links.new(added.outputs[0], bump.inputs["Height"])
    return made


def write_picture(path: Path, value: float) -> Path:
    """8 × 8 grey pixels, uncompressed, so that all have the same size."""
    image = bpy.data.images.new("to write", 8, 8)
    pixels = np.full((64, 4), value, dtype=np.float32)
    pixels[::3, :3] = 1.0 - value
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "BMP"
    image.save()
    bpy.data.images.remove(image)
    return path


def add_picture(path: Path, source: str = "FILE", **user):
    """The picture as part of the height, 1 mm a texel; returns its node."""
    made = add_node("ShaderNodeTexImage")
    made.image = bpy.data.images.load(str(path))
    made.image.source, made.image.colorspace_settings.name = source, "Non-Color"
    for name, value in user.items():
        setattr(made.image_user, name, value)
    scaled = tree().nodes.new("ShaderNodeMapping")
    scaled.inputs["Scale"].default_value = (125.0, 125.0, 1.0)
    tree().links.new(node("ShaderNodeUVMap").outputs[0], scaled.inputs[0])
    tree().links.new(scaled.outputs[0], made.inputs[0])
    return made


def add_empty(name: str = "Control"):
    made = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(made)
    return made


def add_group(*kinds: str):
    """A node group with a Float output, in the height; its nodes of these kinds."""
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketFloat")
    made = [group.nodes.new(kind) for kind in ("NodeGroupOutput", *kinds)]
    if len(made) > 1:
        group.links.new(made[1].outputs[0], made[0].inputs[0])
    add_node("ShaderNodeGroup", node_tree=group) if made else None
    return made


@felt
def vertex(folder):
    yield
    plate().data.vertices[0].co.z += 1e-5


@felt
def uv(folder):
    yield
    plate().data.uv_layers[0].data[0].uv = (0.01, 0.02)


@felt
def other_uv_map_that_a_node_names(folder):
    plate().data.uv_layers.new(name="Other")
    node("ShaderNodeUVMap").uv_map = "Other"
    yield
    plate().data.uv_layers["Other"].data[0].uv = (0.01, 0.02)


@felt
def split_normals(folder):
    yield
    plate().data.normals_split_custom_set([(0.1, 0.0, 1.0)] * 4)


@felt
def shape_key(folder):
    plate().shape_key_add(name="Basis")
    plate().shape_key_add(name="Bent").data[0].co.z += 0.01
    yield
    plate().data.shape_keys.key_blocks["Bent"].value = 0.5


@felt
def modifier_parameter(folder):
    plate().modifiers.new("Solid", "SOLIDIFY").thickness = 0.01
    yield
    plate().modifiers["Solid"].thickness = 0.011


@felt
def texture_of_a_modifier(folder):
    displace = plate().modifiers.new("Displace", "DISPLACE")
    displace.texture, displace.strength = bpy.data.textures.new("Ramp", "BLEND"), 0.01
    yield
    bpy.data.textures["Ramp"].contrast = 2.0


@felt
def painted_colours(folder):
    plate().data.color_attributes.new("Wear", "BYTE_COLOR", "CORNER")
    add_node("ShaderNodeVertexColor", layer_name="Wear")
    yield
    plate().data.color_attributes["Wear"].data[0].color = (0.2, 0.2, 0.2, 1.0)


@felt
def attribute(folder):
    plate().data.attributes.new("wear", "FLOAT", "POINT")
    add_node("ShaderNodeAttribute", "Fac", attribute_name="wear")
    yield
    plate().data.attributes["wear"].data[0].value = 0.2


@felt
def input_of_geometry_nodes(folder):
    group = bpy.data.node_groups.new("Wearing", "GeometryNodeTree")
    sockets = group.interface
    sockets.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    wear = sockets.new_socket("Wear", in_out="INPUT", socket_type="NodeSocketFloat").identifier
    sockets.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    store = group.nodes.new("GeometryNodeStoreNamedAttribute")
    store.inputs["Name"].default_value = "wear"
    for source, target in ((start.outputs[0], store.inputs[0]), (start.outputs[1], store.inputs["Value"])):
        group.links.new(source, target)
    group.links.new(store.outputs[0], end.inputs[0])
    modifier = plate().modifiers.new("Wearing", "NODES")
    modifier.node_group, modifier[wear] = group, 0.2
    add_node("ShaderNodeAttribute", "Fac", attribute_name="wear")
    yield
    plate().modifiers["Wearing"][wear] = 0.8
    plate().update_tag()


@felt
def box_of_generated_coordinates(folder):
    add_node("ShaderNodeTexCoord", "Generated")
    yield
    plate().data.use_auto_texspace = False
    plate().data.texspace_size = (3.0, 3.0, 3.0)


@felt
def box_of_a_radial_tangent(folder):
    add_node("ShaderNodeTangent", direction_type="RADIAL")
    yield
    plate().data.use_auto_texspace = False
    plate().data.texspace_location = (0.02, 0.01, 0.0)


@felt
def box_of_a_tangent_of_the_surface(folder):
    add_node("ShaderNodeNewGeometry", "Tangent")
    yield
    plate().data.use_auto_texspace = False
    plate().data.texspace_location = (0.02, 0.01, 0.0)


@felt
def face_of_another_slot(folder):
    plate().data.materials.append(bump_material("Other", height=1e-4))
    yield
    plate().data.polygons[0].material_index = 1


@felt
def material_of_the_slot(folder):
    bump_material("Other", height=1e-4)
    yield
    plate().material_slots[0].material = bpy.data.materials["Other"]


@felt
def scale_of_the_object(folder):
    yield
    plate().scale.y = 1.01


@felt
def colour_of_the_object(folder):
    add_node("ShaderNodeObjectInfo", "Color")
    yield
    plate().color = (0.5, 0.5, 0.5, 1.0)


@felt
def property_of_the_object(folder):
    plate()["wear"] = 0.5
    add_node("ShaderNodeAttribute", "Fac", attribute_type="OBJECT", attribute_name="wear")
    yield
    plate()["wear"] = 0.6


@felt
def property_of_the_world(folder):
    bpy.context.scene.world = bpy.data.worlds.new("Wearing")
    bpy.context.scene.world["wear"] = 0.5
    add_node("ShaderNodeAttribute", "Fac", attribute_type="VIEW_LAYER", attribute_name="wear")
    yield
    bpy.context.scene.world["wear"] = 0.6


@felt
def setting_of_the_scene(folder):
    add_node("ShaderNodeAttribute", "Fac", attribute_type="VIEW_LAYER", attribute_name="render.resolution_x")
    yield
    bpy.context.scene.render.resolution_x = 77


@felt
def property_of_the_scene(folder):
    bpy.context.scene["wear"] = 0.5
    add_node("ShaderNodeAttribute", "Fac", attribute_type="VIEW_LAYER", attribute_name="wear")
    yield
    bpy.context.scene["wear"] = 0.6


@unfelt
def nothing(folder):
    yield


@unfelt
def camera_and_light(folder):
    for name, data in (("Camera", bpy.data.cameras.new("Camera")), ("Sun", bpy.data.lights.new("Sun", "SUN"))):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))
    yield
    bpy.data.objects["Camera"].location = (0.1, 0.2, 0.3)
    bpy.data.objects["Sun"].rotation_euler = (0.1, 0.2, 0.3)
    bpy.data.lights["Sun"].energy = 7.0


@unfelt
def another_object(folder):
    yield
    bpy.data.objects["Aside"].location.z += 0.1
    bpy.data.objects["Beside"].location.z += 0.1


@unfelt
def place_of_plate_and_stroke(folder):
    yield
    for name in (PLATE, "Along"):
        bpy.data.objects[name].location = (0.3, 0.2, 0.1)


@unfelt
def another_frame(folder):
    bpy.context.scene.frame_set(1)
    yield
    bpy.context.scene.frame_set(7)


@unfelt
def layer_that_no_shader_reads(folder):
    plate().data.attributes.new("wear", "FLOAT", "POINT")
    yield
    plate().data.attributes["wear"].data[0].value = 0.2
    plate().color, plate()["wear"], bpy.context.scene["wear"] = (0.5, 0.5, 0.5, 1.0), 0.5, 0.5


@unfelt
def looks_of_the_node_tree(folder):
    yield
    bump = node("ShaderNodeBump")
    bump.location, bump.label, bump.use_custom_color = (500.0, 100.0), "ridges", True


@unfelt
def other_frames_of_a_sequence(folder):
    for number in (1, 2, 3):
        write_picture(folder / f"worn_{number:04d}.bmp", 0.2 * number)
    add_picture(folder / "worn_0001.bmp", "SEQUENCE", frame_duration=3, use_auto_refresh=True)
    bpy.context.scene.frame_set(2)
    yield
    write_picture(folder / "worn_0003.bmp", 0.9)


@unfelt
def world_and_render_settings(folder):
    yield
    bpy.context.scene.world = bpy.data.worlds.new("Bright")
    bpy.context.scene.render.resolution_x = 123
    bpy.context.scene.view_settings.exposure = 1.0


@unfelt
def packed_picture_unpacked(folder):
    add_picture(write_picture(folder / "worn.bmp", 0.2)).image.pack()
    yield
    node("ShaderNodeTexImage").image.unpack(method="USE_ORIGINAL")
