"""Put the touched object alone into a temporary scene, with material copies that output shader values as AOV passes.

The object stands at the origin, in meters, so that its place in the world cannot change the render; it keeps its true
place only if its shaders depend on it. Its close-up has as many pixels as show what a material's images and a mesh's
faces hold, and no more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError
from hnf_core.tactile.mesh_relief import FaceSpacing

from .. import compat
from .cycles import MAX_READABLE_WAVELENGTH_M
from .scene.meshes import Surface, compute_surface_frame, evaluated_mesh, flush_edits, get_materials, read_surface
from .scene.temp_scene import TemporaryScene
from .shader.aov_taps import IMAGE_NODE, Constant, Passes, Tap, Tapper, find_finest_texel
from .shader.bump_displacement import MicroGeometry, Relief, Slopes
from .shader.closures import (
    ColourSources,
    ShaderReading,
    find_colour_sources,
    list_closures,
    list_mix_factors,
    read_shader,
    read_viewport_shading,
)
from .shader.images import (
    UNSAVED_IMAGE_REMEDY,
    copy_as_data,
    explain_missing_image,
    get_missing_remedy,
    has_unsaved_paint,
)
from .shader.node_graph import NodeGraph, iter_nodes
from .shader.object_inputs import copy_object_inputs, find_shader_inputs

Float = NDArray[np.float64]

RANDOM_NOTE = "Object Info's Random cannot be repeated in a close-up: its pattern may differ."
"""Note for the user if a shader reads Object Info's Random."""


@dataclass(frozen=True)
class IsolatedObject:
    """The touched object, alone in a temporary scene.

    Attributes
    ----------
    temporary : TemporaryScene
    original, stand_in : bpy.types.Object
        The user's object, and its copy that is rendered.
    rigid : (4, 4) array
        Temporary scene's world [m] ← surface frame (the object's own frame with its scale applied, in meters).
    metres_per_unit : float
        Unit of the temporary scene [m].
    stretch : (3, 3) array
        Surface frame [m] ← object space: scale, shear and unit.
    notes : tuple of str
        Remarks for the user.
    surface : Surface
        Surface of exactly the mesh that is rendered.
    """

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
    """Copy an object into a temporary scene, without rotation and translation, in meters.

    If its shaders read world coordinates, it keeps its place in the world.

    Parameters
    ----------
    temporary : TemporaryScene
        Scene to put it into.
    obj : bpy.types.Object
        Object to copy.
    metres_per_unit : float
        Length of a Blender unit in the user's scene [m].
    frame : float or None
        Scene frame; None is the current one.
    surface : Surface, optional
        Surface of `obj` at `frame`, if known.
    view_layer : bpy.types.ViewLayer, optional
        View layer of the scene in which `obj` is touched; by default that of the first scene it is in.

    Returns
    -------
    IsolatedObject

    Raises
    ------
    SceneError
        If the object has no surface.
    """
    original = obj.original
    where = f"object '{original.name}'"
    flush_edits(original)
    home_layer = view_layer or _find_home_layer(original, temporary.scene)
    if frame is None and home_layer is not None:
        frame = float(home_layer.id_data.frame_current_final)
    temporary.link(original)
    try:
        depsgraph = temporary.evaluate(frame)
        evaluated = original.evaluated_get(depsgraph)
        rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, where)
        with evaluated_mesh(evaluated, depsgraph) as mesh:
            materials = get_materials(evaluated, mesh)
        inputs = find_shader_inputs(original, materials)
        notes = (RANDOM_NOTE,) if "Random" in inputs.object_info else ()
        deformed = _is_deformed(original)
        keep_placement = inputs.uses_world_space or (inputs.uses_generated and deformed)
        surface = surface or read_surface(original, depsgraph, metres_per_unit)
        data = original.data
        if deformed and not keep_placement:
            data = _bake_mesh(evaluated, depsgraph)
    finally:
        temporary.scene.collection.objects.unlink(original)
    if keep_placement:
        stand_in = temporary.copy_object(original)
        copy_object_inputs(stand_in, temporary.scene, original, home_layer, inputs)
        _match_viewport_modifiers(stand_in)
        temporary.evaluate(frame)
        return IsolatedObject(temporary, original, stand_in, rigid, metres_per_unit, stretch, notes, surface)
    stand_in = temporary.new_object("hnf actor", data)
    copy_object_inputs(stand_in, temporary.scene, original, home_layer, inputs)
    matrix = np.eye(4)
    matrix[:3, :3] = stretch
    temporary.set_world_matrix(stand_in, matrix)
    for slot, material in zip(stand_in.material_slots, materials, strict=False):
        slot.link, slot.material = "OBJECT", material
    return IsolatedObject(temporary, original, stand_in, np.eye(4), 1.0, stretch, notes, surface)


def _find_home_layer(obj: Any, temporary_scene: Any) -> Any:
    """Return the first view layer of a local scene, other than the temporary one, that contains `obj`, or None."""
    scenes = (scene for scene in obj.users_scene if scene.library is None and scene != temporary_scene)
    return next((scene.view_layers[0] for scene in scenes), None)


