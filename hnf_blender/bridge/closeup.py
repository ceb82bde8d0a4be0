"""Close-ups: a square of surface (patch) in orthographic view, with the height and appearance that its shader defines.

Cycles takes one sample at each pixel's center, of the touched object alone, and every quantity is an AOV pass. A first
pass with few pixels measures the texels of the images behind the shader, which determine the resolution of the second;
a look at the middle with small pixels tells whether a relief is finer than a patch's pixels and would fold.
Only pixels connected to the patch's center without a step in depth count as its surface.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import pluralize
from hnf_core.material.band_descriptor import find_noise_cutoff, measure_octave_heights
from hnf_core.material.library import Appearance
from hnf_core.material.token import BAND_WAVELENGTHS_M
from hnf_core.scene.camera import CAMERA_DISTANCE_M, Camera, Patch
from hnf_core.scene.mesh import TriangleMesh, crop_mesh, has_area, has_crowded_edge
from hnf_core.scene.raycast import CastView, ViewCaster, cast_view, compute_view_normals
from hnf_core.scene.rgbd_view import RgbdView
from hnf_core.tactile.fourier_filters import decimate, restore_texels
from hnf_core.tactile.height import fill_masked, has_flipped_green, height_from_slopes
from hnf_core.tactile.mesh_relief import (
    GRID,
    FaceSpacing,
    MeshRelief,
    add_heights,
    compute_mesh_relief,
    describe_mesh_relief,
    find_fine_faces,
)

from .cycles import (
    FILTER_REACH,
    PLAIN_SAMPLING,
    ZOOM,
    ZOOM_PIXELS,
    Sampling,
    UnlitImage,
    add_aovs,
    add_camera,
    choose_sampling,
    configure_cycles,
    disable_lighting,
    erode,
    make_unlit_image,
    render_passes,
    set_camera,
)
from .isolated_object import (
    IsolatedObject,
    SlotReading,
    choose_mesh_side,
    choose_resolution,
    get_relief_sources,
    instrument_slot,
    is_image_based,
    isolate_object,
)
from .scene.meshes import Surface, make_ray_caster
from .scene.temp_scene import TemporaryScene
from .shader.aov_taps import (
    ImageTap,
    Passes,
    compute_resolved_wavelength,
    find_finest_texel,
    find_texel_grid,
    measure_image_step,
)
from .shader.bump_displacement import MicroGeometry, Relief, Slopes, judge_normal_colour
from .shader.closures import Layers, average_appearance, list_closures, mix_closures, read_shading_value

Mask = NDArray[np.bool_]

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
    reached[middle] = candidates[middle] & (np.abs(depth[middle] - CAMERA_DISTANCE_M) <= CAMERA_DISTANCE_M / 4.0)
    return flood_fill(reached, right, down)


def flood_fill(seed: Mask, right: Mask, down: Mask) -> Mask:
    """Return all pixels connected to `seed` (H, W).

    `right` (H, W−1) and `down` (H−1, W) tell whether a pixel is connected to the next in its row or column.
    """
    if seed.any() and right.all() and down.all():
        return np.ones_like(seed)
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
MIN_MESH_SIDE = 128
"""Least side of an image in which relief of the mesh is looked for [pixels]."""
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
        Albedo, planar depth, and evaluated polygon ids.
    height : (H, W) float32 array or None
        Height along the patch's normal [m], with mean 0 under `mask`, 0 elsewhere: that of the shader, and
        the relief of the mesh. None without either.
    height_source : str
        Description of the height's source.
    appearance : Appearance
        Shading values averaged over `mask`.
    mask : (H, W) bool array
        Pixels of the patch's own connected surface and material slot.
    resolved_wavelength_m : float
        Shortest wavelength of the height [m]: two texels of its finest image, two pixels if procedural, four faces of
        the mesh; inf without height.
    notes : tuple of str
        Remarks for the user.
    faces : int32 array
        Evaluated polygons under `mask`.
    rays, renders : int
        Number of rays cast and renders made for it, the first pass included, and for a slot's first patch the small
        view that chooses the sampling of all of them.
    unlit : UnlitImage or None
        Unlit image, if the shader has no micro-geometry and its color varies.
    mesh_bands, empty_bands : tuple of bool
        For each wavelength band of a token, True if the mesh gives most of the height, and True if nothing does; both
        are () if the mesh gives none.
    is_incomplete : bool
        True if a texture is missing and was left out.
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
    mesh_bands: tuple[bool, ...] = ()
    empty_bands: tuple[bool, ...] = ()
    is_incomplete: bool = False

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
    surface, caster : Surface and ViewCaster, optional
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
    chosen_slots : collection of int, optional
        Slots whose haptic material the user chose, which need no texture.
    """

    def __init__(
        self,
        obj: Any,
        patches: Sequence[Patch],
        *,
        surface: Surface | None = None,
        caster: ViewCaster | None = None,
        pixels: int = 512,
        metres_per_unit: float = 1.0,
        frame: float | None = None,
        view_layer: Any = None,
        first_pass_pixels: int | None = None,
        wait_for_threads: Callable[[], None] = lambda: None,
        chosen_slots: Collection[int] = (),
    ) -> None:
        self._obj, self._patches, self._surface, self._caster = obj, patches, surface, caster
        self._pixels, self._first_pass_pixels = pixels, first_pass_pixels
        self._metres_per_unit, self._frame, self._view_layer = metres_per_unit, frame, view_layer
        self._wait_for_threads, self._chosen_slots = wait_for_threads, chosen_slots
        self._exit_stack = ExitStack()
        self._scene: _CloseUpScene | None = None
        self._sampling: dict[int, Sampling] = {}
        self._zoomed: _MaskedPatch | None = None

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
        scene, first_side, self._zoomed = self._scene, self._first_pass_pixels, None
        slot = scene.slots[patch.slot]
        has_detail = slot.colour is not None or get_relief_sources(slot)
        side = self._pixels if has_detail else min(self._pixels, APPEARANCE_PIXELS)
        is_first_look = first_side is not None and first_side < side and is_image_based(slot)
        if is_first_look and first_side is not None:
            side = first_side
        first_pass = self._render_pass(scene, patch, side, self._choose_sampling(scene, patch, side, is_first_look))
        needed = self._choose_second_side(scene, first_pass)
        passes = [first_pass]
        if needed > side:
            sampling = self._choose_sampling(scene, patch, needed, is_first_look, first_pass)
            passes.append(self._render_pass(scene, patch, needed, sampling))
        made = passes if self._zoomed is None else [*passes, self._zoomed]
        rays, renders = sum(each.rays for each in made), sum(each.renders for each in made)
        return _build_closeup(replace(passes[-1], rays=rays, renders=renders), scene.surface)

    def _choose_second_side(self, scene: _CloseUpScene, first_pass: _MaskedPatch) -> int:
        """Return the image side [pixels] that a patch needs after its first pass, at most `pixels`.

        Its images may have finer texels, and its mesh finer relief, than the first pass shows.
        """
        rendered, mask = first_pass.rendered, first_pass.mask
        side = mask.shape[1]
        if side >= self._pixels:
            return side
        needed = side
        if is_image_based(rendered.slot):
            cast, size = rendered.cast, rendered.patch.size_m
            needed = choose_resolution(rendered.slot, rendered.passes, mask, cast.triangle, size, self._pixels)
        spacing = first_pass.spacing
        finest = needed if spacing is None else choose_mesh_side(needed, rendered.patch.size_m, spacing)
        if spacing is None or finest <= needed:
            return min(needed, self._pixels)
        relief = _measure_mesh_relief(rendered, mask, spacing, scene.surface, cut=False)
        return min(needed if relief is None else finest, self._pixels)

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
        isolated = replace(isolated, notes=(*isolated.notes, *_describe_bad_faces(surface, self._patches)))
        caster = self._caster or make_ray_caster(surface.mesh)
        slot_numbers = sorted({patch.slot for patch in self._patches})
        slots = {
            number: instrument_slot(isolated, number, where, is_chosen=number in self._chosen_slots)
            for number in slot_numbers
        }
        add_aovs(temporary.view_layer, [tap for slot in slots.values() for tap in slot.taps])
        camera = add_camera(temporary)
        temporary.scene.render.use_persistent_data = len(self._patches) > 1
        return _CloseUpScene(temporary, isolated, surface, caster, slots, camera)

    def _choose_sampling(
        self, scene: _CloseUpScene, patch: Patch, side: int, image_based: bool, first_pass: _MaskedPatch | None = None
    ) -> Sampling:
        """Choose how finely an image of `side` pixels samples a slot's relief.

        By a small view, if the slot is procedural, or if the first pass over its images shows texels finer than pixels.
        """
        slot = scene.slots[patch.slot]
        if not image_based:
            # A relief may be finer than any image of it.
            if any(source.procedural or not source.texel_limited for source in get_relief_sources(slot)):
                return self._look_closely(scene, patch, side)
            return PLAIN_SAMPLING
        if first_pass is None or slot.colour is not None:
            return PLAIN_SAMPLING
        rendered = first_pass.rendered
        finest = find_finest_texel(get_relief_sources(slot), rendered.passes, first_pass.mask, rendered.pixel_m)
        return self._look_closely(scene, patch, side) if finest < 0.9 * patch.size_m / side else PLAIN_SAMPLING

    def _look_closely(self, scene: _CloseUpScene, patch: Patch, side: int) -> Sampling:
        """Choose the sampling of a slot's relief by a view of the middle of its first patch."""
        if patch.slot not in self._sampling:
            size_m = patch.size_m / side / ZOOM * ZOOM_PIXELS
            self._zoomed = zoomed = self._render_pass(scene, replace(patch, size_m=size_m), ZOOM_PIXELS)
            height, _ = _read_height(zoomed.rendered, zoomed.mask, [])
            self._sampling[patch.slot] = choose_sampling(height, zoomed.mask, zoomed.rendered.pixel_m)
        return self._sampling[patch.slot]

    def _render_pass(
        self, scene: _CloseUpScene, patch: Patch, side: int, sampling: Sampling = PLAIN_SAMPLING
    ) -> _MaskedPatch:
        """Cast rays and render one image of a patch."""
        try:
            camera, clip_rays = make_unoccluded_camera(patch, side, scene.caster)
            cast = cast_view(scene.caster, scene.surface.mesh, camera)
        finally:
            self._wait_for_threads()
        passes: Passes = {}
        slot = scene.slots[patch.slot]
        if slot.taps:
            fine = replace(patch.camera(side * sampling.factor), clip_start=camera.clip_start)
            set_camera(scene.temporary.scene, scene.camera, fine, scene.isolated.rigid, scene.isolated.metres_per_unit)
            passes = render_passes(scene.temporary)
            if sampling.factor > 1:
                names = {tap.name for tap in slot.taps}
                passes = {name: decimate(passes[name], sampling.factor) for name in names & passes.keys()}
        rendered = _RenderedPatch(
            patch, camera, cast, scene.surface.mesh, passes, slot, scene.isolated, self._metres_per_unit,
            sampling.folded_m,
        )  # fmt: skip
        mask = _mask_patch_surface(rendered, scene.surface)
        if sampling.factor > 1 and not mask.all():
            mask = erode(mask, FILTER_REACH)  # where the filter reaches beyond the surface
        spacing = _find_fine_faces(rendered, mask, scene.surface)
        return _MaskedPatch(rendered, mask, clip_rays + cast.depth.size, 1 if passes else 0, spacing)


