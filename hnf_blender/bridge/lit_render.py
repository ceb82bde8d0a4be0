"""Lit views of a scene for people to look at, hashes of all that such a view shows, and its cameras' exact passes.

A view for people is rendered with few samples and denoised. Its hash covers camera, lights, world and objects, so that
unchanged views are not rendered again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import HnfError
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera
from hnf_core.scene.rgbd_view import RgbdView, read_cryptomatte_names

from .. import compat
from .cycles import PASSES_FILE, add_camera, configure_cycles, get_planar_depth, read_camera, render_passes, set_camera
from .scene.meshes import get_slot_materials, hash_mesh
from .scene.temp_scene import TemporaryScene, suppress_output
from .shader.images import fingerprint_file
from .shader.object_inputs import find_shader_inputs, format_object_inputs
from .shader.shader_hash import format_settings, hash_material, hash_node_tree

DOME_STRENGTH = 1.0
"""Strength of the uniform white world that lights a scene without light."""
MAX_BOUNCES = 4
"""Maximum number of bounces in lit views."""
Relief = Literal["", "fast", "accurate"]
"""Accuracy with which a denoiser preserves relief."""


class OverviewRenderer:
    """Context manager that renders lit views of one scene, in a temporary scene that Cycles keeps between views.

    Unchanged data is neither loaded nor built again. Other work may continue in the .blend meanwhile: between views the
    temporary scene contains none of the user's objects, unless `entire_scene` is set. A scene without light gets a
    uniform white world.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene to render.
    metres_per_unit : float, default 1.0
        Length of a Blender unit [m].
    samples : int, default 16
        Samples per pixel.
    entire_scene : bool, default False
        Render all objects. Otherwise only those named for each view and the scene's lights, so that the cost does not
        depend on the scene.
    relief : {"", "fast", "accurate"}
        Preserve details a few pixels wide when denoising; otherwise ridges of a surface may be removed as noise.
        "accurate" takes longer than two more samples per pixel.
    """

    def __init__(
        self,
        scene: Any,
        *,
        metres_per_unit: float = 1.0,
        samples: int = 16,
        entire_scene: bool = False,
        relief: Relief = "",
    ) -> None:
        self._scene, self._metres, self._samples = scene, metres_per_unit, samples
        self._entire_scene, self._relief = entire_scene, relief
        self._dome: Any = None
        self._was_dark = False

    def __enter__(self) -> OverviewRenderer:
        self.temporary = TemporaryScene(self._scene if self._entire_scene else None, long_lived=True).__enter__()
        try:
            with self.temporary.track_new_data():
                scene = self.temporary.scene
                configure_cycles(scene, self._samples)
                _configure_quick_render(scene, self._relief)
                scene.render.use_persistent_data = True
                self.temporary.view_layer.use_pass_z = self.temporary.view_layer.use_pass_normal = True
                self._camera = add_camera(self.temporary)
        except BaseException:
            self.temporary.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.temporary.__exit__(None, None, None)

    def render_view(
        self, camera: Camera | None, objects: Sequence[Any] = (), frame: float | None = None
    ) -> tuple[RgbdView, tuple[str, ...]]:
        """Render one view.

        Parameters
        ----------
        camera : Camera or None
            Camera in world coordinates [m]; None is the scene's own.
        objects : sequence of bpy.types.Object
            Objects to render, unless `entire_scene` is set.
        frame : float, optional
            Scene frame; the current one by default.

        Returns
        -------
        view : RgbdView
        notes : tuple of str
            Remarks for the user.
        """
        scene, temporary = self._scene, self.temporary
        with (
            temporary.track_new_data(),
            self._link_temporarily([] if self._entire_scene else objects, scene.camera if camera is None else None),
        ):
            notes = self._set_lighting(scene)
            if camera is None:
                camera = self._use_scene_camera(frame)
            else:
                temporary.scene.camera = self._camera
                set_camera(temporary.scene, self._camera, camera, np.eye(4), self._metres)
                temporary.evaluate(_get_frame(scene, frame))
            is_dark = not notes and self._was_dark and self._looks_black()
            passes = {} if is_dark else render_passes(temporary)
            if is_dark or (not notes and self._is_black(passes)):
                temporary.scene.world = self._get_dome()
                passes = render_passes(temporary)
                if not self._is_black(passes):  # else the surface itself is black
                    notes, self._was_dark = (BLACK_NOTE,), True
        depth = get_planar_depth(passes, self._metres)
        view = RgbdView(
            camera=camera,
            rgb=np.ascontiguousarray(passes["Combined"][..., :3]),
            depth=depth,
            face_id=np.full(depth.shape, -1, dtype=np.int32),
            normal=passes["Normal"][..., :3],
        )
        return view, notes

    def measure_depth(self, camera: Camera, objects: Sequence[Any]) -> NDArray[np.float32]:
        """Render the planar depth (H, W) of a camera's view [m], to tell what it hides before the view is rendered.

        One noisy sample without a denoiser costs a small part of the view.
        """
        temporary = self.temporary
        with temporary.track_new_data(), self._link_temporarily([] if self._entire_scene else objects, None):
            self._set_lighting(self._scene)
            temporary.scene.camera = self._camera
            set_camera(temporary.scene, self._camera, camera, np.eye(4), self._metres)
            temporary.evaluate(_get_frame(self._scene, None))
            with self._quick_settings():
                return get_planar_depth(render_passes(temporary), self._metres)

    @contextmanager
    def _quick_settings(self) -> Iterator[None]:
        """Render one sample a pixel and do not denoise it, for the with block."""
        cycles = self.temporary.scene.cycles
        before = cycles.samples, cycles.use_denoising
        cycles.samples, cycles.use_denoising = 1, False
        try:
            yield
        finally:
            cycles.samples, cycles.use_denoising = before

    def _is_black(self, passes: dict[str, NDArray[np.float32]], **limit: float) -> bool:
        """Return True if rendered passes are black where they show a surface."""
        return is_black(passes["Combined"][..., :3], np.isfinite(get_planar_depth(passes, self._metres)), **limit)

    def _looks_black(self) -> bool:
        """Return True if not one pixel of a small, noisy render of the view is lit.

        Where one view was black the next one mostly is: this look costs little and saves rendering it twice.
        """
        render = self.temporary.scene.render
        before = render.resolution_percentage
        render.resolution_percentage = max(1, before // PREVIEW_REDUCTION)
        try:
            with self._quick_settings():
                return self._is_black(render_passes(self.temporary), min_lit=0.0)
        finally:
            render.resolution_percentage = before

    def link_objects(self, objects: Sequence[Any]) -> AbstractContextManager[None]:
        """Link objects for several renders within the with block, so that Cycles builds their geometry once."""
        return self._link_temporarily(objects, None)

    @contextmanager
    def _link_temporarily(self, objects: Sequence[Any], camera: Any) -> Iterator[None]:
        """Link objects, the user's lights and a camera to the temporary scene for the with block.

        Those that are linked already stay so.
        """
        lights = [] if self._entire_scene else [obj for obj in self._scene.objects if obj.type == "LIGHT"]
        collection = self.temporary.scene.collection
        wanted = dict.fromkeys([*objects, *lights, *([] if camera is None or self._entire_scene else [camera])])
        linked = [member for member in wanted if self.temporary.scene not in member.users_scene]
        try:
            for member in linked:
                self.temporary.link(member)
            yield
        finally:
            for member in linked:
                if self.temporary.scene in member.users_scene:
                    collection.objects.unlink(member)

    def _set_lighting(self, scene: Any) -> tuple[str, ...]:
        """Use the world of the user's scene, or a uniform white one if that scene has no light; return notes."""
        self.temporary.scene.world = scene.world
        # A light tree is faster with many lights; with one lamp it gives the same pixels in up to a tenth more time.
        self.temporary.scene.cycles.use_light_tree = _count_lamps(self.temporary.scene) > 1 or _has_emissive_material(
            self.temporary.scene
        )
        if is_lit(self.temporary.scene):
            return ()
        self.temporary.scene.world = self._get_dome()
        return ("the scene has no light: a neutral dome lights the picture.",)

    def _get_dome(self) -> Any:
        """Return the uniform white world, made when it is first needed."""
        if self._dome is None:
            self._dome = make_dome()
        return self._dome

    def _use_scene_camera(self, frame: float | None) -> Camera:
        """Make the camera of the user's scene active in the temporary scene; return it as a Camera."""
        scene, temporary = self._scene, self.temporary
        temporary.scene.camera = scene.camera
        _copy_resolution(scene, temporary.scene)
        temporary.evaluate(_get_frame(scene, frame))
        evaluated = scene.camera.evaluated_get(temporary.view_layer.depsgraph)
        return read_camera(temporary.scene, scene.camera, self._metres, evaluated.matrix_world)


