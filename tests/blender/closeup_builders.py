"""Patches to look at, and what should be seen there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from builders import add_plane, bump_material
from numpy.typing import NDArray

from hnf_blender.bridge.closeup import CloseUp, CloseUpRenderer
from hnf_blender.bridge.cycles import add_camera, configure_cycles, render_passes, set_camera
from hnf_blender.bridge.isolated_object import isolate_object
from hnf_blender.bridge.lit_render import add_dome
from hnf_blender.bridge.scene.temp_scene import TemporaryScene
from hnf_core.scene.camera import Camera, Patch

PIXELS = 64
UP = np.array([0.0, 0.0, 1.0])


def patch(x=0.0, y=0.0, x_axis=(1.0, 0.0, 0.0), slot=0, z=0.0):
    return Patch(np.array([x, y, z]), np.array(x_axis, dtype=float), UP, slot)


def render_closeup(obj: Any, patch: Patch, **options: Any) -> CloseUp:
    """render_closeups of one patch."""
    return render_closeups(obj, [patch], **options)[0]


def render_closeups(obj: Any, patches: Sequence[Patch], *, samples: int | None = None, **options: Any) -> list[CloseUp]:
    """A close-up of each patch. samples: also light the patches with a neutral dome and render the original shader
    with so many samples (rgb)."""
    with CloseUpRenderer(obj, patches, **options) as renderer:
        made = [renderer.render(patch) for patch in patches]
    if samples and made:
        pictures = render_lit_images(obj, [each.view.camera for each in made], samples)
        made = [
            replace(each, view=replace(each.view, rgb=rgb), renders=each.renders + 1)
            for each, rgb in zip(made, pictures, strict=True)
        ]
    return made


def render_lit_images(obj: Any, cameras: Sequence[Camera], samples: int) -> list[NDArray[np.float32]]:
    """(H, W, 3) linear pictures of obj alone under a neutral dome; cameras in its surface frame. One render each."""
    with TemporaryScene() as temporary:
        configure_cycles(temporary.scene, samples)
        stage = isolate_object(temporary, obj, 1.0, None)
        add_dome(temporary.scene)
        camera_object = add_camera(temporary)
        temporary.scene.render.use_persistent_data = len(cameras) > 1
        pictures = []
        for camera in cameras:
            set_camera(temporary.scene, camera_object, camera, stage.rigid, stage.metres_per_unit)
            pictures.append(np.ascontiguousarray(render_passes(temporary)["Combined"][..., :3]))
    return pictures


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