@dataclass(frozen=True)
class _CloseUpScene:
    """Temporary scene with a copy of the object, the part of its surface near the patches, and each slot's shader."""

    temporary: TemporaryScene
    isolated: IsolatedObject
    surface: Surface
    caster: ViewCaster
    slots: Mapping[int, SlotReading]
    camera: Any


def crop_to_patches(surface: Surface, patches: Sequence[Patch]) -> Surface:
    """Return the part of a surface that the patches' cameras can see, so that only it enters the ray caster's BVH."""
    mesh = crop_mesh(surface.mesh, [patch.centre for patch in patches], max(patch.reach_m for patch in patches))
    return replace(surface, mesh=mesh) if len(mesh.triangles) else surface


def _describe_bad_faces(surface: Surface, patches: Sequence[Patch]) -> tuple[str, ...]:
    """Return notes on faces without area near the patches, which no ray meets, and on edges that many faces share."""
    mesh, notes = surface.mesh, []
    with_area = has_area(mesh.corner_positions())
    count = len(np.setdiff1d(mesh.face[~with_area], mesh.face[with_area]))
    if count:
        notes.append(
            f"object '{surface.object_name}' has {pluralize(count, 'face')} without area near what is touched, which "
            "cannot be felt. Mesh > Clean Up > Degenerate Dissolve removes them."
        )
    reach_m = max((patch.size_m for patch in patches), default=0.0) * np.sqrt(0.5)
    if patches and has_crowded_edge(mesh, [patch.centre for patch in patches], reach_m):
        # No number of edges, so that strokes over other parts of the object say the same.
        notes.append(
            f"object '{surface.object_name}' has edges with more than two faces where it is touched: which of them is "
            "felt there is uncertain. In Edit Mode, Select > All by Trait > Non Manifold shows them; delete the "
            "faces that are too many."
        )
    return tuple(notes)


