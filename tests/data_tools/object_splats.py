"""Objects as flat, opaque Gaussian splats on their surface, as large as their spacing, in world metres.

The unlit colour of each point is read from images of the object taken from all sides and from close by. The patches
that the strokes of a scene touch can be found without rendering a close-up of any.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_tools.mesh_sampling import Samples, sample_mesh
from hnf_blender.bridge.cycles import (
    add_aovs,
    add_camera,
    configure_cycles,
    disable_lighting,
    render_passes,
    set_camera,
)
from hnf_blender.bridge.isolated_object import instrument_slot, isolate_object
from hnf_blender.bridge.scene.meshes import Surface, make_ray_caster
from hnf_blender.bridge.scene.temp_scene import TemporaryScene
from hnf_blender.bridge.shader.aov_taps import Passes
from hnf_blender.bridge.shader.closures import mix_closures, read_shading_value
from hnf_blender.touch.report import Counts
from hnf_blender.touch.session import Session, StrokeJob, gather_jobs
from hnf_core.action.contacts import find_contacts, plan_patches
from hnf_core.errors import SceneError
from hnf_core.scene.camera import PATCH_SIZE_M, Camera, Patch, orthographic
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import cast_view
from hnf_core.scene.splats.gaussians import C0, Splats
from hnf_core.units import linear_to_srgb

Float = NDArray[np.float64]

DEFAULT_GREY = 0.8
"""Linear grey of a surface without a material."""
MIN_FACING_COSINE = 0.15
"""Least cosine between normal and view direction at which a pixel counts: 81°."""
MAX_PIXELS = 1024
CAMERA_TILT = np.array([0.1, 0.2, 0.3])
"""Offset of the up vector that keeps image axes off the edges of the cube."""


def make_surrounding_cameras(mesh_points: Float, pixel_m: float) -> tuple[Camera, ...]:
    """Make orthographic cameras that see all of the points (n, 3) from the faces and corners of a cube."""
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
    """Make an orthographic camera above a point, which sees reach_m to each side."""
    across = np.eye(3)[int(np.argmin(np.abs(normal)))]
    pixels = int(np.clip(np.ceil(2.0 * reach_m / pixel_m), 16, MAX_PIXELS))
    return orthographic(point, across, normal, 2.0 * reach_m, pixels, reach_m)


def render_unlit_colours(
    obj: Any, surface: Surface, samples: Samples, cameras: Sequence[Camera], metres_per_unit: float
) -> NDArray[np.float32]:
    """Render the unlit, linear colour (n, 3) of each sample.

    A point takes its colour from the camera with the most pixels per metre across it. Points that no camera sees take
    the mean of their material slot. Raises SceneError for a missing texture.
    """
    best = np.zeros(len(samples))
    colour = np.full((len(samples), 3), np.nan)
    for camera, albedo, depth in _render_views(obj, surface, cameras, metres_per_unit):
        uv, z = camera.project(samples.position)
        facing = -(samples.normal @ camera.pose[:3, 2])
        score = np.where(facing > MIN_FACING_COSINE, facing * camera.intrinsics[0, 0], 0.0)
        inside = (uv >= 0.5).all(axis=1) & (uv <= np.array([camera.width, camera.height]) - 0.5).all(axis=1)
        candidates = np.flatnonzero(inside & (score > best))
        # The depth range of one pixel grows with the slope of the surface.
        slack = 2.0 / camera.intrinsics[0, 0] / np.maximum(facing[candidates], MIN_FACING_COSINE)
        found, visible = _interpolate_colours(albedo, depth, uv[candidates], z[candidates], slack)
        colour[candidates[visible]], best[candidates[visible]] = found[visible], score[candidates[visible]]
    slots = surface.mesh.slot[samples.triangle]
    for slot in np.unique(slots):
        in_slot = slots == slot
        known = in_slot & (best > 0.0)
        colour[in_slot & ~known] = colour[known].mean(axis=0) if known.any() else DEFAULT_GREY
    return colour.astype(np.float32)


def _render_views(
    obj: Any, surface: Surface, cameras: Sequence[Camera], metres_per_unit: float
) -> Iterator[tuple[Camera, Float, Float]]:
    """Yield each camera with linear colour (H, W, 3) and depth (H, W), rendered as a close-up at one sample a pixel."""
    with TemporaryScene() as temporary:
        configure_cycles(temporary.scene, samples=1)
        disable_lighting(temporary.scene)
        isolated = isolate_object(temporary, obj, metres_per_unit, None, surface)
        caster = make_ray_caster(surface.mesh)
        slots = [int(slot) for slot in np.unique(surface.mesh.slot)]
        readings = {slot: instrument_slot(isolated, slot, f"object '{obj.name}'") for slot in slots}
        taps = [tap for reading in readings.values() for tap in reading.taps]
        add_aovs(temporary.view_layer, taps)
        camera_object = add_camera(temporary)
        temporary.scene.render.use_persistent_data = True
        for camera in cameras:
            passes: Passes = {}
            if taps:
                set_camera(temporary.scene, camera_object, camera, isolated.rigid, isolated.metres_per_unit)
                passes = render_passes(temporary)
            view = cast_view(caster, surface.mesh, camera)
            slot_of = np.where(view.triangle >= 0, surface.mesh.slot[view.triangle], -1)
            albedo = np.full((*slot_of.shape, 3), DEFAULT_GREY)
            for slot, reading in readings.items():
                layers = reading.reading.layers
                value = (
                    None
                    if layers is None
                    else mix_closures(layers, passes, partial(read_shading_value, "base_color", passes))
                )
                if value is not None:
                    in_slot = slot_of == slot
                    albedo[in_slot] = np.broadcast_to(value, albedo.shape)[in_slot]
            yield camera, np.clip(np.nan_to_num(albedo), 0.0, 1.0), view.depth


def _interpolate_colours(
    albedo: Float, depth: Float, uv: Float, z: Float, slack: Float
) -> tuple[Float, NDArray[np.bool_]]:
    """Interpolate colours at uv (n, 2) bilinearly, from those of the four neighbouring pixels at depth z (n,) ± slack.

    Also returns a mask of the points for which more than half of the weight is at that depth.
    """
    corner = np.floor(uv - 0.5).astype(np.intp)
    fraction = uv - 0.5 - corner
    total, weight = np.zeros((len(uv), 3)), np.zeros(len(uv))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column = np.minimum(corner[:, 0] + right, depth.shape[1] - 1)
        row = np.minimum(corner[:, 1] + down, depth.shape[0] - 1)
        corner_weight = np.abs(1 - right - fraction[:, 0]) * np.abs(1 - down - fraction[:, 1])
        corner_weight = np.where(np.abs(depth[row, column] - z) <= slack, corner_weight, 0.0)
        total += corner_weight[:, None] * albedo[row, column]
        weight += corner_weight
    return total / np.maximum(weight, 1e-300)[:, None], weight > 0.5


RADIUS_SPACINGS, THICKNESS_SPACINGS = 0.65, 0.06
"""Standard deviations along and across the surface, in spacings."""
OPACITY = 0.95
FINE_RADIUS_M = 0.8 * PATCH_SIZE_M
"""Radius of fine splats around a patch centre [m]: a little more than half of a patch's diagonal."""
PIXELS_PER_SPACING = 2.0


