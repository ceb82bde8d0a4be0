"""The demo scene holds what it promises: real sizes, relief in metres, strokes that lie on what they touch."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector
from touch_scene import signals
from touch_scene import touch_without_pictures as touch

from hnf_blender import compat
from hnf_blender.bridge.importers import open_scene
from hnf_blender.bridge.scene.object_size import get_size_warning
from hnf_core.actuators.profile import PROFILES

REPOSITORY = Path(__file__).parents[2]
TOOL = REPOSITORY / "tools" / "make_demo_scene.py"
WALE_M = 2.2e-3


def tool():
    spec = importlib.util.spec_from_file_location("make_demo_scene", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def demo_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "out" / "demo.blend"
    subprocess.run([sys.executable, str(TOOL), str(path)], check=True, timeout=120, cwd=path.parents[1])
    return path


@pytest.fixture
def scene(demo_file: Path):
    return open_scene(demo_file)


def strokes(scene) -> list:
    return [obj for obj in scene.objects if obj.type == "CURVE" and obj.hnf_stroke.is_stroke]


def test_only_the_file_is_left(demo_file: Path) -> None:
    assert [path.name for path in demo_file.parent.iterdir()] == ["demo.blend"]
    assert demo_file.stat().st_size < 5e6


def test_things_have_their_real_sizes(scene) -> None:
    assert scene.unit_settings.scale_length == 1.0
    for obj in scene.objects:
        if obj.type == "MESH":
            assert get_size_warning(obj, 1.0) is None
            assert tuple(obj.scale) == (1.0, 1.0, 1.0)
            if obj.name != "Table":
                assert 0.05 <= max(obj.dimensions) <= 0.26
    assert scene.camera is not None
    assert sum(obj.type == "LIGHT" for obj in scene.objects) >= 2


def test_uvs_are_metres(scene) -> None:
    """Of the touched things, a triangle's area in UV is its area on the surface, but where cloth is drawn in."""
    for name, share in (("Tile", 0.93), ("Notebook", 0.9), ("Tin", 0.4), ("Cushion", 0.4)):
        mesh = scene.objects[name].data
        mesh.calc_loop_triangles()
        uv = mesh.uv_layers.active.data
        solid, flat = [], []
        for triangle in mesh.loop_triangles:
            a, b, c = (np.array(uv[i].uv) for i in triangle.loops)
            flat.append(abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2)
            solid.append(triangle.area)
        solid, flat = np.array(solid), np.array(flat)
        good = np.abs(flat / np.maximum(solid, 1e-12) - 1.0) < 0.12
        assert solid[good].sum() / solid.sum() > share, name


def test_relief_is_physical_and_set_in_metres(scene) -> None:
    relief = {}
    for material in bpy.data.materials:
        for node in material.node_tree.nodes if material.node_tree else ():
            if node.bl_idname == "ShaderNodeBump":
                assert node.inputs["Strength"].default_value == 1.0
                assert node.inputs["Height"].is_linked
                relief.setdefault(material.name, []).append(node.inputs["Distance"].default_value)
    assert len(relief) >= 6
    assert all(5e-6 <= max(heights) <= 3e-4 + 1e-9 for heights in relief.values())
    assert "Ceramic glaze" not in relief


def test_five_strokes_with_keyed_force_and_progress(scene) -> None:
    found = {obj.name: obj for obj in strokes(scene)}
    assert len(found) == 5
    assert {spline.type for obj in found.values() for spline in obj.data.splines} == {"BEZIER", "POLY", "NURBS"}
    for obj in found.values():
        tracks = {curve.data_path: curve for curve in compat.fcurves_of(obj)}
        assert set(tracks) == {"hnf_stroke.force", "hnf_stroke.progress"}
        frames = np.arange(obj.hnf_stroke.start, obj.hnf_stroke.start + 48, 0.25)
        force = np.array([tracks["hnf_stroke.force"].evaluate(frame) for frame in frames])
        progress = np.array([tracks["hnf_stroke.progress"].evaluate(frame) for frame in frames])
        assert force.min() >= -1e-6
        assert 0.5 < force.max() < 5.0
        assert (progress.min(), progress.max()) == pytest.approx((0.0, 1.0), abs=1e-3)
        assert obj.hnf_stroke.surface is not None
    press = {curve.data_path: curve for curve in compat.fcurves_of(found["Press and lift"])}
    start = found["Press and lift"].hnf_stroke.start
    assert press["hnf_stroke.force"].evaluate(start + 24 * 1.05) == pytest.approx(0.0, abs=1e-6)
    assert press["hnf_stroke.progress"].evaluate(start + 24 * 0.2) == pytest.approx(0.0, abs=1e-6)