@dataclass(frozen=True)
class _CastPatch:
    """A patch with its ray casts on a mesh."""

    patch: Patch
    camera: Camera
    cast: CastView
    mesh: TriangleMesh

    @cached_property
    def normal(self) -> Float:
        """Smooth shading normals (H, W, 3), which only normal maps need."""
        return compute_view_normals(self.mesh, self.camera, self.cast)

    @property
    def pixel_m(self) -> float:
        return self.patch.size_m / self.camera.width


@dataclass(frozen=True)
class _RenderedPatch(_CastPatch):
    """A patch with its ray casts and render passes."""

    passes: Passes
    slot: SlotReading
    isolated: IsolatedObject
    metres_per_unit: float
    folded_m: float = 0.0


@dataclass(frozen=True)
class _MaskedPatch:
    """A rendered patch with the mask of its own surface, and the rays and renders used, first passes included.

    `spacing` is that of its faces where they are fine enough for relief, None if they nowhere are.
    """

    rendered: _RenderedPatch
    mask: Mask
    rays: int
    renders: int
    spacing: FaceSpacing | None


def make_unoccluded_camera(patch: Patch, pixels: int, caster: ViewCaster) -> tuple[Camera, int]:
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
    mesh_bands: tuple[bool, ...] = ()
    empty_bands: tuple[bool, ...] = ()
    spacing = masked.spacing
    relief = None if spacing is None else _measure_mesh_relief(rendered, mask, spacing, surface)
    if relief is not None:
        total = add_heights(height, resolved, relief, mask, rendered.pixel_m, BAND_WAVELENGTHS_M)
        mesh_bands, empty_bands, resolved = total.mesh_bands, total.empty_bands, total.resolved_wavelength_m
        height, source = total.height.astype(np.float32), describe_mesh_relief(surface.object_name, relief, source)
    rgb = (
        None
        if layers is None
        else mix_closures(layers, rendered.passes, partial(read_shading_value, "base_color", rendered.passes))
    )
    shape = mask.shape
    albedo = np.zeros((*shape, 3), np.float32) if rgb is None else np.broadcast_to(rgb, (*shape, 3)).astype(np.float32)
    seen = np.where((rendered.cast.triangle >= 0)[..., None], albedo, np.float32(0.0))
    view = RgbdView(rendered.camera, seen, rendered.cast.depth.astype(np.float32), rendered.cast.face_id)
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
        mesh_bands=mesh_bands,
        empty_bands=empty_bands,
        is_incomplete=rendered.slot.is_incomplete,
    )


