"""Colours that lie on a mesh's own points, and a material that shows them."""

from __future__ import annotations

from typing import Any

from .. import compat


def show_vertex_colours(obj: Any) -> None:
    """A scan's colours lie on its points, and its file names no material: give it one that shows them. Nothing happens
    to what is no mesh, has a material, or has no colours."""
    import bpy

    if obj.type != "MESH" or obj.data.materials or not obj.data.color_attributes:
        return
    material = bpy.data.materials.new(obj.name)
    compat.switch_nodes_on(material)
    tree = material.node_tree
    painted = tree.nodes.new("ShaderNodeVertexColor")
    painted.layer_name = obj.data.color_attributes[0].name
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(painted.outputs["Color"], shader.inputs["Base Color"])
    obj.data.materials.append(material)
