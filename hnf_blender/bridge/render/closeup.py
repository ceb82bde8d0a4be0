"""Close-ups: a square of surface (patch) in orthographic view, with the height and appearance that its shader defines.

Cycles takes one sample at each pixel's center, of the touched object alone, and every quantity is an AOV pass. A first
pass with few pixels measures the texels of the images behind the shader, which determine the resolution of the second.
Only pixels connected to the patch's center without a step in depth count as its surface.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.library import Appearance
from hnf_core.scene.camera import CAMERA_DISTANCE_M, Camera, Patch
from hnf_core.scene.mesh import crop_mesh
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
"""Pixels per texel of an image from which a relief is read. Images are interpolated by cubic splines, which leave
almost nothing beyond their texels; docs/benchmarks.md shows the effect of fewer pixels."""
PIXELS_PER_TRIANGLE = 16
"""Mean number of pixels per triangle, at which hardly a face under the patch is missed."""


def get_relief_sources(slot: SlotReading) -> tuple[Relief | Slopes, ...]:
    """Return what shapes a material slot's surface: reliefs (bump, displacement) and slopes (normal maps)."""
    micros = [closure.micro for closure in list_closures(slot.reading.layers)] + [slot.reading.displacement]
    return tuple(chain.from_iterable((*micro.reliefs, *micro.slopes) for micro in micros))


def is_image_based(slot: SlotReading) -> bool:
    """Return True if all detail of a material slot is in images, whose texels a first render can measure.

    If shaders are mixed, the mix factors must be constant, as their own detail is not measured.
    """
    if slot.colour is not None:
        return bool(slot.colour.images) and not (slot.colour.procedural or slot.colour.painted)
    sources = get_relief_sources(slot)
    if not all(source.images and source.texel_limited and not source.procedural for source in sources):
        return False
    return bool(sources) and all(isinstance(factor, Constant) for factor in list_mix_factors(slot.reading.layers))


def choose_resolution(
    slot: SlotReading, passes: Passes, mask: Mask, triangle: NDArray[np.int32], size_m: float, max_pixels: int
) -> int:
    """Return the image side [pixels] beyond which a slot's images show nothing more, at most `max_pixels`.

    It is `max_pixels` if the size of the texels is unknown, or if the slot has no relief and its color image is fine
    enough for a relief to be predicted from it.

    Parameters
    ----------
    slot : SlotReading
        The patch's material slot.
    passes : Passes
        AOV passes (H, W) of the first, coarse render.
    mask : (H, W) bool array
        The patch's own surface.
    triangle : (H, W) int array
        Triangle at each pixel.
    size_m : float
        Side of the patch [m].
    max_pixels : int
        Maximum side [pixels].

    Returns
    -------
    int
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
"""Depth step per pixel size between neighboring pixels above which they belong to two surfaces (76°)."""


def find_connected_pixels(candidates: Mask, depth: NDArray[np.floating[Any]], pixel_m: float) -> Mask:
    """Return the `candidates` (H, W) connected to the image's center without a step in planar depth (H, W) [m].

    A step is a slope above MAX_SURFACE_SLOPE between neighboring pixels of size `pixel_m` [m].
    """
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
    """Return all pixels connected to `seed` (H, W).

    `right` (H, W−1) and `down` (H−1, W) tell whether a pixel is connected to the next in its row or column.
    """
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
"""Peak-to-peak height below which a shader has no micro-geometry [m]."""
APPEARANCE_PIXELS = 128
"""Side of a close-up [pixels] if the shader has no relief and one color, so that only mean shading values and covered
faces are needed."""
SELF_OCCLUSION_OFFSET_M = 1e-4
"""Offset of a ray above a patch's center, so that it does not hit the patch itself [m]."""


