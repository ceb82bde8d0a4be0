"""Test scenes of the Blender benches, and the Touch tab drawn without a window.

Scenes have any number of objects, faces, materials or strokes, and one plate that is touched. `draw_tab` calls every
panel's poll and draw with a fake layout, as Blender does.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from hnf_core.errors import HnfError


def require_bpy(name: str) -> None:
    """Raise HnfError if this Python has no bpy."""
    if importlib.util.find_spec("bpy") is None:
        raise HnfError(
            f"the bench '{name}' needs Blender, and this Python has no bpy.",
            remedy="Install it: pip install -e '.[scene]' (Python 3.11).",
        )


PLATE_CUTS, QUICK_PLATE_CUTS = 316, 8
"""Faces along each side of the plate: 99,856 faces in all, or 64."""
LARGE_PLATE_M = 0.2
STROKE_COUNT = 3


@contextmanager
def open_test_file() -> Iterator[tuple[Any, Any]]:
    """Yield scene and view layer of an empty file with the add-on's properties and a separate cache."""
    import bpy

    from hnf_blender import props
    from hnf_blender.jobs import bake_job, manager
    from hnf_blender.jobs.manager import is_preloaded
    from hnf_blender.state.session_state import STATE
    from hnf_blender.state.status_tracker import clear_trackers

    while not is_preloaded():
        time.sleep(0.01)
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder, patch.object(bake_job, "get_cache_folder", lambda: Path(folder)):
        try:
            yield bpy.context.scene, bpy.context.view_layer
        finally:
            manager.close()
            clear_trackers()
            STATE.clear()


def add_plate_with_strokes(cuts: int) -> Any:
    """Add a plate of cuts × cuts faces with strokes on it, and one more stroke to be edited."""
    import bpy

    plate = add_plate("Plate", cuts)
    for name in (*list_stroke_names(), "Beside"):
        add_crossing_stroke(plate, name, turned=0.4 * len(name))
    bpy.context.view_layer.update()
    return plate