def sample_object(
    mesh: TriangleMesh, spacing_m: float, seed: int, patches: Sequence[Patch] = (), fine_m: float | None = None
) -> Samples:
    """Sample one object in the surface frame, with points fine_m apart around the patches."""
    return sample_mesh(
        mesh, spacing_m, seed, centres=[patch.centre for patch in patches], reach_m=FINE_RADIUS_M, fine_m=fine_m
    )


def make_object_splats(
    obj: Any,
    surface: Surface,
    spacing_m: float,
    seed: int,
    metres_per_unit: float,
    patches: Sequence[Patch] = (),
    fine_m: float | None = None,
    in_world: bool = True,
) -> Splats:
    """Make splats of degree 0 from one object, in metres of the world or of the surface frame."""
    samples = sample_object(surface.mesh, spacing_m, seed, patches, fine_m)
    cameras = list(make_surrounding_cameras(surface.mesh.vertices, spacing_m / PIXELS_PER_SPACING))
    if fine_m is not None:
        cameras += [
            make_patch_camera(patch.centre, patch.normal, FINE_RADIUS_M, fine_m / PIXELS_PER_SPACING)
            for patch in patches
        ]
    return make_flat_splats(
        samples,
        render_unlit_colours(obj, surface, samples, cameras, metres_per_unit),
        surface.rigid if in_world else np.eye(4),
    )


def make_flat_splats(samples: Samples, linear: NDArray[np.float32], rigid: Float) -> Splats:
    """Make discs on the samples, of linear colour (n, 3); rigid (4, 4) maps the samples' frame to the world."""
    count = len(samples)
    scales = samples.spacing[:, None] * np.array([RADIUS_SPACINGS, RADIUS_SPACINGS, THICKNESS_SPACINGS])
    harmonics = (linear_to_srgb(linear) - 0.5) / C0
    return Splats(
        means=(samples.position @ rigid[:3, :3].T + rigid[:3, 3]).astype(np.float32),
        scales=scales.astype(np.float32),
        rotations=compute_rotations_from_z(samples.normal @ rigid[:3, :3].T).astype(np.float32),
        opacities=np.full(count, OPACITY, dtype=np.float32),
        harmonics=harmonics[:, None, :].astype(np.float32),
    )


def compute_rotations_from_z(normals: Float) -> Float:
    """Compute unit quaternions w x y z (n, 4) of the shortest turn from +z to unit normals (n, 3)."""
    x, y, z = normals.T
    turn = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    turn[1.0 + z < 1e-12] = [0.0, 1.0, 0.0, 0.0]
    return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True))


def concatenate_splats(clouds: Sequence[Splats]) -> Splats:
    return Splats(*(np.concatenate([getattr(part, name) for part in clouds])
                    for name in ("means", "scales", "rotations", "opacities", "harmonics")))  # fmt: skip


def find_touched_patches(session: Session) -> dict[str, tuple[Patch, ...]]:
    """Find the patches touched on each object, by its name, in the surface frame.

    A scene without strokes gets the default ones. Raises SceneError where a stroke cannot be read.
    """
    found = gather_jobs(session)
    if found.failed:
        raise SceneError(found.failed[0].why, where=f"stroke '{found.failed[0].stroke}'", remedy="Mute or mend it.")
    touched: dict[str, tuple[Patch, ...]] = {}
    for job in found.jobs:
        touched[job.object_name] = touched.get(job.object_name, ()) + plan_job_patches(session, job)
    return touched


def plan_job_patches(session: Session, job: StrokeJob) -> tuple[Patch, ...]:
    """Plan the patches of one stroke, which is first placed in the scene if it has no curve yet."""
    obj: Any = session.scene.objects[job.object_name]
    stroke = job.stroke or session.read_stroke(session.place_stroke(obj, job, Counts()))
    mesh = session.get_surface(obj).mesh
    contacts = find_contacts(stroke.samples, stroke.get_surface(mesh), where=f"stroke '{job.name}'")
    return plan_patches(contacts)[0]