def _is_deformed(obj: Any) -> bool:
    """Return True if the evaluated mesh may differ from the object's own."""
    if obj.type != "MESH":
        return True
    return bool(obj.modifiers) or obj.data.shape_keys is not None or obj.parent_type in {"ARMATURE", "LATTICE"}


def _bake_mesh(evaluated: Any, depsgraph: Any) -> Any:
    """Return an evaluated mesh, with modifiers applied, as a new datablock."""
    import bpy

    return bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)


def _match_viewport_modifiers(stand_in: Any) -> None:
    """Let the render use the viewport's modifiers and subdivision levels, as rays are cast on the viewport's mesh."""
    for modifier in stand_in.modifiers:
        modifier.show_render = modifier.show_viewport
        if hasattr(modifier, "render_levels"):
            modifier.render_levels = modifier.levels


@dataclass(frozen=True)
class SlotReading:
    """A material slot whose shader values are rendered as AOV passes (taps).

    Attributes
    ----------
    material : str
        Name of the material, "" for none.
    reading : ShaderReading
        Mixed closures (BSDFs) and displacement, whose values are taps or constants.
    taps : tuple of Tap
        AOV passes to render.
    colour : ColourSources or None
        Images, patterns and vertex colors behind its color; None if it has a relief or a uniform color.
    is_incomplete : bool
        True if a texture is missing and was left out.
    """

    material: str
    reading: ShaderReading
    taps: tuple[Tap, ...]
    colour: ColourSources | None = None
    is_incomplete: bool = False


def instrument_slot(isolated: IsolatedObject, slot: int, where: str, *, is_chosen: bool = False) -> SlotReading:
    """Replace the material in a slot by an unlit copy that outputs its shader values as AOVs.

    `where` names the object and material in errors. Raises SceneError for a missing texture that is needed: one of the
    relief, or of the color if there is no relief; none is if the user chose the slot's haptic material (`is_chosen`).
    """
    slots = isolated.stand_in.material_slots
    no_material_note = (
        f"{where} has no material there: its feel is guessed from its name alone. Give it one, or say what it is "
        "under Feels in the Touch tab."
    )
    if slot >= len(slots) or slots[slot].material is None:
        return SlotReading("", ShaderReading(None, MicroGeometry(), (no_material_note,)), ())
    original = slots[slot].material.original
    if not compat.use_nodes(original):
        reading = ShaderReading(read_viewport_shading(original), MicroGeometry(), ())
        return SlotReading(original.name, reading, ())
    copy = original.copy()
    graph = NodeGraph(copy)
    _prepare_textures(isolated, graph)
    relief_images, other_images = _find_image_uses(graph)
    missing_notes = _leave_out_missing(graph, f"{where}, material '{original.name}'", relief_images, is_chosen)
    notes = (*missing_notes, *_read_as_data(relief_images, other_images))
    if graph.output is None:
        notes = (
            f"{where}, material '{original.name}': its shader is empty, so that its name alone decides. Blender "
            "imports no MaterialX: export a UsdPreviewSurface with it, or say what it is under Feels in the Touch tab.",
        )
    tapper = Tapper(graph, f"hnf{slot}_")
    colour = find_colour_sources(tapper)
    reading = read_shader(tapper)
    reading = replace(reading, notes=(*notes, *reading.notes))
    _make_unlit(copy, graph)
    slots[slot].link = "OBJECT"
    slots[slot].material = copy
    return SlotReading(original.name, reading, tuple(tapper.taps), colour, bool(missing_notes))


def _make_unlit(copy: Any, graph: NodeGraph) -> None:
    """Replace the surface shader by a Holdout, so that AOVs are read at the first hit, whatever its transparency.

    No lighting is computed; the AOVs equal those of an opaque surface, a fifth faster.
    """
    output = graph.output
    if output is None:
        output = graph.tree.nodes.new("ShaderNodeOutputMaterial")
    holdout = graph.tree.nodes.new("ShaderNodeHoldout")
    for name in ("Surface", "Volume", "Displacement"):
        for link in list(output.inputs[name].links):
            graph.tree.links.remove(link)
    graph.tree.links.new(holdout.outputs[0], output.inputs["Surface"])
    if hasattr(copy, "displacement_method"):
        copy.displacement_method = "BUMP"


def _prepare_textures(isolated: IsolatedObject, graph: NodeGraph) -> None:
    """Let textures use the coordinates of the rendered copy instead of the original object, and cubic interpolation."""
    for node in iter_nodes(graph.tree):
        if node.bl_idname == "ShaderNodeTexCoord" and node.object == isolated.original:
            node.object = None  # use the copy's own coordinates
        if node.bl_idname == IMAGE_NODE:
            node.interpolation = "Cubic"  # bilinear interpolation leaves a pattern at the texel rate