def test_strokes_lie_on_their_surfaces(scene) -> None:
    graph = bpy.context.evaluated_depsgraph_get()
    for obj in strokes(scene):
        surface = obj.hnf_stroke.surface
        drawn = obj.evaluated_get(graph).to_mesh()
        assert len(drawn.vertices) > 10
        inverse = surface.matrix_world.inverted()
        for vertex in drawn.vertices:
            place = inverse @ (obj.matrix_world @ vertex.co)
            found, nearest, _, _ = surface.closest_point_on_mesh(place)
            assert found
            assert (nearest - place).length < 5e-4, obj.name


def test_one_stroke_crosses_from_linen_to_leather(scene) -> None:
    obj = scene.objects["From linen to leather"]
    book = obj.hnf_stroke.surface
    knots = [knot.co for knot in obj.data.splines[0].bezier_points]
    slots = []
    for knot in knots:
        _, _, _, face = book.closest_point_on_mesh(book.matrix_world.inverted() @ Vector(knot))
        slots.append(book.material_slots[book.data.polygons[face].material_index].name)
    assert slots[0] == "Linen book cloth"
    assert slots[-1] == "Leather"


def test_one_stroke_runs_along_the_wales_and_one_across(scene) -> None:
    """Wales vary along u: of a stroke along them, u hardly changes."""
    for name, axis in (("Along the corduroy", 1), ("Across the corduroy", 0)):
        obj = scene.objects[name]
        inverse = obj.hnf_stroke.surface.matrix_world.inverted()
        ends = [inverse @ obj.data.splines[0].bezier_points[k].co for k in (0, -1)]
        moved = np.abs(np.array(ends[1] - ends[0])[:2])
        assert np.argmax(moved) == axis
        assert moved.min() < 0.15 * moved.max()


def test_building_twice_gives_the_same_scene() -> None:
    def content() -> dict:
        module.build_scene()
        meshes = {}
        for mesh in bpy.data.meshes:
            places = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", places)
            meshes[mesh.name] = places.tobytes()
        nodes = {m.name: sorted(node.name for node in m.node_tree.nodes) for m in bpy.data.materials if m.node_tree}
        return {"meshes": meshes, "nodes": nodes, "objects": sorted(obj.name for obj in bpy.data.objects)}

    module = tool()
    assert content() == content()


def test_a_close_up_of_the_cushion_measures_its_wales(scene) -> None:
    from closeup_builders import render_closeup

    from hnf_core.scene.camera import Patch

    cushion, pixels = scene.objects["Cushion"], 256
    _, place, normal, _ = cushion.closest_point_on_mesh(Vector((0.0, 0.0, 0.2)))
    across = np.cross([0.0, 1.0, 0.0], normal)
    patch = Patch(np.array(place), across / np.linalg.norm(across), np.array(normal), 0)
    height = render_closeup(cushion, patch, pixels=pixels).height
    assert height.std() == pytest.approx(0.308 * 60e-6, rel=0.1)  # |cos| over wales of 60 µm, and a little pile
    window = np.hanning(pixels)
    power = np.abs(np.fft.rfft(height * window, axis=1, n=16 * pixels)).mean(axis=0)
    per_metre = np.fft.rfftfreq(16 * pixels, patch.size_m / pixels)
    tone = per_metre[np.argmax(power * (per_metre > 200.0))]
    # The sides of the cushion are drawn in by 7.5 %, and its wales with them.
    assert 1.0 / tone == pytest.approx(0.925 * WALE_M, rel=0.02)


def test_the_default_actuator_can_play_every_stroke(demo_file: Path, tmp_path: Path) -> None:
    """With a tenth to spare, so that nothing is held back where the demo is streamed."""
    code, report = touch(demo_file, tmp_path / "out")
    assert code == 0
    strongest = PROFILES["generic-voice-coil"].limits.full_scale_m_s2
    peaks = {name: float(np.abs(signal.samples).max()) for name, signal in signals(tmp_path / "out", report).items()}
    assert len(peaks) == 5
    assert all(1.0 < peak < 0.9 * strongest for peak in peaks.values()), peaks
