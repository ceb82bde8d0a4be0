"""Small objects and materials to touch."""

from __future__ import annotations

import bpy
import numpy as np


def datablock_names() -> dict[str, list[str]]:
    """Every datablock's name by collection: what must be equal before and after a call that only looks."""
    names = {}
    for prop in bpy.data.bl_rna.properties:
        if prop.type == "COLLECTION" and prop.identifier != "all_ids":  # those of Blender 5.2, once more
            names[prop.identifier] = sorted(block.name_full for block in getattr(bpy.data, prop.identifier))
    return names


def add_mesh(name: str, vertices, faces, *, uv=None, smooth=False, collection=None):
    """An object with a new mesh; uv: function of a vertex position → (u, v)."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, vertex)) for vertex in vertices], [], [tuple(face) for face in faces])
    if uv is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        for loop in mesh.loops:
            layer.data[loop.index].uv = uv(mesh.vertices[loop.vertex_index].co)
    mesh.update()
    if smooth:
        mesh.shade_smooth()
    obj = bpy.data.objects.new(name, mesh)
    (collection or bpy.context.scene.collection).objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def add_plane(name: str = "Plane", size: float = 0.1, z: float = 0.0):
    """A square of side size around the origin, facing +z, one UV unit a metre."""
    half = size / 2.0
    corners = [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]
    return add_mesh(name, corners, [(0, 1, 2, 3)], uv=lambda co: (co.x, co.y))


def add_sphere(name: str = "Ball", radius: float = 0.05, segments: int = 48, rings: int = 24):
    """A UV sphere with smooth shading and UVs."""
    import bmesh

    mesh = bpy.data.meshes.new(name)
    ball = bmesh.new()
    ball.loops.layers.uv.new("UVMap")
    bmesh.ops.create_uvsphere(ball, u_segments=segments, v_segments=rings, radius=radius, calc_uvs=True)
    ball.to_mesh(mesh)
    ball.free()
    mesh.shade_smooth()
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def bump_material(name: str = "Bumpy", *, wavelength: float = 2e-3, height: float = 1e-4, distance: float = 1e-3):
    """A sine bump along UV x (one UV unit a metre): peak-to-peak height `height`, Strength 1."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    coordinates, split = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeSeparateXYZ")
    links.new(coordinates.outputs["UV"], split.inputs[0])
    phase = math_node(material, "MULTIPLY", split.outputs["X"], 2.0 * np.pi / wavelength)
    sine = math_node(material, "SINE", phase)
    scaled = math_node(material, "MULTIPLY", sine, 0.5 * height / distance)
    bump = nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = 1.0, distance
    links.new(scaled, bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def math_node(material, operation: str, first, second: float | None = None):
    """Output socket of a new Math node on a socket and, where given, a constant."""
    node = material.node_tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    material.node_tree.links.new(first, node.inputs[0])
    if second is not None:
        node.inputs[1].default_value = second
    return node.outputs[0]


def float_image(name: str, pixels: np.ndarray):
    """A Non-Color float image from (H, W, 3) values, bottom row first, kept in the file."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True, is_data=True)
    rgba = np.concatenate([pixels, np.ones((height, width, 1))], axis=-1).astype(np.float32)
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    image.pack()
    return image