RELIEF_INPUTS = {
    "ShaderNodeBump": "Height", "ShaderNodeDisplacement": "Height", "ShaderNodeNormalMap": "Color",
    "ShaderNodeVectorDisplacement": "Vector",
}  # fmt: skip
"""Nodes that make a relief of a picture → their input for it."""
NodeKey = tuple[str, str]


def _get_key(node: Any) -> NodeKey:
    return node.id_data.name_full, node.name


def _find_image_uses(graph: NodeGraph) -> tuple[dict[NodeKey, Any], set[NodeKey]]:
    """Return the image nodes that a relief is made from, and the keys of those that anything else is made from."""
    relief: dict[NodeKey, Any] = {}
    other: set[NodeKey] = set()
    if graph.output is None:
        return relief, other
    reached = {
        _get_key(node): node for name in ("Surface", "Displacement")
        for node in graph.upstream(graph.output.inputs[name])
    }  # fmt: skip
    for node in reached.values():
        if node.bl_idname in RELIEF_INPUTS:
            sources = list(graph.upstream(node.inputs[RELIEF_INPUTS[node.bl_idname]]))
            relief |= {_get_key(source): source for source in sources if source.bl_idname == IMAGE_NODE}
        elif any(output.type == "SHADER" for output in node.outputs):
            sockets = (socket for socket in node.inputs if socket.type != "SHADER")
            sources = [each for socket in sockets for each in graph.upstream(socket, frozenset(RELIEF_INPUTS))]
            other |= {_get_key(source) for source in sources}
    return relief, other


def _find_color_images(graph: NodeGraph) -> set[NodeKey]:
    """Return the keys of the nodes that the color of a shader or the mix of two is made from.

    Not those of gloss, emission and the other inputs of a shader that has a base color.
    """
    keys: set[NodeKey] = set()
    for node in graph.upstream(graph.output.inputs["Surface"]):
        if any(output.type == "SHADER" for output in node.outputs):
            base = node.inputs.get("Base Color")
            sockets = [socket for socket in node.inputs if socket.type != "SHADER"] if base is None else [base]
            sources = [each for socket in sockets for each in graph.upstream(socket, frozenset(RELIEF_INPUTS))]
            keys |= {_get_key(source) for source in sources}
    return keys


def _read_as_data(relief_images: dict[NodeKey, Any], other_images: set[NodeKey]) -> list[str]:
    """Let pictures of normals and heights that are tagged as colors be read as data; return notes on them.

    A picture that is also seen as a color keeps its tag: its maker meant it as one.
    """
    notes = []
    for key, node in relief_images.items():
        image = node.image
        if key in other_images or image is None or image.colorspace_settings.is_data or image.is_float:
            continue
        copy = copy_as_data(image)
        if copy is not None:
            notes.append(
                f"picture '{image.name}' gives a relief and is tagged {image.colorspace_settings.name}: it is read as "
                "data. Set its Color Space to Non-Color, so that renders show it too."
            )
            node.image = copy
    return notes


def _leave_out_missing(graph: NodeGraph, where: str, relief_images: dict[NodeKey, Any], is_chosen: bool) -> list[str]:
    """Disconnect images that cannot be loaded and are not needed; return notes on them.

    Raises SceneError for the first that is needed, or has unsaved paint, which the render would miss in the file.
    """
    if graph.output is None:
        return []
    upstream = (
        node for name in ("Surface", "Displacement") for node in graph.upstream(graph.output.inputs[name])
        if node.bl_idname == IMAGE_NODE and node.image is not None
    )  # fmt: skip
    nodes = {_get_key(node): node for node in upstream}
    for node in nodes.values():
        if has_unsaved_paint(node.image):
            raise SceneError(
                f"its texture '{node.image.name}' was painted and is not saved.",
                where=where,
                remedy=UNSAVED_IMAGE_REMEDY,
            )
    problems = {key: problem for key, node in nodes.items() if (problem := explain_missing_image(node.image))}
    has_relief = bool(relief_images.keys() - problems.keys())
    color_images = _find_color_images(graph) if problems else set()
    notes = []
    for key, problem in problems.items():
        node, kind = nodes[key], "relief" if key in relief_images else "color" if key in color_images else "finish"
        if not is_chosen and (kind == "relief" or (kind == "color" and not has_relief)):
            raise SceneError(
                f"its texture '{node.image.name}' is not there: {problem}.",
                where=where,
                remedy=get_missing_remedy(node.image),
            )
        for link in [link for output in node.outputs for link in output.links]:
            node.id_data.links.remove(link)
        notes.append(
            f"{where}: its texture '{node.image.name}' is not there ({problem}), so that its {kind} is unknown."
        )
    return notes


Mask = NDArray[np.bool_]

PIXELS_PER_MESH_WAVE = 4.0
"""Pixels per shortest wave that the faces under a patch hold."""
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


def choose_mesh_side(side: int, size_m: float, spacing: FaceSpacing) -> int:
    """Return the image side [pixels], at least `side`, that shows the shortest waves that the faces hold."""
    while size_m / side > spacing.shortest_m / PIXELS_PER_MESH_WAVE:
        side *= 2
    return side