@dataclass(frozen=True)
class CameraView:
    """View of a scene by one of its cameras.

    Attributes
    ----------
    view : RgbdView
        Color, and depth and normals at the pixel centers.
    object_id, material_id : (H, W) uint32 array
        Index of what is seen there in `CameraViewRenderer.objects` and `materials`; 0 where nothing is seen, or what
        is seen has no material.
    notes : tuple of str
        Remarks for the user.
    """

    view: RgbdView
    object_id: NDArray[np.uint32]
    material_id: NDArray[np.uint32]
    notes: tuple[str, ...]


EXACT_SETTINGS = {"samples": 1, "use_denoising": False, "pixel_filter_type": "BOX", "filter_width": 0.01}
"""Settings of Cycles with which every ray goes through a pixel's center."""
NO_MATERIAL = "default_surface"
"""Cycles' name of the material of a surface that has none."""


class CameraViewRenderer(OverviewRenderer):
    """Context manager that renders what cameras of a scene see, all objects included, at the scene's own bounces.

    `objects` and `materials` list the names of what was seen so far; the first is "".

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene to render.
    metres_per_unit : float
        Length of a Blender unit [m].
    samples : int
        Samples per pixel of the color.
    """

    def __init__(self, scene: Any, *, metres_per_unit: float, samples: int) -> None:
        super().__init__(scene, metres_per_unit=metres_per_unit, samples=samples, entire_scene=True, relief="accurate")
        self.objects, self.materials = [""], [""]

    def __enter__(self) -> CameraViewRenderer:
        super().__enter__()
        for name in ("max_bounces", "caustics_reflective", "caustics_refractive"):
            setattr(self.temporary.scene.cycles, name, getattr(self._scene.cycles, name))
        return self

    def read_camera(self, camera_object: Any, frame: float | None, size: tuple[int, int] | None) -> Camera:
        """Return a camera of the scene at a frame (the current one by default) and image size (the scene's own).

        Raises SceneError for a panoramic camera.
        """
        scene, render = self._scene, self.temporary.scene.render
        _copy_resolution(scene, self.temporary.scene)
        if size is not None:
            render.resolution_x, render.resolution_y = size
            render.resolution_percentage = 100
        depsgraph = self.temporary.evaluate(_get_frame(scene, frame))
        evaluated = camera_object.evaluated_get(depsgraph)
        camera = read_camera(self.temporary.scene, evaluated, self._metres, evaluated.matrix_world)
        render.resolution_percentage = 100  # included in the camera's size
        return camera

    def render_camera(self, camera: Camera, frame: float | None = None) -> CameraView:
        """Render the color of a view, then its depth, normals and ids by one ray through each pixel's center.

        Raises SceneError if its pixels are not square or Blender fails.
        """
        lit, notes = self.render_view(camera, frame=frame)
        cycles, layer = self.temporary.scene.cycles, self.temporary.view_layer
        before = {name: getattr(cycles, name) for name in EXACT_SETTINGS}
        layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_material = True
        layer.pass_cryptomatte_depth = 2
        try:
            for name, value in EXACT_SETTINGS.items():
                setattr(cycles, name, value)
            passes = render_passes(self.temporary)
        finally:
            for name, value in before.items():
                setattr(cycles, name, value)
            layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_material = False
        names = read_cryptomatte_names(self.temporary.folder / PASSES_FILE)
        depth = get_planar_depth(passes, self._metres)
        view = RgbdView(camera, lit.rgb, depth, lit.face_id, passes["Normal"][..., :3])
        is_seen = np.isfinite(depth)
        return CameraView(
            view,
            _number_names(passes["CryptoObject00"], is_seen, names, self.objects),
            _number_names(passes["CryptoMaterial00"], is_seen, names, self.materials),
            notes,
        )


