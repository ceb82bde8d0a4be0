"""A reconstruction → Blender objects: the surface that is touched, and under it the splats that it is seen in."""

from __future__ import annotations

from typing import Any

import numpy as np

from .painted import show_vertex_colours
from .splat_cloud import create_cloud, link_cloud
from .splat_reconstruction import Reconstruction, TouchSurface
from .splat_shown import MAX_SHOWN_SPLATS, get_display_stride, show_ellipsoids

COLOUR_ATTRIBUTE = "Color"
"""Of the surface's points."""


def add_reconstruction(scene: Any, reconstruction: Reconstruction) -> Any:
    """The surface object, in scene's collection, upright; its splats are its child '<name> splats'.

    Both keep the file's frame and unit as their own; the surface's rotation turns the file's up to +z.
    """
    import bpy

    surface = bpy.data.objects.new(reconstruction.name, _create_mesh(reconstruction.name, reconstruction.surface))
    cloud = create_cloud(f"{reconstruction.name} splats", reconstruction.splats, reconstruction.source)
    for obj in (surface, cloud):
        scene.collection.objects.link(obj)
    notes = [f"object '{reconstruction.name}': {warning}" for warning in reconstruction.surface.warnings]
    link_cloud(surface, cloud, notes)
    show_vertex_colours(surface)
    show_ellipsoids(cloud)
    surface.rotation_mode = "QUATERNION"
    surface.rotation_quaternion = _compute_upright_rotation(reconstruction.up)
    return surface


def describe_shown_splats(reconstruction: Reconstruction) -> str:
    """What the viewport leaves out of so many splats; "" where it shows all."""
    every = get_display_stride(len(reconstruction.splats))
    if every == 1:
        return ""
    return f"the viewport shows one in {every} of its {len(reconstruction.splats)} splats ({MAX_SHOWN_SPLATS} at most); all are felt."


def _create_mesh(name: str, surface: TouchSurface) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    count = len(surface.triangles)
    mesh.vertices.add(len(surface.vertices))
    mesh.vertices.foreach_set("co", surface.vertices.ravel())
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", surface.triangles.ravel())
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(count, dtype=np.bool_))
    mesh.update(calc_edges=True)
    colour = mesh.color_attributes.new(COLOUR_ATTRIBUTE, "FLOAT_COLOR", "POINT")
    opaque = np.ones((len(surface.vertices), 4), dtype=np.float32)
    opaque[:, :3] = surface.colour
    colour.data.foreach_set("color", opaque.ravel())
    mesh.color_attributes.active_color_index = mesh.color_attributes.render_color_index = 0
    return mesh


def _compute_upright_rotation(up: tuple[float, float, float]) -> Any:
    """The shortest turn that brings up to +z; about x where it points straight down."""
    from mathutils import Quaternion, Vector

    if up[2] < -0.999999:
        return Quaternion((0.0, 1.0, 0.0, 0.0))
    return Vector(up).rotation_difference(Vector((0.0, 0.0, 1.0)))
