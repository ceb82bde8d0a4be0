"""Patches to look at, and what should be seen there."""

from __future__ import annotations

import bpy
import numpy as np
from builders import add_plane, bump_material

from hnf_blender.bridge.render.closeup import render_closeup
from hnf_core.scene.patch import Patch

PIXELS = 64
UP = np.array([0.0, 0.0, 1.0])


def patch(x=0.0, y=0.0, x_axis=(1.0, 0.0, 0.0), slot=0, z=0.0):
    return Patch(np.array([x, y, z]), np.array(x_axis, dtype=float), UP, slot)


def look(obj, where=None, **options):
    bpy.context.view_layer.update()
    return render_closeup(obj, where or patch(), pixels=options.pop("pixels", PIXELS), **options)


def plane_coordinates(close):
    """(x, y) of every pixel in the patch frame, y up."""
    side = (np.arange(close.mask.shape[0]) + 0.5) * close.metres_per_pixel - close.patch.size_m / 2.0
    return np.meshgrid(side, -side)


def bumpy_plane(**options):
    plane = add_plane()
    plane.data.materials.append(bump_material(**options))
    return plane


def principled(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def bump_of(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBump")


def assert_sine(close, amplitude, wavelength=2e-3, axis=0):
    """The height is amplitude · sin(2π x / wavelength), to 1 % of the amplitude."""
    expected = amplitude * np.sin(2.0 * np.pi * plane_coordinates(close)[axis] / wavelength)
    expected = expected - expected[close.mask].mean()
    np.testing.assert_allclose(close.height[close.mask], expected[close.mask], atol=0.01 * abs(amplitude))