@dataclass(frozen=True)
class CloseUp:
    """A rendered patch, a square of a surface, with the height and the appearance that its shader defines.

    Attributes
    ----------
    patch : Patch
        Center, tangents, size and material slot.
    view : RgbdView
        Albedo, planar depth, evaluated polygon ids, and shading normals in the surface frame.
    height : (H, W) float32 array or None
        Height along the patch's normal [m], with mean 0 under `mask`, 0 elsewhere; None without micro-geometry.
    height_source : str
        Description of the height's source.
    appearance : Appearance
        Shading values averaged over `mask`.
    mask : (H, W) bool array
        Pixels of the patch's own connected surface and material slot.
    resolved_wavelength_m : float
        Shortest wavelength of the height [m]: two texels of its finest image, two pixels if procedural; inf without
        height.
    notes : tuple of str
        Remarks for the user.
    faces : int32 array
        Evaluated polygons under `mask`.
    rays, renders : int
        Number of rays cast and renders made for it, the first pass included.
    unlit : UnlitImage or None
        Unlit image, if the shader has no micro-geometry and its color varies.
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
        """Size of a pixel [m]."""
        return self.patch.size_m / self.mask.shape[1]


class CloseUpRenderer:
    """Context manager that renders close-ups of patches (squares of surface) of one object in one temporary scene.

    The scene is made for the first patch and removed on exit; the user's file is left unchanged, also after errors.

    Parameters
    ----------
    obj : bpy.types.Object
        Touched object.
    patches : sequence of Patch
        All patches that will be rendered, in its surface frame.
    surface, caster : Surface and RayCaster, optional
        Surface of `obj` at `frame` and its ray caster, if known.
    pixels : int, default 512
        Maximum side of an image [pixels]; APPEARANCE_PIXELS is used if neither relief nor color varies.
    metres_per_unit : float, default 1.0
        Length of a Blender unit in the user's scene [m].
    frame : float, optional
        Scene frame; the current one by default.
    view_layer : bpy.types.ViewLayer, optional
        View layer of the scene in which `obj` is touched; by default that of the first scene it is in.
    first_pass_pixels : int, optional
        Side [pixels] of a first render if all the shader's detail is in images; a second follows only if they have
        finer texels. None skips it.
    wait_for_threads : callable, optional
        Waits for the caller's threads; called before every use of Blender, whose operators let other threads run
        Python, which crashes it.
    """

    def __init__(
        self,
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
    ) -> None:
        self._obj, self._patches, self._surface, self._caster = obj, patches, surface, caster
        self._pixels, self._first_pass_pixels = pixels, first_pass_pixels
        self._metres_per_unit, self._frame, self._view_layer = metres_per_unit, frame, view_layer
        self._wait_for_threads = wait_for_threads
        self._exit_stack = ExitStack()
        self._scene: _CloseUpScene | None = None

    def __enter__(self) -> CloseUpRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self._exit_stack.close()

    def render(self, patch: Patch) -> CloseUp:
        """Render one of the patches.

        Raises SceneError for a missing texture (names object, material and image), or if there is no surface.
        """
        if self._scene is None:
            self._scene = self._make_scene()
        scene, first_side = self._scene, self._first_pass_pixels
        slot = scene.slots[patch.slot]
        side = self._pixels if _has_detail(slot) else min(self._pixels, APPEARANCE_PIXELS)
        if first_side is None or first_side >= side or not is_image_based(slot):
            return _build_closeup(self._render_pass(scene, patch, side), scene.surface)
        first_pass = self._render_pass(scene, patch, first_side)
        cast, passes = first_pass.rendered.cast, first_pass.rendered.passes
        needed = choose_resolution(slot, passes, first_pass.mask, cast.triangle, patch.size_m, side)
        if needed <= first_side:
            return _build_closeup(first_pass, scene.surface)
        second_pass = self._render_pass(scene, patch, needed)
        total_rays, total_renders = first_pass.rays + second_pass.rays, first_pass.renders + second_pass.renders
        return _build_closeup(replace(second_pass, rays=total_rays, renders=total_renders), scene.surface)

    def _make_scene(self) -> _CloseUpScene:
        """Make the temporary scene, with an AOV for every quantity of the patches' slots."""
        where = f"object '{self._obj.name}'"
        self._wait_for_threads()
        temporary = self._exit_stack.enter_context(TemporaryScene())
        configure_cycles(temporary.scene, samples=1)
        disable_lighting(temporary.scene)
        isolated = isolate_object(
            temporary, self._obj, self._metres_per_unit, self._frame, self._surface, self._view_layer
        )
        surface = isolated.surface if self._caster is not None else crop_to_patches(isolated.surface, self._patches)
        caster = self._caster or make_ray_caster(surface.mesh)
        slot_numbers = sorted({patch.slot for patch in self._patches})
        slots = {number: instrument_slot(isolated, number, where) for number in slot_numbers}
        add_aovs(temporary.view_layer, [tap for slot in slots.values() for tap in slot.taps])
        camera = add_camera(temporary)
        temporary.scene.render.use_persistent_data = len(self._patches) > 1
        return _CloseUpScene(temporary, isolated, surface, caster, slots, camera)

    def _render_pass(self, scene: _CloseUpScene, patch: Patch, side: int) -> _MaskedPatch:
        """Cast rays and render one image of a patch."""
        try:
            camera, clip_rays = make_unoccluded_camera(patch, side, scene.caster)
            cast = cast_view(scene.caster, scene.surface.mesh, camera)
        finally:
            self._wait_for_threads()
        passes: Passes = {}
        slot = scene.slots[patch.slot]
        if slot.taps:
            set_camera(
                scene.temporary.scene, scene.camera, camera, scene.isolated.rigid, scene.isolated.metres_per_unit
            )
            passes = render_passes(scene.temporary)
        rendered = _RenderedPatch(patch, camera, cast, passes, slot, scene.isolated, self._metres_per_unit)
        mask = _mask_patch_surface(rendered, scene.surface)
        return _MaskedPatch(rendered, mask, clip_rays + cast.depth.size, 1 if passes else 0)


