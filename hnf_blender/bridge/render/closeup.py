"""Close-ups: a contact patch seen by a touch sensor's camera, and what its shader says of height and material.

One Cycles sample a pixel, exactly at its centre, of the touched object alone; every quantity is an AOV pass.

How many pixels a close-up needs: as many as the images behind its shader have something for, and no more.

Which pixels of a close-up show the patch's own surface: those that join its centre without a step in depth.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.library import Appearance
from hnf_core.scene.camera import Camera
from hnf_core.scene.mesh import crop_mesh
from hnf_core.scene.patch import CAMERA_DISTANCE_M, Patch
from hnf_core.scene.raycast import CastView, RayCaster, cast_view
from hnf_core.scene.rgbd_view import RgbdView
from hnf_core.tactile.height import height_from_slopes

from ..scene.meshes import Surface, make_ray_caster
from ..scene.temp_scene import TemporaryScene
from ..shader.aov_taps import Constant, Passes, compute_resolved_wavelength, find_finest_texel
from ..shader.bump_displacement import MicroGeometry, Relief, Slopes
from ..shader.closures import (
    Layers,
    average_appearance,
    list_closures,
    list_mix_factors,
    mix_closures,
    read_shading_value,
)
from .cycles import add_aovs, add_camera, configure_cycles, disable_lighting, render_passes, set_camera
from .isolated_object import IsolatedObject, SlotReading, instrument_slot, isolate_object
from .unlit_image import MAX_READABLE_WAVELENGTH_M, UnlitImage, make_unlit_image

Mask = NDArray[np.bool_]

PIXELS_PER_TEXEL = 3.0
"""Of an image that a relief is read from. Images are read by cubic splines, which leave next to nothing beyond their
texels; docs/benchmarks.md has what fewer pixels change."""
PIXELS_PER_TRIANGLE = 16
"""On average: hardly a face under the patch is missed then."""


def get_relief_sources(slot: SlotReading) -> tuple[Relief | Slopes, ...]:
    """All that shapes a slot's surface."""
    micros = [each.micro for each in list_closures(slot.reading.layers)] + [slot.reading.displacement]
    return tuple(chain.from_iterable((*micro.reliefs, *micro.slopes) for micro in micros))


def is_image_based(slot: SlotReading) -> bool:
    """Is all that a slot shows in images, whose texels a first look can measure? What reliefs are mixed by has to be
    the same everywhere: its own detail is not measured."""
    if slot.colour is not None:
        return bool(slot.colour.images) and not (slot.colour.procedural or slot.colour.painted)
    detail = get_relief_sources(slot)
    of_images = bool(detail) and all(each.images and each.texel_limited and not each.procedural for each in detail)
    return of_images and all(isinstance(each, Constant) for each in list_mix_factors(slot.reading.layers))


def choose_resolution(
    slot: SlotReading, passes: Passes, mask: Mask, triangle: NDArray[np.int32], size_m: float, max_pixels: int
) -> int:
    """Side in pixels from which on a slot's images give nothing more, as a first look of fewer tells; at most `most`,
    and as many where it cannot be told.

    A colour that shows waves short enough to estimate a relief from is looked at with all pixels. mask: (H, W), the
    patch's own surface. triangle: (H, W) that each pixel shows. size_m: of the patch's side.
    """
    side = mask.shape[1]
    if not mask.any():
        return max_pixels
    sources = get_relief_sources(slot) if slot.colour is None else (slot.colour,)
    texel = find_finest_texel(sources, passes, mask, size_m / side)
    if not np.isfinite(texel) or (slot.colour is not None and 2.0 * texel <= MAX_READABLE_WAVELENGTH_M):
        return max_pixels
    while side < max_pixels and (
        size_m / side > texel / PIXELS_PER_TEXEL
        or mask.sum() * (side / mask.shape[1]) ** 2 < PIXELS_PER_TRIANGLE * len(np.unique(triangle[mask]))
    ):
        side *= 2
    return min(side, max_pixels)


MAX_SURFACE_SLOPE = 4.0
"""Depth steps steeper than this between neighbouring pixels part two surfaces (76°)."""


