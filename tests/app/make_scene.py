"""Run by Blender: a 100 mm square with a sine bump, saved to the path after `--`."""

import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_plane_add(size=0.1)
material = bpy.data.materials.new("Ribs")
if material.node_tree is None:
    material.use_nodes = True
nodes, links = material.node_tree.nodes, material.node_tree.links
wave, bump = nodes.new("ShaderNodeTexWave"), nodes.new("ShaderNodeBump")
wave.inputs["Scale"].default_value = 20.0
bump.inputs["Distance"].default_value = 1e-4
shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
links.new(wave.outputs["Fac"], bump.inputs["Height"])
links.new(bump.outputs["Normal"], shader.inputs["Normal"])
bpy.context.object.data.materials.append(material)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1])