@dataclass(frozen=True)
class _CloseUpScene:
    """Temporary scene with a copy of the object, the part of its surface near the patches, and each slot's shader."""

    temporary: TemporaryScene
    isolated: IsolatedObject
    surface: Surface
    caster: RayCaster
    slots: Mapping[int, SlotReading]
    camera: Any


def crop_to_patches(surface: Surface, patches: Sequence[Patch]) -> Surface:
    """Return the part of a surface that the patches' cameras can see, so that only it enters the ray caster's BVH."""
    mesh = crop_mesh(surface.mesh, [patch.centre for patch in patches], max(patch.reach_m for patch in patches))
    return replace(surface, mesh=mesh) if len(mesh.triangles) else surface


def _has_detail(slot: SlotReading) -> bool:
    """Return True if a material slot has a relief (bump, displacement, normal map) or a varying color."""
    return slot.colour is not None or bool(get_relief_sources(slot))


@dataclass(frozen=True)
class _RenderedPatch:
    """A patch with its render passes and ray casts."""

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
    """A rendered patch with the mask of its own surface, and the rays and renders used, first passes included."""

    rendered: _RenderedPatch
    mask: Mask
    rays: int
    renders: int


def make_unoccluded_camera(patch: Patch, pixels: int, caster: RayCaster) -> tuple[Camera, int]:
    """Return the patch's camera and the number of rays cast.

    If something is above the patch's center, the near clipping plane is between it and the patch.
    """
    camera = patch.camera(pixels)
    lift = SELF_OCCLUSION_OFFSET_M
    above = float(caster.cast((patch.centre + lift * patch.normal)[None], patch.normal[None]).distance[0]) + lift
    if above < CAMERA_DISTANCE_M:
        camera = replace(camera, clip_start=CAMERA_DISTANCE_M - above / 2.0)
    return camera, 1


def _build_closeup(masked: _MaskedPatch, surface: Surface) -> CloseUp:
    rendered, mask = masked.rendered, masked.mask
    layers = rendered.slot.reading.layers
    notes = [*rendered.isolated.notes, *rendered.slot.reading.notes]
    height, source, resolved = _compute_height(rendered, mask, notes)
    rgb = (
        None
        if layers is None
        else mix_closures(layers, rendered.passes, partial(read_shading_value, "base_color", rendered.passes))
    )
    shape = mask.shape
    albedo = np.zeros((*shape, 3), np.float32) if rgb is None else np.broadcast_to(rgb, (*shape, 3)).astype(np.float32)
    view = RgbdView(
        camera=rendered.camera,
        rgb=np.where((rendered.cast.triangle >= 0)[..., None], albedo, np.float32(0.0)),
        depth=rendered.cast.depth.astype(np.float32),
        face_id=rendered.cast.face_id,
        normal=rendered.cast.normal.astype(np.float32),
    )
    return CloseUp(
        patch=rendered.patch,
        view=view,
        height=height,
        height_source=source,
        appearance=average_appearance(layers, rendered.passes, mask),
        mask=mask,
        resolved_wavelength_m=resolved,
        notes=tuple(dict.fromkeys(notes)),
        faces=np.unique(rendered.cast.face_id[mask]),
        rays=masked.rays,
        renders=masked.renders,
        unlit=_build_unlit_image(rendered, albedo, mask, surface),
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
    """Return the pixels (H, W) of the patch's material slot connected to its center without a step in depth."""
    slot = np.where(rendered.cast.triangle >= 0, surface.mesh.slot[rendered.cast.triangle], -1)
    return find_connected_pixels(slot == rendered.patch.slot, rendered.cast.depth, rendered.pixel_m)


def _compute_height(
    rendered: _RenderedPatch, mask: Mask, notes: list[str]
) -> tuple[NDArray[np.float32] | None, str, float]:
    """Return the height (H, W) [m], its source for the report, and its shortest resolved wavelength [m].

    The mean is 0 under `mask`. Without relief the height is None and the wavelength inf.
    """
    layers, displacement = rendered.slot.reading.layers, rendered.slot.reading.displacement
    nothing = (None, "", float("inf"))
    if not mask.any() or not rendered.passes:
        return nothing
    micros = [closure.micro for closure in list_closures(layers)] + [displacement]
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
        "; ".join(dict.fromkeys(_describe_source(rendered, source) for source in used)),
        resolved,
    )


