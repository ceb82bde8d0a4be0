"""Things to touch, and strokes on them, made inside the running Blender."""

import math

import bpy


def empty_room() -> None:
    """A new file with nothing in it; preferences and windows stay."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.preferences.view.show_splash = False


def ribbed_material(name: str = "Ribs", scale: float = 20.0, height_m: float = 1e-4):
    """A wave in the bump node: relief that the measured route reads."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    wave, bump = nodes.new("ShaderNodeTexWave"), nodes.new("ShaderNodeBump")
    wave.inputs["Scale"].default_value = scale
    bump.inputs["Distance"].default_value = height_m
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(wave.outputs["Fac"], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def plate(name: str = "Plate", size_m: float = 0.1, cuts: int = 1, at=(0.0, 0.0, 0.0), material=None):
    """A square of cuts² faces, ribbed, at a place."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cuts, y_subdivisions=cuts, size=size_m, location=at)
    obj = bpy.context.view_layer.objects.active
    obj.name = name
    obj.data.materials.append(material or ribbed_material())
    return obj


def stroke_on(target, name: str = "Stroke", length_m: float = 0.06, seconds: float = 0.6, turned: float = 0.0):
    """A straight stroke across a plate, a tenth of a millimetre above it, with two force keys: 1 N and 2 N."""
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    half = (0.5 * length_m * math.cos(turned), 0.5 * length_m * math.sin(turned))
    place = target.matrix_world.translation
    for point, sign in zip(spline.points, (-1, 1), strict=True):
        point.co = (place.x + sign * half[0], place.y + sign * half[1], place.z + 1e-4, 1.0)
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    group = obj.hnf_stroke
    group.is_stroke, group.surface, group.law, group.duration_s = True, target, "DURATION", seconds
    for frame, force in ((1.0, 1.0), (1.0 + seconds * bpy.context.scene.render.fps, 2.0)):
        group.force = force
        obj.keyframe_insert("hnf_stroke.force", frame=frame)
    bpy.context.view_layer.update()
    return obj


def look_at(stage, obj, top: bool = True):
    """Frame an object in the 3-D view, from above."""
    with stage.over():
        bpy.ops.object.select_all(action="DESELECT")
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj
        if top:
            bpy.ops.view3d.view_axis(type="TOP")
        bpy.ops.view3d.view_selected(use_all_regions=False)
    yield 0.6  # smooth view