def find_mesh_relief(surface: Surface, patch: Patch, caster: ViewCaster, max_pixels: int) -> MeshRelief | None:
    """Return the relief of the mesh that a close-up of a patch would have, from rays alone; None if it is smooth."""
    side = MIN_MESH_SIDE
    while True:
        camera, _ = make_unoccluded_camera(patch, side, caster)
        cast = _CastPatch(patch, camera, cast_view(caster, surface.mesh, camera), surface.mesh)
        mask = _mask_patch_surface(cast, surface)
        spacing = _find_fine_faces(cast, mask, surface)
        if spacing is None:
            return None
        needed = min(choose_mesh_side(side, patch.size_m, spacing), max_pixels)
        if needed <= side:
            return _measure_mesh_relief(cast, mask, spacing, surface)
        side = needed


def _find_fine_faces(rendered: _CastPatch, mask: Mask, surface: Surface) -> FaceSpacing | None:
    """Find where the faces under a patch are fine enough for relief; None if nowhere, as on most surfaces."""
    patch = rendered.patch
    if mask.shape[1] < GRID or mask.shape[1] % GRID:
        return None
    return find_fine_faces(surface.mesh, rendered.cast.triangle, mask, (patch.x_axis, patch.y_axis), patch.size_m)


def _measure_mesh_relief(
    rendered: _CastPatch, mask: Mask, spacing: FaceSpacing, surface: Surface, *, cut: bool = True
) -> MeshRelief | None:
    """Measure the relief of the mesh under a patch; None if it is smooth. Without `cut` all waves count.

    If fewer pixels show the waves that the faces hold, as on most smooth surfaces, these are examined first.
    """
    depth, size = rendered.cast.depth, rendered.patch.size_m
    # Blender keeps coordinates as float32.
    rounding = float(np.abs(surface.mesh.vertices).max()) * 2.0**-24
    stride = mask.shape[1] // choose_mesh_side(MIN_MESH_SIDE, size, spacing)
    if stride > 1:
        few = (slice(stride // 2, None, stride),) * 2
        if compute_mesh_relief(depth[few], mask[few], spacing, size, rounding_m=rounding) is None:
            return None
    return compute_mesh_relief(depth, mask, spacing, size, rounding_m=rounding, cut_facets=cut)


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


def _mask_patch_surface(rendered: _CastPatch, surface: Surface) -> Mask:
    """Return the pixels (H, W) of the patch's material slot connected to its center without a step in depth."""
    slot = np.where(rendered.cast.triangle >= 0, surface.mesh.slot[rendered.cast.triangle], -1)
    return find_connected_pixels(slot == rendered.patch.slot, rendered.cast.depth, rendered.pixel_m)


def _compute_height(
    rendered: _RenderedPatch, mask: Mask, notes: list[str]
) -> tuple[NDArray[np.float32] | None, str, float]:
    """Return the height (H, W) [m], its source for the report, and its shortest resolved wavelength [m].

    The mean is 0 under `mask`. Without relief the height is None and the wavelength inf.
    """
    nothing = (None, "", float("inf"))
    if not mask.any() or not rendered.passes:
        return nothing
    height, used = _read_height(rendered, mask, notes)
    height = np.where(mask, height - height[mask].mean(), 0.0)
    span = float(np.ptp(height[mask]))
    if not np.isfinite(span):
        notes.append(
            f"material '{rendered.slot.material}' on '{rendered.isolated.original.name}': its height is not a number "
            "there and is not felt. Check the Distance, Strength or Scale of its bump, and what computes its Height."
        )
        return nothing
    if span < MIN_RELIEF_M:
        return nothing
    resolved = compute_resolved_wavelength(used, rendered.passes, mask, rendered.pixel_m)
    height = _restore_texels(rendered, used, height, mask)
    resolved = max(resolved, _find_noise_cutoff(rendered, used, height, mask))
    if not np.isfinite(resolved) and rendered.folded_m > 0.0:
        notes.append(
            f"material '{rendered.slot.material}': its relief there is finer than {2e3 * rendered.pixel_m:.2g} mm, "
            "which is not felt. Check the scale of its texture, and the scene's unit scale."
        )
    elif not np.isfinite(resolved) and _list_images(used):
        names = ", ".join(f"'{image.name}'" for image in _list_images(used))
        notes.append(
            f"material '{rendered.slot.material}': its relief shows nothing but the rounding of {names} there, which "
            "is not felt. A picture of 16 bits would show what is finer."
        )
    return (
        height.astype(np.float32),
        "; ".join(dict.fromkeys(_describe_source(rendered, source) for source in used)),
        resolved,
    )


def _read_height(rendered: _RenderedPatch, mask: Mask, notes: list[str]) -> tuple[Float, list[Relief | Slopes]]:
    """Return the height (H, W) [m] that the shader gives, and the sources it is made from."""
    layers, displacement = rendered.slot.reading.layers, rendered.slot.reading.displacement
    micros = [closure.micro for closure in list_closures(layers)] + [displacement]
    reliefs = [relief for micro in micros for relief in micro.reliefs]
    slopes = [slope for micro in micros for slope in micro.slopes]
    height = np.zeros(mask.shape)
    used: list[Relief | Slopes] = []
    if reliefs and rendered.passes:
        height = height + _compute_relief_height(rendered, layers, displacement)
        used.extend(reliefs)
    if slopes and displacement.reliefs:
        notes.append("a normal map beside a Displacement is not counted: they mostly show the same relief.")
    elif slopes and layers is not None and rendered.passes:
        height = height + _integrate_normals(rendered, layers, mask, notes)
        used.extend(slopes)
    return height, used


def _list_images(used: Sequence[Relief | Slopes]) -> list[ImageTap]:
    """Return the images behind sources of relief, each once."""
    return list({(image.name, image.vector): image for source in used for image in source.images}.values())


def _restore_texels(rendered: _RenderedPatch, used: Sequence[Relief | Slopes], height: Float, mask: Mask) -> Float:
    """Return the height (H, W) [m] without the smoothing of its interpolation, if it shows one image's texels."""
    images = _list_images(used)
    if not is_image_based(rendered.slot) or len(images) != 1:
        return height
    grid = find_texel_grid(images[0], rendered.passes, mask, rendered.pixel_m)
    if grid is None or np.linalg.norm(grid, ord=2) * rendered.pixel_m > 1.0:
        return height
    restored = restore_texels(fill_masked(height, mask), rendered.pixel_m, grid)
    return np.where(mask, restored - restored[mask].mean(), 0.0)


def _find_noise_cutoff(rendered: _RenderedPatch, used: Sequence[Relief | Slopes], height: Float, mask: Mask) -> float:
    """Return the wavelength [m] below which a height (H, W) [m] shows no more than rounding and folded waves."""
    passes = rendered.passes
    square = rendered.folded_m**2
    slope_square = 0.0
    for source in used:
        for image in source.images:
            if isinstance(source, Relief):
                own = _get_height_scale(rendered, source) * source.tap.read(passes)
                square += measure_image_step(image, own, passes, mask) ** 2 / 12.0
            else:
                # A component n = 2 c − 1 of a normal near (0, 0, 1), along both axes.
                slope_square += 2.0 * (2.0 * image.step * source.strength) ** 2 / 12.0
    cutoff = 0.0
    if square > 0.0:
        cutoff = find_noise_cutoff(measure_octave_heights(height, mask, rendered.pixel_m), np.sqrt(square))
    if slope_square > 0.0:
        filled = fill_masked(height, mask)
        octaves = [
            measure_octave_heights(np.gradient(filled, rendered.pixel_m, axis=axis), mask, rendered.pixel_m)
            for axis in (0, 1)
        ]
        cutoff = max(cutoff, find_noise_cutoff(np.hypot(*octaves), np.sqrt(slope_square)))
    return cutoff


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
    factors = _judge_normals(rendered, layers, mask, notes)

    slopes = mix_closures(layers, rendered.passes, lambda closure: _compute_slopes(rendered, closure.micro, factors))
    if slopes is None:
        return np.zeros(mask.shape)
    gx, gy = slopes[..., 0], slopes[..., 1]
    valid = mask & np.isfinite(gx) & np.isfinite(gy)
    if not valid.any():
        notes.append(
            f"material '{rendered.slot.material}': its normal map holds no usable normals, all point into the surface. "
            "Check its picture and its Color Space."
        )
        return np.zeros(mask.shape)
    if has_flipped_green(gx, gy, valid):
        notes.append(
            f"material '{rendered.slot.material}': its normal map looks like a DirectX one (green points down); "
            "invert its green channel."
        )
    return height_from_slopes(gx, gy, valid, rendered.pixel_m)


def _judge_normals(rendered: _RenderedPatch, layers: Layers, mask: Mask, notes: list[str]) -> dict[Slopes, Float]:
    """Return the factor (H, W) on the slopes of each normal map, and append a note on each that holds no normals."""
    factors = {}
    for slopes in {slopes for closure in list_closures(layers) for slopes in closure.micro.slopes if slopes.colour}:
        assert slopes.colour is not None
        kind, factors[slopes] = judge_normal_colour(slopes.colour.read(rendered.passes), mask)
        name = slopes.images[0].name if slopes.images else slopes.source
        if kind == "grey":
            notes.append(
                f"material '{rendered.slot.material}': its normal map '{name}' is a gray picture without normals: it "
                "is not used. If it shows heights, connect it to the Height of a Bump node."
            )
        elif kind:
            notes.append(
                f"material '{rendered.slot.material}': its normal map '{name}' has two channels, its blue is empty: it "
                "is rebuilt from red and green."
            )
    return factors


def _compute_slopes(rendered: _RenderedPatch, micro: MicroGeometry, factors: Mapping[Slopes, Float]) -> Float:
    """Return the slopes ∂h/∂x and ∂h/∂y of a closure (BSDF) in the patch's frame, (H, W, 2).

    They are 0 without a normal map.
    """
    total = np.zeros((rendered.camera.height, rendered.camera.width, 2))
    if not micro.slopes:
        return total
    smooth = rendered.normal
    frame = rendered.patch.x_axis - smooth * (smooth @ rendered.patch.x_axis)[..., None]
    length = np.linalg.norm(frame, axis=-1, keepdims=True)
    x_axis = frame / np.where(length > 0.0, length, 1.0)
    tangents = x_axis, np.cross(smooth, x_axis)
    for slopes in micro.slopes:
        normal = slopes.tap.read(rendered.passes) @ rendered.isolated.rigid[:3, :3]
        normal_part = np.sum(normal * smooth, axis=-1)
        divisor, factor = np.where(normal_part > 0.05, normal_part, np.nan), factors.get(slopes)
        for axis, tangent in enumerate(tangents):
            slope = np.clip(np.sum(normal * tangent, axis=-1) / divisor, -10.0, 10.0)
            # A factor of 0 also drops what is no number.
            total[..., axis] -= slope if factor is None else np.where(factor == 0.0, 0.0, slope * factor)
    return total