def _describe_source(rendered: _RenderedPatch, source: Relief | Slopes) -> str:
    if isinstance(source, Slopes):
        return source.source
    metres = _get_height_scale(rendered, source)
    return ", ".join((source.node, *(amount.format(metres) for amount in source.amounts)))


def _get_height_scale(rendered: _RenderedPatch, relief: Relief) -> float:
    """Return the length along the patch's normal of one unit of a relief's height [m]."""
    if not relief.in_object_space:
        return rendered.metres_per_unit
    # A unit step along the normal in object space, as long as the object's scale makes it.
    object_normal = rendered.isolated.stretch.T @ rendered.patch.normal
    step = rendered.isolated.stretch @ (object_normal / np.linalg.norm(object_normal))
    return float(step @ rendered.patch.normal)


def _compute_relief_height(rendered: _RenderedPatch, layers: Layers | None, displacement: MicroGeometry) -> Float:
    total = _sum_reliefs(rendered, displacement.reliefs)
    bumps = (
        None
        if layers is None
        else mix_closures(layers, rendered.passes, lambda closure: _sum_reliefs(rendered, closure.micro.reliefs))
    )
    return total if bumps is None else total + bumps


def _sum_reliefs(rendered: _RenderedPatch, reliefs: Sequence[Relief]) -> Float:
    total = np.zeros((rendered.camera.height, rendered.camera.width))
    for relief in reliefs:
        total = total + _get_height_scale(rendered, relief) * relief.tap.read(rendered.passes)
    return total


def _integrate_normals(rendered: _RenderedPatch, layers: Layers, mask: Mask, notes: list[str]) -> Float:
    """Return the height (H, W) [m] whose slopes relative to the smooth surface are those of the normal maps."""

    def compute_slope(axis: int) -> Float | None:
        return mix_closures(layers, rendered.passes, lambda closure: _compute_slope(rendered, closure.micro, axis))

    gx, gy = compute_slope(0), compute_slope(1)
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
    """Return the slope ∂h/∂x (axis 0) or ∂h/∂y (axis 1) of a closure (BSDF) in the patch's frame, (H, W).

    It is 0 without a normal map.
    """
    total = np.zeros((rendered.camera.height, rendered.camera.width))
    smooth = rendered.cast.normal
    frame = rendered.patch.x_axis - smooth * (smooth @ rendered.patch.x_axis)[..., None]
    length = np.linalg.norm(frame, axis=-1, keepdims=True)
    x_axis = frame / np.where(length > 0.0, length, 1.0)
    tangent = x_axis if axis == 0 else np.cross(smooth, x_axis)
    for slopes in micro.slopes:
        normal = slopes.tap.read(rendered.passes) @ rendered.isolated.rigid[:3, :3]
        normal_part = np.sum(normal * smooth, axis=-1)
        tangent_part = np.sum(normal * tangent, axis=-1)
        total = total - np.clip(tangent_part / np.where(normal_part > 0.05, normal_part, np.nan), -10.0, 10.0)
    return total


def has_flipped_green(gx: Float, gy: Float, mask: Mask) -> bool:
    """Return True if slopes `gx`, `gy` (H, W) fit a surface far better with `gy` negated.

    This detects normal maps of the DirectX convention. A height field has no curl, ∂(∂h/∂x)/∂y = ∂(∂h/∂y)/∂x, so the
    sign with less curl under `mask` is the right one; y points against the rows.
    """
    inner = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    along_y = -(gx[2:, 1:-1] - gx[:-2, 1:-1])[inner]
    along_x = (gy[1:-1, 2:] - gy[1:-1, :-2])[inner]
    if along_x.size == 0:
        return False
    right, flipped = np.mean((along_y - along_x) ** 2), np.mean((along_y + along_x) ** 2)
    return bool(flipped < 0.25 * right)