def _number_names(
    cryptomatte: NDArray[np.float32], is_seen: NDArray[np.bool_], names: dict[int, str], table: list[str]
) -> NDArray[np.uint32]:
    """Return each pixel's index in `table`, which is extended by the names that are new, in alphabetical order."""
    codes, index = np.unique(np.ascontiguousarray(cryptomatte[..., 0]).view(np.uint32), return_inverse=True)
    index = index.reshape(is_seen.shape)
    shown = np.unique(index[is_seen])
    found = [names.get(int(code), "") for code in codes]
    found = ["" if name == NO_MATERIAL else name for name in found]
    table += sorted({found[each] for each in shown} - set(table))
    numbers = np.array([table.index(name) if name in table else 0 for name in found], dtype=np.uint32)
    return np.asarray(np.where(is_seen, numbers[index], 0), dtype=np.uint32)


BLACK_NOTE = "none of the scene's light falls on what the picture shows: a neutral dome lights it."
DARK = 2e-3
"""Linear value below which a pixel is black on any screen (of sRGB: half a step of 8 bits)."""
MIN_LIT_FRACTION = 0.01
"""Fraction of a surface's pixels that must not be black in a lit view."""


PREVIEW_REDUCTION = 8
"""Factor by which a first look at a view that may be black is smaller than the view."""