def find_connected_pixels(candidates: Mask, depth: NDArray[np.floating[Any]], pixel_m: float) -> Mask:
    """Those of own (H, W) that are joined to the patch's centre without a step in planar depth (H, W) in metres."""
    depth = np.where(candidates, depth, 0.0)
    limit = MAX_SURFACE_SLOPE * pixel_m
    right = candidates[:, 1:] & candidates[:, :-1] & (np.abs(np.diff(depth, axis=1)) <= limit)
    down = candidates[1:] & candidates[:-1] & (np.abs(np.diff(depth, axis=0)) <= limit)
    rows, columns = candidates.shape
    reached = np.zeros_like(candidates)
    middle = (slice(rows // 2 - 1, rows // 2 + 1), slice(columns // 2 - 1, columns // 2 + 1))
    at_centre = candidates[middle] & (np.abs(depth[middle] - CAMERA_DISTANCE_M) <= CAMERA_DISTANCE_M / 4.0)
    reached[middle] = at_centre
    return flood_fill(reached, right, down)


def flood_fill(seed: Mask, right: Mask, down: Mask) -> Mask:
    """Everything connected to seed (H, W); right (H, W−1) and down (H−1, W) say which neighbours are joined."""
    reached = seed.copy()
    while True:
        before = int(reached.sum())
        for column in range(right.shape[1]):
            reached[:, column + 1] |= reached[:, column] & right[:, column]
        for column in reversed(range(right.shape[1])):
            reached[:, column] |= reached[:, column + 1] & right[:, column]
        for row in range(down.shape[0]):
            reached[row + 1] |= reached[row] & down[row]
        for row in reversed(range(down.shape[0])):
            reached[row] |= reached[row + 1] & down[row]
        if int(reached.sum()) == before:
            return reached


Float = NDArray[np.float64]

MIN_RELIEF_M = 1e-9
"""A relief lower than this is no micro-geometry: the shader says nothing."""
APPEARANCE_PIXELS = 128
"""Side of a close-up where the shader has no relief and one colour: mean shading values and covered faces are all there
is to see."""
SELF_OCCLUSION_OFFSET_M = 1e-4
"""What lies nearer above a patch's centre is the patch itself, within the precision of its place."""


@dataclass(frozen=True)
class CloseUp:
    """A patch as its shader describes it.

    patch: where. view: albedo as rgb, planar depth, evaluated polygon ids and
    shading normals in the surface frame. height: (H, W) float32 metres, +z along the patch normal, mean 0 over mask
    and 0 outside it; None where the shader has no micro-geometry. height_source: where the metres come from.
    appearance: shading values averaged over mask. mask: (H, W) bool, True where the patch's own connected surface in
    its own material slot is seen. resolved_wavelength_m: shortest wavelength that the height resolves (two texels of
    its finest image, two pixels where procedural), inf without height. notes: what the artist should know.
    faces: evaluated polygons under mask. rays: cast for this close-up. renders: made for it. look: the unlit picture
    where the shader has no micro-geometry and its colour varies, else None.
    """

    patch: Patch
    view: RgbdView
    height: NDArray[np.float32] | None
    height_source: str
    appearance: Appearance
    mask: Mask
    resolved_wavelength_m: float
    notes: tuple[str, ...]
    faces: NDArray[np.int32]
    rays: int
    renders: int
    unlit: UnlitImage | None = None

    @property
    def metres_per_pixel(self) -> float:
        return self.patch.size_m / self.mask.shape[1]


def iter_closeups(
    obj: Any,
    patches: Sequence[Patch],
    *,
    surface: Surface | None = None,
    caster: RayCaster | None = None,
    pixels: int = 512,
    metres_per_unit: float = 1.0,
    frame: float | None = None,
    view_layer: Any = None,
    first_pass_pixels: int | None = None,
    wait_for_threads: Callable[[], None] = lambda: None,
) -> Generator[CloseUp, None, None]:
    """Close-ups of several patches of one object, one after the other, on one temporary stage: one render a patch.

    Close it, or take all: the stage stands until then. The user's file is left as it was, also on errors.

    obj: the touched object. patches: in its surface frame. surface, caster: of obj at frame, made here where not
    given. pixels: side of the square image, at most APPEARANCE_PIXELS where relief and colour show nothing.
    metres_per_unit: of the user's scene. frame: scene frame, None = now. view_layer: of the scene that obj is touched
    in, None = the first that it stands in.

    first_pass_pixels: side of a first look where all detail is in images; a closer one follows only where those show
    more than it sees. None: no first look. wait_for_threads: called before Blender is asked for anything, to wait for
    the caller's threads: an operator lets them run Python, and Blender crashes. Rays are cast beside them.

    Raises SceneError for a missing texture (naming object, material and image) and where there is no surface.
    """
    if not patches:
        return
    where = f"object '{obj.name}'"
    wait_for_threads()
    with TemporaryScene() as temporary:
        configure_cycles(temporary.scene, samples=1)
        disable_lighting(temporary.scene)
        stage = isolate_object(temporary, obj, metres_per_unit, frame, surface, view_layer)
        surface = stage.surface if caster is not None else crop_to_patches(stage.surface, patches)
        caster = caster or make_ray_caster(surface.mesh)
        readings = {slot: instrument_slot(stage, slot, where) for slot in sorted({patch.slot for patch in patches})}
        taps = [tap for reading in readings.values() for tap in reading.taps]
        add_aovs(temporary.view_layer, taps)
        camera_object = add_camera(temporary)
        temporary.scene.render.use_persistent_data = len(patches) > 1

        def render_patch(patch: Patch, side: int, before: _MaskedPatch | None = None) -> _MaskedPatch:
            try:
                camera, rays = make_unoccluded_camera(patch, side, caster)
                cast = cast_view(caster, surface.mesh, camera)
            finally:
                wait_for_threads()
            passes: Passes = {}
            if readings[patch.slot].taps:
                set_camera(temporary.scene, camera_object, camera, stage.rigid, stage.metres_per_unit)
                passes = render_passes(temporary)
            seen = _RenderedPatch(patch, camera, cast, passes, readings[patch.slot], stage, metres_per_unit)
            rays, renders = rays + cast.depth.size, 1 if passes else 0
            if before is not None:
                rays, renders = before.rays + rays, before.renders + renders
            return _MaskedPatch(seen, _mask_patch_surface(seen, surface), rays, renders)

        for patch in patches:
            slot = readings[patch.slot]
            side = pixels if _has_detail(slot) else min(pixels, APPEARANCE_PIXELS)
            if first_pass_pixels is None or first_pass_pixels >= side or not is_image_based(slot):
                yield _build_closeup(render_patch(patch, side), surface)
                continue
            looked = render_patch(patch, first_pass_pixels)
            cast, passes = looked.rendered.cast, looked.rendered.passes
            enough = choose_resolution(slot, passes, looked.mask, cast.triangle, patch.size_m, side)
            yield _build_closeup(
                looked if enough <= first_pass_pixels else render_patch(patch, enough, looked), surface
            )


def crop_to_patches(surface: Surface, patches: Sequence[Patch]) -> Surface:
    """What the patches' cameras can see of it: no tree is built of faces out of reach."""
    near = crop_mesh(surface.mesh, [patch.centre for patch in patches], max(patch.reach_m for patch in patches))
    return replace(surface, mesh=near) if len(near.triangles) else surface


def _has_detail(slot: SlotReading) -> bool:
    return slot.colour is not None or bool(get_relief_sources(slot))


@dataclass(frozen=True)
class _RenderedPatch:
    """All that is known of one patch after rendering and casting."""

    patch: Patch
    camera: Camera
    cast: CastView
    passes: Passes
    slot: SlotReading
    isolated: IsolatedObject
    metres_per_unit: float

    @property
    def pixel_m(self) -> float:
        return self.patch.size_m / self.camera.width


@dataclass(frozen=True)
class _MaskedPatch:
    """mask: the patch's own surface. rays, renders: it took, first looks included."""

    rendered: _RenderedPatch
    mask: Mask
    rays: int
    renders: int


def make_unoccluded_camera(patch: Patch, pixels: int, caster: RayCaster) -> tuple[Camera, int]:
    """The patch's camera, its near clip moved under whatever part of the object hangs over the patch's centre."""
    camera = patch.camera(pixels)
    lift = SELF_OCCLUSION_OFFSET_M
    above = float(caster.cast((patch.centre + lift * patch.normal)[None], patch.normal[None]).distance[0]) + lift
    if above < CAMERA_DISTANCE_M:
        camera = replace(camera, clip_start=CAMERA_DISTANCE_M - above / 2.0)
    return camera, 1


def _build_closeup(masked: _MaskedPatch, surface: Surface) -> CloseUp:
    seen, mask = masked.rendered, masked.mask
    layers = seen.slot.reading.layers
    notes = [*seen.isolated.notes, *seen.slot.reading.notes]
    height, source, resolved = _compute_height(seen, mask, notes)
    rgb = (
        None
        if layers is None
        else mix_closures(layers, seen.passes, partial(read_shading_value, "base_color", seen.passes))
    )
    shape = mask.shape
    albedo = np.zeros((*shape, 3), np.float32) if rgb is None else np.broadcast_to(rgb, (*shape, 3)).astype(np.float32)
    view = RgbdView(
        camera=seen.camera,
        rgb=np.where((seen.cast.triangle >= 0)[..., None], albedo, np.float32(0.0)),
        depth=seen.cast.depth.astype(np.float32),
        face_id=seen.cast.face_id,
        normal=seen.cast.normal.astype(np.float32),
    )
    return CloseUp(
        patch=seen.patch,
        view=view,
        height=height,
        height_source=source,
        appearance=average_appearance(layers, seen.passes, mask),
        mask=mask,
        resolved_wavelength_m=resolved,
        notes=tuple(dict.fromkeys(notes)),
        faces=np.unique(seen.cast.face_id[mask]),
        rays=masked.rays,
        renders=masked.renders,
        unlit=_build_unlit_image(seen, albedo, mask, surface),
    )


def _build_unlit_image(
    rendered: _RenderedPatch, albedo: NDArray[np.float32], mask: Mask, surface: Surface
) -> UnlitImage | None:
    if rendered.slot.colour is None or not rendered.passes:
        return None
    return make_unlit_image(
        rendered.slot.colour, albedo, rendered.cast.depth, mask, passes=rendered.passes, pixel_m=rendered.pixel_m,
        mesh=surface.mesh,
        triangle=rendered.cast.triangle,
    )  # fmt: skip


def _mask_patch_surface(rendered: _RenderedPatch, surface: Surface) -> Mask:
    """Pixels of the patch's slot that connect to its centre without a step in depth."""
    slot = np.where(rendered.cast.triangle >= 0, surface.mesh.slot[rendered.cast.triangle], -1)
    return find_connected_pixels(slot == rendered.patch.slot, rendered.cast.depth, rendered.pixel_m)


def _compute_height(
    rendered: _RenderedPatch, mask: Mask, notes: list[str]
) -> tuple[NDArray[np.float32] | None, str, float]:
    """Height in metres (mean 0 over mask), its source, and the shortest wavelength it resolves."""
    layers, displacement = rendered.slot.reading.layers, rendered.slot.reading.displacement
    nothing = (None, "", float("inf"))
    if not mask.any() or not rendered.passes:
        return nothing
    micros = [each.micro for each in list_closures(layers)] + [displacement]
    reliefs = [relief for micro in micros for relief in micro.reliefs]
    slopes = [slope for micro in micros for slope in micro.slopes]
    height = np.zeros(mask.shape)
    used: list[Relief | Slopes] = []
    if reliefs:
        height = height + _compute_relief_height(rendered, layers, displacement)
        used.extend(reliefs)
    if slopes and displacement.reliefs:
        notes.append("a normal map beside a Displacement is not counted: they mostly show the same relief.")
    elif slopes and layers is not None:
        height = height + _integrate_normals(rendered, layers, mask, notes)
        used.extend(slopes)
    height = np.where(mask, height - height[mask].mean(), 0.0)
    span = float(np.ptp(height[mask]))
    if not np.isfinite(span):
        notes.append("the shader's height is not a number here: it is not used.")
        return nothing
    if span < MIN_RELIEF_M:
        return nothing
    resolved = compute_resolved_wavelength(used, rendered.passes, mask, rendered.pixel_m)
    return (
        height.astype(np.float32),
        "; ".join(dict.fromkeys(_describe_source(rendered, each) for each in used)),
        resolved,
    )


def _describe_source(rendered: _RenderedPatch, source: Relief | Slopes) -> str:
    if isinstance(source, Slopes):
        return source.source
    metres = _get_height_scale(rendered, source)
    return ", ".join((source.node, *(amount.format(metres) for amount in source.amounts)))


def _get_height_scale(rendered: _RenderedPatch, relief: Relief) -> float:
    """Of the units that its height is in."""
    if not relief.in_object_space:
        return rendered.metres_per_unit
    # A step along the object's own normal, as long as the object's scale makes it.
    along = rendered.isolated.stretch.T @ rendered.patch.normal
    step = rendered.isolated.stretch @ (along / np.linalg.norm(along))
    return float(step @ rendered.patch.normal)


def _compute_relief_height(rendered: _RenderedPatch, layers: Layers | None, displacement: MicroGeometry) -> Float:
    total = _sum_reliefs(rendered, displacement.reliefs)
    bumps = (
        None
        if layers is None
        else mix_closures(layers, rendered.passes, lambda each: _sum_reliefs(rendered, each.micro.reliefs))
    )
    return total if bumps is None else total + bumps


def _sum_reliefs(rendered: _RenderedPatch, reliefs: Sequence[Relief]) -> Float:
    total = np.zeros((rendered.camera.height, rendered.camera.width))
    for relief in reliefs:
        total = total + _get_height_scale(rendered, relief) * relief.tap.read(rendered.passes)
    return total


def _integrate_normals(rendered: _RenderedPatch, layers: Layers, mask: Mask, notes: list[str]) -> Float:
    """Height whose slopes against the smooth surface are those of the normal maps."""

    def along(axis: int) -> Float | None:
        return mix_closures(layers, rendered.passes, lambda each: _compute_slope(rendered, each.micro, axis))

    gx, gy = along(0), along(1)
    if gx is None or gy is None:
        return np.zeros(mask.shape)
    valid = mask & np.isfinite(gx) & np.isfinite(gy)
    if not valid.any():
        return np.zeros(mask.shape)
    if has_flipped_green(gx, gy, valid):
        notes.append(
            f"material '{rendered.slot.material}': its normal map looks like a DirectX one (green points down); "
            "invert its green channel."
        )
    return height_from_slopes(gx, gy, valid, rendered.pixel_m)


def _compute_slope(rendered: _RenderedPatch, micro: MicroGeometry, axis: int) -> Float:
    """∂h/∂x (axis 0) or ∂h/∂y (axis 1) of a closure in the patch frame; 0 where it has no normal map."""
    total = np.zeros((rendered.camera.height, rendered.camera.width))
    smooth = rendered.cast.normal
    frame = rendered.patch.x_axis - smooth * (smooth @ rendered.patch.x_axis)[..., None]
    length = np.linalg.norm(frame, axis=-1, keepdims=True)
    x_axis = frame / np.where(length > 0.0, length, 1.0)
    tangent = x_axis if axis == 0 else np.cross(smooth, x_axis)
    for slopes in micro.slopes:
        normal = slopes.tap.read(rendered.passes) @ rendered.isolated.rigid[:3, :3]
        up = np.sum(normal * smooth, axis=-1)
        lean = np.sum(normal * tangent, axis=-1)
        total = total - np.clip(lean / np.where(up > 0.05, up, np.nan), -10.0, 10.0)
    return total


def has_flipped_green(gx: Float, gy: Float, mask: Mask) -> bool:
    """Would the slopes (∂h/∂x, ∂h/∂y; row → −y) fit a surface far better with the second one turned round?

    A height field has no curl: ∂(∂h/∂x)/∂y = ∂(∂h/∂y)/∂x.
    """
    inner = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    along_y = -(gx[2:, 1:-1] - gx[:-2, 1:-1])[inner]
    along_x = (gy[1:-1, 2:] - gy[1:-1, :-2])[inner]
    if along_x.size == 0:
        return False
    right, flipped = np.mean((along_y - along_x) ** 2), np.mean((along_y + along_x) ** 2)
    return bool(flipped < 0.25 * right)
