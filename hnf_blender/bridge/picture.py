"""Lit pictures: the whole scene for people to look at, and lit close-ups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.camera import Camera
from hnf_core.scene.raycast import RayCaster, cast_view
from hnf_core.scene.view import RgbdView

from .. import compat
from .meshes import Surface, ray_caster
from .quiet import quiet
from .render import add_camera, aim, planar_depth, prepare_cycles, render_passes
from .stage import set_stage
from .temporary import Temporary

DOME_STRENGTH = 1.0
MAX_BOUNCES = 4
SAME_DEPTH = 1e-3
"""Relative depth difference under which a rendered pixel shows the surface that a ray met."""


class Overviews:
    """Lit views of one scene, one render each, on a temporary scene that Cycles keeps between them: what did not change
    is neither loaded nor built again. Use as a context manager; other work may go on in the file meanwhile.

    whole: everything in the scene is rendered; else what each view names, and the scene's lights, so that cost does not
    follow the scene. The pictures are denoised where this Blender can. relief: what is a few pixels wide stays then,
    which takes longer than two samples do; without it a surface's ridges may be taken for noise. A scene without light
    gets a neutral dome. Between two views no object of the user's is in the temporary scene, unless it is whole.
    """

    def __init__(
        self, scene: Any, *, metres_per_unit: float = 1.0, samples: int = 16, whole: bool = False, relief: bool = False
    ) -> None:
        self._scene, self._metres, self._samples = scene, metres_per_unit, samples
        self._whole, self._relief = whole, relief
        self._dome: Any = None

    def __enter__(self) -> Overviews:
        self.temporary = Temporary(self._scene if self._whole else None, lasting=True).__enter__()
        try:
            with self.temporary.making():
                scene = self.temporary.scene
                prepare_cycles(scene, self._samples)
                _for_a_quick_look(scene, self._relief)
                scene.render.use_persistent_data = True
                self.temporary.view_layer.use_pass_z = self.temporary.view_layer.use_pass_normal = True
                self._camera = add_camera(self.temporary)
        except BaseException:
            self.temporary.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.temporary.__exit__(None, None, None)

    def view(
        self, camera: Camera | None, objects: Sequence[Any] = (), frame: float | None = None
    ) -> tuple[RgbdView, tuple[str, ...]]:
        """(view, notes). camera: world metres; None = the scene's own. objects: to render, unless whole. frame: of the
        scene, None = now."""
        scene, temporary = self._scene, self.temporary
        with temporary.making(), self._linked([] if self._whole else objects, scene.camera if camera is None else None):
            notes = self._light(scene)
            if camera is None:
                camera = self._of_the_scene(frame)
            else:
                temporary.scene.camera = self._camera
                aim(temporary.scene, self._camera, camera, np.eye(4), self._metres)
                temporary.evaluate(_frame(scene, frame))
            passes = render_passes(temporary)
        depth = planar_depth(passes, self._metres)
        view = RgbdView(
            camera=camera,
            rgb=np.ascontiguousarray(passes["Combined"][..., :3]),
            depth=depth,
            face_id=np.full(depth.shape, -1, dtype=np.int32),
            normal=passes["Normal"][..., :3],
        )
        return view, notes

    @contextmanager
    def _linked(self, objects: Sequence[Any], camera: Any) -> Iterator[None]:
        """objects, the scene's lights and its camera stand in the temporary scene in this block."""
        lights = [] if self._whole else [each for each in self._scene.objects if each.type == "LIGHT"]
        collection = self.temporary.scene.collection
        guests = dict.fromkeys([*objects, *lights, *([] if camera is None or self._whole else [camera])])
        try:
            for guest in guests:
                self.temporary.link(guest)
            yield
        finally:
            for guest in guests:
                if self.temporary.scene in guest.users_scene:
                    collection.objects.unlink(guest)

    def _light(self, scene: Any) -> tuple[str, ...]:
        self.temporary.scene.world = scene.world
        # A tree of lights pays where there are many; beside one lamp it gives the same pixels for up to a tenth more.
        self.temporary.scene.cycles.use_light_tree = _lamps(self.temporary.scene) > 1 or _glow(self.temporary.scene)
        if is_lit(self.temporary.scene):
            return ()
        if self._dome is None:
            add_dome(self.temporary.scene)
            self._dome = self.temporary.scene.world
        self.temporary.scene.world = self._dome
        return ("the scene has no light: a neutral dome lights the picture.",)

    def _of_the_scene(self, frame: float | None) -> Camera:
        """The scene's own camera, evaluated and rendered from."""
        from .scene_camera import camera_record

        scene, temporary = self._scene, self.temporary
        temporary.scene.camera = scene.camera
        _copy_frame(scene, temporary.scene)
        temporary.evaluate(_frame(scene, frame))
        evaluated = scene.camera.evaluated_get(temporary.view_layer.depsgraph)
        return camera_record(temporary.scene, scene.camera, self._metres, evaluated.matrix_world)