def is_black(rgb: NDArray[np.float32], mask: NDArray[np.bool_], min_lit: float = MIN_LIT_FRACTION) -> bool:
    """Return True if a linear image (H, W, 3) is black where it shows a surface (`mask`, (H, W)); False without any.

    It is not black with `min_lit` of the surface's pixels lit, or with more; with 0.0, any lit pixel counts.
    """
    lit = rgb[mask].max(axis=-1, initial=0.0) > DARK
    return bool(len(lit) > 0 and (lit.mean() < min_lit or not lit.any()))


def add_dome(scene: Any) -> None:
    """Give a scene a uniform white world."""
    scene.world = make_dome()


def make_dome() -> Any:
    """Return a new uniform white world."""
    import bpy

    world = bpy.data.worlds.new("hnf dome")
    compat.switch_nodes_on(world)
    background = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = DOME_STRENGTH
    return world


def is_lit(scene: Any) -> bool:
    """Return True if a scene has a lamp, a world that is not black, or an emissive material."""
    return (
        _count_lamps(scene) > 0
        or (scene.world is not None and _is_emissive(scene.world))
        or _has_emissive_material(scene)
    )


def _count_lamps(scene: Any) -> int:
    """Return the number of lamps that are on."""
    return sum(obj.type == "LIGHT" and not obj.hide_render and obj.data.energy > 0.0 for obj in scene.objects)


def _has_emissive_material(scene: Any) -> bool:
    """Return True if a rendered object has an emissive material."""
    slots = (slot for obj in scene.objects if not obj.hide_render for slot in obj.material_slots)
    return any(slot.material is not None and _is_emissive(slot.material) for slot in slots)


def _is_emissive(datablock: Any) -> bool:
    """Return True if a material or world emits light."""
    if not compat.use_nodes(datablock):
        return bool(datablock.id_type == "WORLD" and max(datablock.color) > 0.0)
    return any(_is_emissive_node(node) for node in datablock.node_tree.nodes)


def _is_emissive_node(node: Any) -> bool:
    """Return True if a node emits light."""
    if node.bl_idname in {"ShaderNodeEmission", "ShaderNodeBackground"}:
        colour, strength = node.inputs["Color"], node.inputs["Strength"]
    elif node.bl_idname == "ShaderNodeBsdfPrincipled":
        colour, strength = node.inputs["Emission Color"], node.inputs["Emission Strength"]
    else:
        return False
    bright = colour.is_linked or max(list(colour.default_value)[:3]) > 0.0
    return bool(bright and (strength.is_linked or strength.default_value > 0.0))


def _copy_resolution(scene: Any, target: Any) -> None:
    for name in ("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y"):
        setattr(target.render, name, getattr(scene.render, name))


def _get_frame(scene: Any, frame: float | None) -> float:
    return float(scene.frame_current_final) if frame is None else frame


def _configure_quick_render(scene: Any, relief: Relief) -> None:
    """Limit the bounces, and enable the Open Image Denoise denoiser if this build of Blender includes it.

    Enabling it in a build without it would make the render fail. `relief` preserves fine details.
    """
    cycles = scene.cycles
    cycles.max_bounces = min(cycles.max_bounces, MAX_BOUNCES)
    cycles.caustics_reflective = cycles.caustics_refractive = False
    if not compat.has_denoiser():
        return
    cycles.use_denoising = True
    with suppress_output():  # setting the denoiser makes Cycles search for GPUs, and print if there are none
        cycles.denoiser = "OPENIMAGEDENOISE"
    # With so few samples albedo and normals are as noisy as the color. They help only if they are denoised accurately
    # first, which takes longer than the color itself.
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL" if relief else "RGB"
    cycles.denoising_prefilter = "ACCURATE" if relief == "accurate" else "FAST"
    if hasattr(cycles, "denoising_quality"):
        cycles.denoising_quality = "FAST"


