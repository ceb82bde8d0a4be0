"""How a cloud of splats shows in the viewport: ellipsoids by Geometry Nodes, one set of nodes for all clouds of which
the same share is shown (Blender 5.2 takes no value for a modifier's input under the names that 4.2 to 5.0 know).

Native splats of Blender 5.3 and later are not used: no such Blender could be tried.
"""

from __future__ import annotations

from typing import Any

from hnf_core.scene.splats.harmonics import C0

from .. import compat
from .splat_cloud import HARMONIC_ATTRIBUTE, OPACITY_ATTRIBUTE, ROTATION_ATTRIBUTE, SCALE_ATTRIBUTE

GROUP_NAME = "HNF Splats"
MODIFIER_NAME = "Splats"
MATERIAL_NAME = "HNF Splats"
MAX_SHOWN_SPLATS = 100_000
"""Ellipsoids of one cloud in the viewport. Each is an instance that every redraw walks over."""
ELLIPSOID_RADIUS = 1.5
"""Of an ellipsoid, in standard deviations: they then just close the surface they stand for."""


def show_ellipsoids(cloud: Any) -> None:
    """Give a cloud its modifier. Of more than MOST_SHOWN splats every second, third, … is shown."""
    modifier = cloud.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _get_node_group(get_display_stride(len(cloud.data.vertices)))


def get_display_stride(count: int) -> int:
    """1: all of so many splats are shown; 2: every second."""
    return max(1, -(-count // MAX_SHOWN_SPLATS))


def _get_node_group(stride: int) -> Any:
    """The node group that shows every splat, every second, …; made once in a file."""
    import bpy

    name = GROUP_NAME if stride == 1 else f"{GROUP_NAME}, 1 of {stride}"
    found = bpy.data.node_groups.get(name)
    if found is not None and found.bl_idname == "GeometryNodeTree" and found.library is None:
        return found
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Splats", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Ellipsoids", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    given, result = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    ball = nodes.new("GeometryNodeMeshIcoSphere")
    ball.inputs["Subdivisions"].default_value, ball.inputs["Radius"].default_value = 1, ELLIPSOID_RADIUS
    dressed = nodes.new("GeometryNodeSetMaterial")
    dressed.inputs["Material"].default_value = _get_splat_material()
    index, rest = nodes.new("GeometryNodeInputIndex"), nodes.new("FunctionNodeCompare")
    part = nodes.new("ShaderNodeMath")
    part.operation, rest.data_type, rest.operation = "MODULO", "FLOAT", "LESS_THAN"
    rest.inputs["B"].default_value = 0.5
    instances = nodes.new("GeometryNodeInstanceOnPoints")
    link(ball.outputs["Mesh"], dressed.inputs["Geometry"])
    link(index.outputs[0], part.inputs[0])
    part.inputs[1].default_value = float(stride)
    link(part.outputs[0], rest.inputs["A"])
    link(rest.outputs["Result"], instances.inputs["Selection"])
    link(given.outputs["Splats"], instances.inputs["Points"])
    link(dressed.outputs["Geometry"], instances.inputs["Instance"])
    link(_add_named_attribute(nodes, ROTATION_ATTRIBUTE, "QUATERNION"), instances.inputs["Rotation"])
    link(_add_named_attribute(nodes, SCALE_ATTRIBUTE, "FLOAT_VECTOR"), instances.inputs["Scale"])
    link(instances.outputs["Instances"], result.inputs["Ellipsoids"])
    for column, node in enumerate(nodes):
        node.location = (column * 180.0, 0.0)
    return group


def _add_named_attribute(nodes: Any, name: str, kind: str) -> Any:
    node = nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(output for output in node.outputs if output.enabled and output.name == "Attribute")


def _get_splat_material() -> Any:
    """The splats' own colour, unlit: the harmonics' constant part, which is what is left of them without a view."""
    import bpy

    found = bpy.data.materials.get(MATERIAL_NAME)
    if found is not None and found.library is None:
        return found
    material = bpy.data.materials.new(MATERIAL_NAME)
    compat.switch_nodes_on(material)
    tree = material.node_tree
    tree.nodes.clear()
    constant, opacity = (
        _add_instance_attribute(tree, name) for name in (HARMONIC_ATTRIBUTE.format(0), OPACITY_ATTRIBUTE)
    )
    colour = tree.nodes.new("ShaderNodeVectorMath")
    colour.operation = "MULTIPLY_ADD"
    colour.inputs[1].default_value, colour.inputs[2].default_value = (C0,) * 3, (0.5,) * 3
    shown = tree.nodes.new("ShaderNodeVectorMath")
    shown.operation = "MAXIMUM"
    linear = tree.nodes.new("ShaderNodeGamma")
    linear.inputs["Gamma"].default_value = 2.2
    glow, clear = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeBsdfTransparent")
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    link = tree.links.new
    link(constant.outputs["Vector"], colour.inputs[0])
    link(colour.outputs["Vector"], shown.inputs[0])
    link(shown.outputs["Vector"], linear.inputs["Color"])
    link(linear.outputs["Color"], glow.inputs["Color"])
    link(opacity.outputs["Fac"], mix.inputs[0])
    link(clear.outputs[0], mix.inputs[1])
    link(glow.outputs[0], mix.inputs[2])
    link(mix.outputs[0], output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (column * 180.0, 0.0)
    return material


def _add_instance_attribute(tree: Any, name: str) -> Any:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_type, node.attribute_name = "INSTANCER", name
    return node
