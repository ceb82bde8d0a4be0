"""The touched object alone on a temporary stage, its materials replaced by copies that tell what they are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError

from ... import compat
from ..scene.meshes import Surface, compute_surface_frame, evaluated_mesh, flush_edits, get_materials, read_surface
from ..scene.temp_scene import TemporaryScene
from ..shader.aov_taps import IMAGE_NODE, Tap, Tapper
from ..shader.bump_displacement import MicroGeometry
from ..shader.closures import ColourSources, ShaderReading, find_colour_sources, read_shader, read_viewport_shading
from ..shader.images import UNSAVED_IMAGE_REMEDY, explain_missing_image, has_unsaved_paint
from ..shader.node_graph import NodeGraph, iter_nodes
from ..shader.object_inputs import copy_object_inputs, find_shader_inputs

Float = NDArray[np.float64]

RANDOM_NOTE = "Object Info's Random cannot be repeated in a close-up: its pattern may differ."


@dataclass(frozen=True)
class IsolatedObject:
    """What stands on the temporary scene. actor: the object. rigid: (4, 4) stage metres ← surface frame.
    metres_per_unit: of the stage. stretch: (3, 3) surface frame ← object space. notes: about the whole object.
    owner: the user's own object. surface: what rays meet, of the very mesh that is rendered."""

    temporary: TemporaryScene
    original: Any
    stand_in: Any
    rigid: Float
    metres_per_unit: float
    stretch: Float
    notes: tuple[str, ...]
    surface: Surface


def isolate_object(
    temporary: TemporaryScene,
    obj: Any,
    metres_per_unit: float,
    frame: float | None,
    surface: Surface | None = None,
    view_layer: Any = None,
) -> IsolatedObject:
    """Copy obj onto the stage: without rotation and translation, in metres, so that no place in the world can
    change a bit of what is rendered; at its true place where its shaders look at the world.

    frame: scene frame of an animated object, None = as it is now. surface: of obj at frame, made here where not
    given. view_layer: of the scene that obj is touched in, None = the first that it stands in. Raises SceneError where
    there is no surface.
    """
    original = obj.original
    where = f"object '{original.name}'"
    flush_edits(original)
    home = view_layer or _find_home_layer(original, temporary.scene)
    if frame is None and home is not None:
        frame = float(home.id_data.frame_current_final)
    temporary.link(original)
    try:
        depsgraph = temporary.evaluate(frame)
        evaluated = original.evaluated_get(depsgraph)
        rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, where)
        with evaluated_mesh(evaluated, depsgraph) as mesh:
            materials = get_materials(evaluated, mesh)
        reads = find_shader_inputs(original, materials)
        notes = (RANDOM_NOTE,) if "Random" in reads.object_info else ()
        deformed = _is_deformed(original)
        true_place = reads.uses_world_space or (reads.uses_generated and deformed)
        surface = surface or read_surface(original, depsgraph, metres_per_unit)
        data = original.data
        if deformed and not true_place:
            data = _bake_mesh(evaluated, depsgraph)
    finally:
        temporary.scene.collection.objects.unlink(original)
    if true_place:
        actor = temporary.copy_object(original)
        copy_object_inputs(actor, temporary.scene, original, home, reads)
        _match_viewport_modifiers(actor)
        temporary.evaluate(frame)
        return IsolatedObject(temporary, original, actor, rigid, metres_per_unit, stretch, notes, surface)
    actor = temporary.new_object("hnf actor", data)
    copy_object_inputs(actor, temporary.scene, original, home, reads)
    matrix = np.eye(4)
    matrix[:3, :3] = stretch
    temporary.set_world_matrix(actor, matrix)
    for slot, material in zip(actor.material_slots, materials, strict=False):
        slot.link, slot.material = "OBJECT", material
    return IsolatedObject(temporary, original, actor, np.eye(4), 1.0, stretch, notes, surface)


def _find_home_layer(obj: Any, temporary_scene: Any) -> Any:
    """The first view layer of a scene other than the stage that obj stands in, None = none."""
    scenes = (scene for scene in obj.users_scene if scene.library is None and scene != temporary_scene)
    return next((scene.view_layers[0] for scene in scenes), None)