VISIBILITY_FLAGS = (
    "hide_render", "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission",
    "visible_volume_scatter", "visible_shadow", "is_holdout", "is_shadow_catcher",
)  # fmt: skip
SCATTER_MODIFIERS = frozenset({"NODES", "PARTICLE_SYSTEM"})
"""Modifiers that may show geometry that is not in the object's own mesh."""


class RenderHashes:
    """Hashes of views of one scene in its current state; each object is hashed once.

    External image files count by size and modification time, because a scene may have many and a view is rendered fast.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that is rendered.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    source : str, optional
        Hash of the .blend file, which stands for everything that is not hashed by itself: scattered instances, hair,
        objects without faces.
    """

    def __init__(self, scene: Any, depsgraph: Any, metres_per_unit: float, source: str = "") -> None:
        self._scene, self._depsgraph, self._metres, self._source = scene, depsgraph, metres_per_unit, source
        self._lighting_hash = ""
        self._objects: dict[int, str] = {}
        self._materials: dict[int, str] = {}

    def hash_view(self, camera: Camera, objects: Iterable[Any], *extra: str) -> str:
        """Hash a view of `objects` by a camera; `extra` are texts that are hashed too, for whatever else is drawn."""
        if not self._lighting_hash:
            self._lighting_hash = content_hash(*_iter_lighting_values(self._scene, self._depsgraph))
        view = (
            camera.kind, camera.width, camera.height, camera.intrinsics.tolist(), camera.pose.tolist(),
            camera.clip_start, camera.clip_end,
        )  # fmt: skip
        return content_hash(repr(view), self._lighting_hash, *sorted(map(self._hash_object, objects)), *extra)

    def _hash_object(self, obj: Any) -> str:
        key = obj.as_pointer()
        if key not in self._objects:
            self._objects[key] = content_hash(*self._iter_object_values(obj))
        return self._objects[key]

    def _iter_object_values(self, obj: Any) -> Iterator[str]:
        yield _format_world_matrix(obj, self._depsgraph)
        yield repr([getattr(obj, name) for name in VISIBILITY_FLAGS])
        yield repr([(modifier.show_render, getattr(modifier, "render_levels", 0)) for modifier in obj.modifiers])
        if obj.instance_type != "NONE" or any(modifier.type in SCATTER_MODIFIERS for modifier in obj.modifiers):
            yield self._source
        try:
            materials = get_slot_materials(obj, self._depsgraph)
            inputs = find_shader_inputs(obj, materials)
            yield hash_mesh(obj, self._depsgraph, self._metres, inputs.layers)
        except HnfError:
            yield self._source
            return
        yield format_object_inputs(obj, self._scene.view_layers[0], materials, inputs)
        yield from map(self._hash_material, materials)

    def _hash_material(self, material: Any) -> str:
        if material is None:
            return ""
        key = material.as_pointer()
        if key not in self._materials:
            self._materials[key] = hash_material(material, self._scene.frame_current, fingerprint_file)
        return self._materials[key]


def _iter_lighting_values(scene: Any, depsgraph: Any) -> Iterator[str]:
    """Yield the values that determine a scene's lighting."""
    frame, world = scene.frame_current, scene.world
    for lamp in (obj for obj in scene.objects if obj.type == "LIGHT"):
        data = lamp.data
        yield _format_world_matrix(lamp, depsgraph)
        yield repr([getattr(lamp, name) for name in VISIBILITY_FLAGS])
        yield data.type + format_settings(data) + format_settings(getattr(data, "cycles", None))
        yield hash_node_tree(data.node_tree if getattr(data, "use_nodes", True) else None, frame, fingerprint_file)
    if world is not None:
        yield format_settings(world) + format_settings(getattr(world, "cycles", None))
        yield hash_node_tree(world.node_tree if compat.use_nodes(world) else None, frame, fingerprint_file)


def _format_world_matrix(obj: Any, depsgraph: Any) -> str:
    """Format an object's evaluated world matrix."""
    return repr([list(row) for row in obj.evaluated_get(depsgraph).matrix_world])