def render_overview(
    scene: Any,
    camera: Camera | None,
    *,
    metres_per_unit: float = 1.0,
    samples: int = 16,
    objects: Sequence[Any] | None = None,
    surface: Surface | None = None,
    caster: RayCaster | None = None,
    frame: float | None = None,
) -> tuple[RgbdView, tuple[str, ...]]:
    """(view, notes): one view of Overviews. objects: None = everything. surface: fills face_id with the evaluated
    polygons of this object where it is what the camera sees."""
    with Overviews(scene, metres_per_unit=metres_per_unit, samples=samples, whole=objects is None) as overviews:
        view, notes = overviews.view(camera, objects or (), frame)
    if surface is not None:
        view = replace(view, face_id=visible_faces(view, surface, caster or ray_caster(surface.mesh)))
    return view, notes


def visible_faces(view: RgbdView, surface: Surface, caster: RayCaster) -> NDArray[np.int32]:
    """(H, W) evaluated polygon of surface that each pixel of view shows, -1 where it shows something else."""
    cast = cast_view(caster, surface.mesh, in_surface_frame(view.camera, surface))
    seen = np.isfinite(cast.depth) & np.isfinite(view.depth)
    ours, theirs = np.where(seen, cast.depth, 0.0), np.where(seen, view.depth, 0.0)
    same = seen & (np.abs(ours - theirs) <= SAME_DEPTH * ours)
    return np.where(same, cast.face_id, -1).astype(np.int32)


def in_surface_frame(camera: Camera, surface: Surface) -> Camera:
    """A world camera, seen from a surface's own frame."""
    return replace(camera, pose=np.linalg.inv(surface.rigid) @ camera.pose)


def lit_pictures(
    obj: Any,
    cameras: Sequence[Camera],
    samples: int,
    metres_per_unit: float,
    frame: float | None,
    view_layer: Any = None,
) -> list[NDArray[np.float32]]:
    """(H, W, 3) linear pictures of obj alone under a neutral dome; cameras in its surface frame. One render each."""
    with Temporary() as temporary:
        prepare_cycles(temporary.scene, samples)
        stage = set_stage(temporary, obj, metres_per_unit, frame, view_layer=view_layer)
        add_dome(temporary.scene)
        camera_object = add_camera(temporary)
        temporary.scene.render.use_persistent_data = len(cameras) > 1
        pictures = []
        for camera in cameras:
            aim(temporary.scene, camera_object, camera, stage.rigid, stage.metres_per_unit)
            pictures.append(np.ascontiguousarray(render_passes(temporary)["Combined"][..., :3]))
    return pictures


def add_dome(scene: Any) -> None:
    """An even white world."""
    import bpy

    world = bpy.data.worlds.new("hnf dome")
    compat.switch_nodes_on(world)
    background = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = DOME_STRENGTH
    scene.world = world


def is_lit(scene: Any) -> bool:
    """Is there a lamp, a world that is not black, or a material that glows?"""
    return _lamps(scene) > 0 or (scene.world is not None and _glows(scene.world)) or _glow(scene)


def _lamps(scene: Any) -> int:
    """That are on."""
    return sum(obj.type == "LIGHT" and not obj.hide_render and obj.data.energy > 0.0 for obj in scene.objects)


def _glow(scene: Any) -> bool:
    """Whether a material does."""
    slots = (slot for obj in scene.objects if not obj.hide_render for slot in obj.material_slots)
    return any(slot.material is not None and _glows(slot.material) for slot in slots)


def _glows(datablock: Any) -> bool:
    if not compat.use_nodes(datablock):
        return bool(datablock.id_type == "WORLD" and max(datablock.color) > 0.0)
    return any(_emits(node) for node in datablock.node_tree.nodes)


def _emits(node: Any) -> bool:
    if node.bl_idname in {"ShaderNodeEmission", "ShaderNodeBackground"}:
        colour, strength = node.inputs["Color"], node.inputs["Strength"]
    elif node.bl_idname == "ShaderNodeBsdfPrincipled":
        colour, strength = node.inputs["Emission Color"], node.inputs["Emission Strength"]
    else:
        return False
    bright = colour.is_linked or max(list(colour.default_value)[:3]) > 0.0
    return bool(bright and (strength.is_linked or strength.default_value > 0.0))


def _copy_frame(scene: Any, target: Any) -> None:
    for name in ("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y"):
        setattr(target.render, name, getattr(scene.render, name))


def _frame(scene: Any, frame: float | None) -> float:
    return float(scene.frame_current_final) if frame is None else frame


def _for_a_quick_look(scene: Any, relief: bool) -> None:
    """Few bounces, and Open Image Denoise where this build has it: without it the render would fail, or stay noisy."""
    cycles = scene.cycles
    cycles.max_bounces = min(cycles.max_bounces, MAX_BOUNCES)
    cycles.caustics_reflective = cycles.caustics_refractive = False
    if not compat.has_denoiser():
        return
    cycles.use_denoising = True
    with quiet():  # naming one makes Cycles look for graphics cards, and say on standard output that there are none
        cycles.denoiser = "OPENIMAGEDENOISE"
    # Of so few samples albedo and normal are as noisy as the colour: they only help once they are denoised themselves,
    # and well, which takes longer than the colour does.
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL" if relief else "RGB"
    cycles.denoising_prefilter = "ACCURATE" if relief else "FAST"
    if hasattr(cycles, "denoising_quality"):
        cycles.denoising_quality = "FAST"