def _is_deformed(obj: Any) -> bool:
    """Does evaluation give anything but the object's own mesh?"""
    if obj.type != "MESH":
        return True
    return bool(obj.modifiers) or obj.data.shape_keys is not None or obj.parent_type in {"ARMATURE", "LATTICE"}


def _bake_mesh(evaluated: Any, depsgraph: Any) -> Any:
    import bpy

    return bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)


def _match_viewport_modifiers(stand_in: Any) -> None:
    """Rays are cast on the viewport's mesh: let the render use the same modifiers and levels."""
    for modifier in stand_in.modifiers:
        modifier.show_render = modifier.show_viewport
        if hasattr(modifier, "render_levels"):
            modifier.render_levels = modifier.levels


@dataclass(frozen=True)
class SlotReading:
    """One material slot on the stage. material: its name, "" = none. reading: what to make of the passes. colour: where
    its colour comes from, None where it has a relief, or the same colour everywhere."""

    material: str
    reading: ShaderReading
    taps: tuple[Tap, ...]
    colour: ColourSources | None = None


def instrument_slot(isolated: IsolatedObject, slot: int, where: str) -> SlotReading:
    """Replace the material in slot by a copy with taps, unlit. Raises SceneError for a missing texture."""
    slots = isolated.stand_in.material_slots
    bare = (
        f"{where} has no material there: its feel is guessed from its name alone. Give it one, or say what it is "
        "under Feels in the Touch tab."
    )
    if slot >= len(slots) or slots[slot].material is None:
        return SlotReading("", ShaderReading(None, MicroGeometry(), (bare,)), ())
    original = slots[slot].material.original
    if not compat.use_nodes(original):
        reading = ShaderReading(read_viewport_shading(original), MicroGeometry(), ())
        return SlotReading(original.name, reading, ())
    copy = original.copy()
    graph = NodeGraph(copy)
    _prepare_textures(isolated, graph)
    _check_images(graph, f"{where}, material '{original.name}'")
    tapper = Tapper(graph, f"hnf{slot}_")
    colour = find_colour_sources(tapper)
    reading = read_shader(tapper)
    _make_unlit(copy, graph)
    slots[slot].link = "OBJECT"
    slots[slot].material = copy
    return SlotReading(original.name, reading, tuple(tapper.taps), colour)


def _make_unlit(copy: Any, graph: NodeGraph) -> None:
    """A surface that ends the path: taps are then read on the first surface met, whatever its transparency, and nothing
    is asked about light (the bits of an opaque plain surface, for a fifth less)."""
    output = graph.output
    if output is None:
        output = graph.tree.nodes.new("ShaderNodeOutputMaterial")
    end = graph.tree.nodes.new("ShaderNodeHoldout")
    for name in ("Surface", "Volume", "Displacement"):
        for link in list(output.inputs[name].links):
            graph.tree.links.remove(link)
    graph.tree.links.new(end.outputs[0], output.inputs["Surface"])
    if hasattr(copy, "displacement_method"):
        copy.displacement_method = "BUMP"


def _prepare_textures(isolated: IsolatedObject, graph: NodeGraph) -> None:
    for node in iter_nodes(graph.tree):
        if node.bl_idname == "ShaderNodeTexCoord" and node.object == isolated.original:
            node.object = None  # its own coordinates, wherever the copy stands
        if node.bl_idname == IMAGE_NODE:
            node.interpolation = "Cubic"  # bilinear normals and heights hum at the texel rate


def _check_images(graph: NodeGraph, where: str) -> None:
    """Raises SceneError naming the first image that the surface depends on and that cannot be loaded, or was painted
    and not saved: the render would show the file, and the painting would be lost."""
    output = graph.output
    if output is None:
        return
    for name in ("Surface", "Displacement"):
        for node in graph.upstream(output.inputs[name]):
            if node.bl_idname == IMAGE_NODE and node.image is not None:
                if has_unsaved_paint(node.image):
                    raise SceneError(
                        f"its texture '{node.image.name}' was painted and is not saved.",
                        where=where,
                        remedy=UNSAVED_IMAGE_REMEDY,
                    )
                problem = explain_missing_image(node.image)
                if problem is not None:
                    raise SceneError(
                        f"its texture '{node.image.name}' is not there: {problem}.",
                        where=where,
                        remedy="Bring the file back, or find it with File > External Data > Find Missing Files.",
                    )