def add_plate(name: str, cuts: int) -> Any:
    """Add a plate of cuts × cuts faces to the scene."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    side = np.linspace(-LARGE_PLATE_M / 2.0, LARGE_PLATE_M / 2.0, cuts + 1)
    x, y = np.meshgrid(side, side)
    corner = (np.arange(cuts)[:, None] * (cuts + 1) + np.arange(cuts)).reshape(-1, 1)
    mesh.from_pydata(
        np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3), [], corner + np.array([0, 1, cuts + 2, cuts + 1])
    )
    plate = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(plate)
    return plate


def list_stroke_names() -> tuple[str, ...]:
    return tuple(f"Stroke {'i' * (k + 1)}" for k in range(STROKE_COUNT))


def add_crossing_stroke(plate: Any, name: str, turned: float) -> Any:
    """Add a stroke of 60 mm through the middle of the plate at 100 mm/s."""
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-0.03, 0.03), strict=True):
        point.co = (side * np.cos(turned), side * np.sin(turned), 0.0, 1.0)
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    group = obj.hnf_stroke
    group.is_stroke, group.surface, group.start, group.force = True, plate, 1.0, 1.0
    return obj


PLATE_NAME, PLATE_M = "Plate", 0.12
CROWD_CUTS, CROWD_PITCH_M, CROWD_AWAY_M, CROWD_ROW = 10, 0.2, 1.0, 100
"""Other objects: faces along a side, spacing and distance from the plate [m], and number per row."""
STROKE_PITCH_M = 0.05
RIM_M = 0.03
"""Spacing of separate strokes, and distance from the middle beyond which slots are not touched [m]."""


def open_empty_file() -> Any:
    """Open a new file with the stroke properties registered, and return its scene."""
    import bpy

    from hnf_blender import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def save_file(path: Path) -> None:
    """Save the open file."""
    import bpy

    from hnf_blender.bridge.scene.temp_scene import suppress_output

    bpy.context.view_layer.update()
    with suppress_output():
        bpy.ops.wm.save_as_mainfile(filepath=str(path))


def add_relief_plate(cuts: int, size_m: float = PLATE_M, slots: int = 1) -> Any:
    """Add a square of cuts × cuts faces with a relief in its shader. Other slots cover its rim."""
    obj = _add_object(PLATE_NAME, _make_grid(PLATE_NAME, cuts, size_m))
    for slot in range(slots):
        obj.data.materials.append(make_relief_material(f"Relief {slot}", 60.0 + 240.0 * slot / slots))
    if slots > 1:
        y = np.abs((np.arange(cuts) + 0.5) / cuts - 0.5) * size_m
        index = np.where(np.repeat(y, cuts) < RIM_M, 0, np.arange(cuts * cuts) % slots).astype(np.int32)
        obj.data.polygons.foreach_set("material_index", index)
    obj.data.update()
    return obj


def add_crowd(count: int, own_meshes: bool) -> None:
    """Add plates of 100 faces without a material, none within reach of the plate."""
    mesh = _make_grid("Crowd", CROWD_CUTS, PLATE_M)
    for number in range(count):
        other = _add_object(f"Crowd {number}", mesh.copy() if own_meshes else mesh)
        row, column = divmod(number, CROWD_ROW)
        other.location = (CROWD_AWAY_M + CROWD_PITCH_M * column, CROWD_PITCH_M * row, 0.0)


def add_strokes(count: int, surface: Any, apart: bool, length_m: float) -> None:
    """Add strokes at 100 mm/s, at separate positions if `apart`, else all at one, each with its own seed."""
    across = int(np.ceil(np.sqrt(count)))
    for number in range(count):
        row, column = divmod(number, across) if apart else (0, 0)
        middle = STROKE_PITCH_M * (np.array([column, row]) - (across - 1 if apart else 0) / 2.0)
        _add_stroke(f"Stroke {number}", surface, middle, length_m, seed=number)


def make_relief_material(name: str, scale: float) -> Any:
    """Make a material with a noise bump."""
    import bpy

    from hnf_blender import compat

    material = bpy.data.materials.new(name)
    compat.switch_nodes_on(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    noise, bump = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeBump")
    noise.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = scale, 1e-4
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def set_image_relief(obj: Any, texels: int, seed: int) -> None:
    """Use an image of texels × texels over the complete object as its bump."""
    import bpy

    pixels = np.ones((texels, texels, 4), dtype=np.float32)
    pixels[..., :3] = np.random.default_rng(seed).uniform(0.2, 0.8, (texels, texels, 1))
    image = bpy.data.images.new("Relief", texels, texels, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    tree = obj.data.materials[0].node_tree
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    texture, coordinates = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeTexCoord")
    texture.image = image
    tree.links.new(coordinates.outputs["Generated"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], bump.inputs["Height"])


def _make_grid(name: str, cuts: int, size_m: float) -> Any:
    """Make a grid mesh from arrays, as ten million faces would be too slow in Python."""
    import bpy

    side = np.linspace(-size_m / 2.0, size_m / 2.0, cuts + 1, dtype=np.float32)
    x, y = np.meshgrid(side, side)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corner = (np.arange(cuts, dtype=np.int32)[:, None] * (cuts + 1) + np.arange(cuts, dtype=np.int32)).reshape(-1, 1)
    corners = corner + np.array([0, 1, cuts + 2, cuts + 1], dtype=np.int32)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(points.size // 3)
    mesh.loops.add(corners.size)
    mesh.polygons.add(len(corners))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.foreach_set("vertex_index", corners.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _add_object(name: str, data: Any) -> Any:
    import bpy

    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _add_stroke(name: str, surface: Any, middle: np.ndarray[Any, Any], length_m: float, seed: int) -> None:
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-length_m / 2.0, length_m / 2.0), strict=True):
        point.co = (middle[0] + side, middle[1], 0.0, 1.0)
    group = _add_object(name, curve).hnf_stroke
    group.is_stroke, group.surface, group.start, group.force, group.seed = True, surface, 1.0, 1.0, seed


SIDEBAR_PX = 340
VISIBLE_ROWS = 5
"""Visible rows of the list of strokes."""


class FakeLayout:
    """A UILayout, or the properties of a button, that accepts every call and stores nothing."""

    def __getattr__(self, _name: str) -> Any:
        return self._accept

    def __setattr__(self, _name: str, _value: Any) -> None:
        """Ignore the value."""

    def _accept(self, *_values: Any, **_named: Any) -> FakeLayout:
        return self


@contextmanager
def register_tab() -> Iterator[None]:
    """Register the tab's buttons and panels, as in a window, with change notification on.

    Their poll() functions refer to each other. The caller passes Blender's notifications to note_changes().
    """
    import bpy

    from hnf_blender import ops, ui
    from hnf_blender.props.object_cache import CHANGES

    modules = () if hasattr(bpy.types, "HNF_PT_preview") else (ops, ui)
    for module in modules:
        module.register()
    was_notified, CHANGES.is_notified = CHANGES.is_notified, True
    try:
        yield
    finally:
        CHANGES.is_notified = was_notified
        CHANGES.mark_changed()
        for module in reversed(modules):
            module.unregister()


def draw_tab(scene: Any, layer: Any) -> int:
    """Draw the tab as on a redraw of the sidebar with every panel open; return the number of panels drawn."""
    import bpy

    from hnf_blender.props.scene_settings import list_cached_strokes
    from hnf_blender.registration import collect_classes
    from hnf_blender.ui import MODULES
    from hnf_blender.ui.strokes_panel import HNF_UL_strokes

    context, layout = make_tab_context(scene, layer, SIDEBAR_PX), FakeLayout()
    panels = [
        panel
        for panel in collect_classes("hnf_blender.ui", MODULES)
        if issubclass(panel, bpy.types.Panel) and (not hasattr(panel, "poll") or panel.poll(context))
    ]
    for panel in panels:
        for name in ("draw_header", "draw"):
            if hasattr(panel, name):
                getattr(panel, name)(SimpleNamespace(layout=layout, bl_rna=panel.bl_rna), context)
    listed: Any = SimpleNamespace(filter_name="", order="SURFACE", bitflag_filter_item=1)
    HNF_UL_strokes.filter_items(listed, context, scene, "objects")
    for index, obj in enumerate(list_cached_strokes(scene)[:VISIBLE_ROWS]):
        HNF_UL_strokes.draw_item(listed, context, layout, scene, obj, 0, scene.hnf, "stroke_index", index)
    return len(panels)


def make_tab_context(scene: Any, layer: Any, width_px: int) -> Any:
    """Return the context of a panel in a region of this width, as bpy.context has none without a window."""
    import bpy

    context = bpy.context
    return SimpleNamespace(
        scene=scene,
        view_layer=layer,
        window_manager=context.window_manager,
        workspace=context.workspace,
        screen=context.screen,
        window=context.window,
        area=None,
        mode=context.mode,
        object=layer.objects.active,
        active_object=layer.objects.active,
        selected_objects=list(layer.objects.selected),
        region=SimpleNamespace(width=width_px),
        preferences=SimpleNamespace(addons=context.preferences.addons, system=SimpleNamespace(ui_scale=1.0)),
    )
