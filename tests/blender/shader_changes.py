"""Ways to change a shader and its pictures; see changes.py."""

from __future__ import annotations

import os

import bpy
from changes import FELT, add_empty, add_group, add_node, add_picture, felt, node, plate, tree, write_picture


@felt
def node_value(folder):
    yield
    node("ShaderNodeBump").inputs["Distance"].default_value *= 1.0 + 1e-5


@felt
def value_inside_a_group(folder):
    made = add_group("ShaderNodeValue")
    yield
    made[1].outputs[0].default_value = 0.1


@felt
def output_of_a_group(folder):
    first = add_group("ShaderNodeValue")[0]
    second = first.id_data.nodes.new("NodeGroupOutput")
    first.is_active_output, second.is_active_output = True, False
    yield
    second.is_active_output = True


@felt
def output_of_the_material(folder):
    first, second = node("ShaderNodeOutputMaterial"), tree().nodes.new("ShaderNodeOutputMaterial")
    bump, glass, links = tree().nodes.new("ShaderNodeBump"), tree().nodes.new("ShaderNodeBsdfGlass"), tree().links
    links.new(node("ShaderNodeBump").inputs["Height"].links[0].from_socket, bump.inputs["Height"])
    links.new(bump.outputs[0], glass.inputs["Normal"])
    links.new(glass.outputs[0], second.inputs[0])
    first.is_active_output, second.is_active_output = True, False
    yield
    second.is_active_output = True


@felt
def driven_value(folder):
    value, control = add_node("ShaderNodeValue"), add_empty()
    control["wear"] = 0.1
    driver = value.outputs[0].driver_add("default_value").driver
    target = driver.variables.new()
    target.name, driver.expression = "wear", "wear"
    target.targets[0].id, target.targets[0].data_path = control, '["wear"]'
    yield
    control["wear"] = 0.2
    control.update_tag()


@felt
def animated_value(folder):
    socket = add_node("ShaderNodeValue").outputs[0]
    for frame in (1, 10):
        socket.default_value = 0.1 * frame
        socket.keyframe_insert("default_value", frame=frame)
    bpy.context.scene.frame_set(1)
    yield
    bpy.context.scene.frame_set(6)


@felt
def handle_of_a_curve(folder):
    curve = add_node("ShaderNodeFloatCurve").mapping
    curve.curves[0].points.new(0.3, 0.8)
    curve.update()
    yield
    node("ShaderNodeFloatCurve").mapping.curves[0].points[1].handle_type = "VECTOR"


@felt
def hues_of_a_ramp(folder):
    add_node("ShaderNodeValToRGB").color_ramp.color_mode = "HSV"
    yield
    node("ShaderNodeValToRGB").color_ramp.hue_interpolation = "FAR"


@felt
def direction_of_a_normal_node(folder):
    add_node("ShaderNodeNormal", "Dot")
    yield
    node("ShaderNodeNormal").outputs[0].default_value = (0.6, 0.0, 0.8)


@felt
def object_that_gives_coordinates(folder):
    add_node("ShaderNodeTexCoord", "Object", object=add_empty())
    yield
    bpy.data.objects["Control"].location.x = 0.1


@felt
def turn_of_what_looks_at_its_normal_in_the_world(folder):
    add_node("ShaderNodeNewGeometry", "Normal")
    yield
    plate().rotation_euler.z = bpy.data.objects["Along"].rotation_euler.z = 0.3


@felt
def pixel_of_a_file_of_equal_size_and_time(folder):
    path = write_picture(folder / "worn.bmp", 0.2)
    before = path.stat()
    add_picture(path)
    yield
    data = write_picture(folder / "other.bmp", 0.7).read_bytes()
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)


@felt
def pixel_of_a_packed_picture(folder):
    add_picture(write_picture(folder / "worn.bmp", 0.2)).image.pack()
    yield
    image = node("ShaderNodeTexImage").image
    image.pixels[0] = 0.9
    image.pack()


@felt
def pixel_painted_and_not_saved(folder):
    add_picture(write_picture(folder / "worn.bmp", 0.2)).image.pack()
    yield
    node("ShaderNodeTexImage").image.pixels[0] = 0.9


@felt
def colour_of_a_generated_picture(folder):
    add_node("ShaderNodeTexImage").image = bpy.data.images.new("Blank", 8, 8)
    yield
    bpy.data.images["Blank"].generated_color = (0.5, 0.5, 0.5, 1.0)


@felt
def colour_space(folder):
    add_picture(write_picture(folder / "worn.bmp", 0.2))
    yield
    node("ShaderNodeTexImage").image.colorspace_settings.name = "sRGB"


@felt
def unpacked_and_then_changed(folder):
    path = write_picture(folder / "worn.bmp", 0.2)
    add_picture(path).image.pack()
    yield
    node("ShaderNodeTexImage").image.unpack(method="USE_ORIGINAL")
    write_picture(path, 0.7)


@felt
def frame_of_a_sequence(folder):
    for number in (1, 2, 3):
        write_picture(folder / f"worn_{number:04d}.bmp", 0.2 * number)
    add_picture(folder / "worn_0001.bmp", "SEQUENCE", frame_duration=3, use_auto_refresh=True)
    bpy.context.scene.frame_set(1)
    yield
    bpy.context.scene.frame_set(2)


@felt
def file_of_the_shown_frame(folder):
    for number in (1, 2, 3):
        write_picture(folder / f"worn_{number:04d}.bmp", 0.2 * number)
    add_picture(folder / "worn_0001.bmp", "SEQUENCE", frame_duration=3, use_auto_refresh=True)
    bpy.context.scene.frame_set(2)
    yield
    write_picture(folder / "worn_0002.bmp", 0.9)


@felt
def tile(folder):
    for number in (1001, 1002):
        write_picture(folder / f"worn.{number}.bmp", 0.2)
    image = add_picture(folder / "worn.1001.bmp").image
    image.filepath, image.source = str(folder / "worn.<UDIM>.bmp"), "TILED"
    if len(image.tiles) < 2:
        image.tiles.new(1002)
    yield
    write_picture(folder / "worn.1002.bmp", 0.7)


__all__ = ["FELT"]
