"""The unlit colour of points on an object, read from pictures of it taken from all round and close by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_blender.bridge.appearance import mix_closures, read_shading_value
from hnf_blender.bridge.meshes import Surface, make_ray_caster
from hnf_blender.bridge.render import (
    add_aovs,
    add_camera,
    configure_cycles,
    disable_lighting,
    render_passes,
    set_camera,
)
from hnf_blender.bridge.stage import instrument_slot, isolate_object
from hnf_blender.bridge.taps import Passes
from hnf_blender.bridge.temporary import TemporaryScene
from hnf_core.scene.camera import Camera, orthographic
from hnf_core.scene.raycast import cast_view

from .sampling import Samples

Float = NDArray[np.float64]

DEFAULT_GREY = 0.8
"""Of what has no material."""
MIN_FACING_COSINE = 0.15
"""Cosine below which a picture says nothing of a surface: 81°."""
MAX_PIXELS = 1024
CAMERA_TILT = np.array([0.1, 0.2, 0.3])
"""So that no image axis is along an edge of the cube."""


def make_surrounding_cameras(mesh_points: Float, pixel_m: float) -> tuple[Camera, ...]:
    """Orthographic cameras that see all of points (n, 3) from the faces and the corners of a cube."""
    low, high = mesh_points.min(axis=0), mesh_points.max(axis=0)
    middle, radius = (low + high) / 2.0, 1.01 * float(np.linalg.norm(high - low)) / 2.0
    pixels = int(np.clip(np.ceil(2.0 * radius / pixel_m), 64, MAX_PIXELS))
    signs = np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).reshape(3, -1).T
    outward = [sign / np.linalg.norm(sign) for sign in signs if np.count_nonzero(sign) in (1, 3)]
    return tuple(
        orthographic(middle, np.roll(normal, 1) + CAMERA_TILT, normal, 2.0 * radius, pixels, 1.1 * radius)
        for normal in outward
    )


def make_patch_camera(point: Float, normal: Float, reach_m: float, pixel_m: float) -> Camera:
    across = np.eye(3)[int(np.argmin(np.abs(normal)))]
    pixels = int(np.clip(np.ceil(2.0 * reach_m / pixel_m), 16, MAX_PIXELS))
    return orthographic(point, across, normal, 2.0 * reach_m, pixels, reach_m)


def render_unlit_colours(
    obj: Any, surface: Surface, samples: Samples, cameras: Sequence[Camera], metres_per_unit: float
) -> NDArray[np.float32]:
    """(n, 3) linear. Each point takes its colour from the camera that sees it largest: most pixels a metre across it.
    What none sees has its material slot's mean. Raises SceneError for a missing texture."""
    best = np.zeros(len(samples))
    colour = np.full((len(samples), 3), np.nan)
    for camera, albedo, depth in _render_views(obj, surface, cameras, metres_per_unit):
        uv, z = camera.project(samples.position)
        facing = -(samples.normal @ camera.pose[:3, 2])
        score = np.where(facing > MIN_FACING_COSINE, facing * camera.intrinsics[0, 0], 0.0)
        inside = (uv >= 0.5).all(axis=1) & (uv <= np.array([camera.width, camera.height]) - 0.5).all(axis=1)
        asked = np.flatnonzero(inside & (score > best))
        # One pixel across a slope is as deep as the slope is steep.
        slack = 2.0 / camera.intrinsics[0, 0] / np.maximum(facing[asked], MIN_FACING_COSINE)
        found, seen = _interpolate_colours(albedo, depth, uv[asked], z[asked], slack)
        colour[asked[seen]], best[asked[seen]] = found[seen], score[asked[seen]]
    slots = surface.mesh.slot[samples.triangle]
    for slot in np.unique(slots):
        own = slots == slot
        known = own & (best > 0.0)
        colour[own & ~known] = colour[known].mean(axis=0) if known.any() else DEFAULT_GREY
    return colour.astype(np.float32)


def _render_views(
    obj: Any, surface: Surface, cameras: Sequence[Camera], metres_per_unit: float
) -> Iterator[tuple[Camera, Float, Float]]:
    """Camera, linear colour (H, W, 3) and depth (H, W) of each: one sample a pixel, as a close-up."""
    with TemporaryScene() as temporary:
        configure_cycles(temporary.scene, samples=1)
        disable_lighting(temporary.scene)
        stage = isolate_object(temporary, obj, metres_per_unit, None, surface)
        caster = make_ray_caster(surface.mesh)
        slots = [int(slot) for slot in np.unique(surface.mesh.slot)]
        readings = {slot: instrument_slot(stage, slot, f"object '{obj.name}'") for slot in slots}
        taps = [tap for reading in readings.values() for tap in reading.taps]
        add_aovs(temporary.view_layer, taps)
        eye = add_camera(temporary)
        temporary.scene.render.use_persistent_data = True
        for camera in cameras:
            passes: Passes = {}
            if taps:
                set_camera(temporary.scene, eye, camera, stage.rigid, stage.metres_per_unit)
                passes = render_passes(temporary)
            seen = cast_view(caster, surface.mesh, camera)
            slot_of = np.where(seen.triangle >= 0, surface.mesh.slot[seen.triangle], -1)
            albedo = np.full((*slot_of.shape, 3), DEFAULT_GREY)
            for slot, reading in readings.items():
                layers = reading.reading.layers
                value = (
                    None
                    if layers is None
                    else mix_closures(layers, passes, partial(read_shading_value, "base_color", passes))
                )
                if value is not None:
                    own = slot_of == slot
                    albedo[own] = np.broadcast_to(value, albedo.shape)[own]
            yield camera, np.clip(np.nan_to_num(albedo), 0.0, 1.0), seen.depth


def _interpolate_colours(
    albedo: Float, depth: Float, uv: Float, z: Float, slack: Float
) -> tuple[Float, NDArray[np.bool_]]:
    """Bilinear colour at uv (n, 2) from those of the four pixels around that lie at depth z (n,) ± slack; and whether
    more than half of the weight was there."""
    corner = np.floor(uv - 0.5).astype(np.intp)
    share = uv - 0.5 - corner
    total, weight = np.zeros((len(uv), 3)), np.zeros(len(uv))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column = np.minimum(corner[:, 0] + right, depth.shape[1] - 1)
        row = np.minimum(corner[:, 1] + down, depth.shape[0] - 1)
        part = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
        part = np.where(np.abs(depth[row, column] - z) <= slack, part, 0.0)
        total += part[:, None] * albedo[row, column]
        weight += part
    return total / np.maximum(weight, 1e-300)[:, None], weight > 0.5
