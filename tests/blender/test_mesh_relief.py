"""Relief modelled in the mesh is felt like the same relief as a bump; the facets of a coarse mesh are not."""

from __future__ import annotations

import json

import bmesh
import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere, bump_material
from closeup_builders import patch, plane_coordinates, render_closeup
from touch_scene import line_stroke, save_scene, signals
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.closeup import CloseUp
from hnf_blender.bridge.scene.meshes import describe_idle_modifiers
from hnf_blender.cli import main
from hnf_core.material.fuse import FROM_MESH
from hnf_core.material.token import BAND_WAVELENGTHS_M
from hnf_core.progress import count_work
from hnf_core.scene.camera import Patch
from hnf_core.signal import Signal

PASSES = {"pixels": 512, "first_pass_pixels": 128}
PLASTIC = ("--material", "Mesh=smooth-plastic", "--material", "Bump=smooth-plastic")


def add_ridges(name: str, pitch: float, height: float, faces: int = 12, *, y: float = 0.0, length: float = 0.06):
    """A strip of sine ridges along x, as many faces a wave, each as long as the strip is wide."""
    step = pitch / faces
    xs = np.arange(round(length / step) + 1) * step - length / 2.0
    points = [(x, y + side, 0.5 * height * np.sin(2.0 * np.pi * x / pitch)) for side in (-0.012, 0.012) for x in xs]
    strip = [(i, i + 1, len(xs) + i + 1, len(xs) + i) for i in range(len(xs) - 1)]
    obj = add_mesh(name, points, strip, uv=lambda co: (co.x, co.y))
    obj.data.materials.append(bpy.data.materials.new(f"{name} plastic"))
    return obj


def add_bump(name: str, pitch: float, height: float, *, y: float = 0.0, length: float = 0.06):
    """The flat strip of the same outline, its ridges a bump."""
    corners = [(x * length, y + side, 0.0) for x, side in ((-0.5, -0.012), (0.5, -0.012), (0.5, 0.012), (-0.5, 0.012))]
    obj = add_mesh(name, corners, [(0, 1, 2, 3)], uv=lambda co: (co.x, co.y))
    obj.data.materials.append(bump_material(f"{name} plastic", wavelength=pitch, height=height))
    return obj


def level_db(signal: Signal, low: float = 0.0, high: float = np.inf) -> float:
    """Power of the middle of a signal between two frequencies [dB]."""
    samples = signal.samples[len(signal.samples) // 5 : -len(signal.samples) // 5].astype(np.float64)
    power = np.abs(np.fft.rfft(samples * np.hanning(len(samples)))) ** 2
    frequency = np.fft.rfftfreq(len(samples), 1.0 / signal.sample_rate)
    return float(10.0 * np.log10(power[(frequency >= low) & (frequency <= high)].sum()))


def look_at(obj, normal=(0.0, 0.0, 1.0), distance: float = 0.0) -> CloseUp:
    """Close-up of an object from outside, centred `distance` from its origin."""
    bpy.context.view_layer.update()
    up = np.asarray(normal) / np.linalg.norm(normal)
    axis = np.cross((0.0, 1.0, 0.0), up)
    return render_closeup(obj, Patch(distance * up, axis / np.linalg.norm(axis), up, 0), **PASSES)


@pytest.mark.parametrize(("pitch", "height"), [(0.5e-3, 20e-6), (2e-3, 60e-6), (5e-3, 200e-6)])
@pytest.mark.parametrize("faces", [8, 16])
def test_ridges_of_a_mesh_are_felt_like_a_bump(tmp_path, pitch, height, faces):
    mesh = add_ridges("Mesh", pitch, height, faces)
    bump = add_bump("Bump", pitch, height, y=0.05)
    line_stroke("on mesh", length=0.04, surface=mesh)
    line_stroke("on bump", length=0.04, centre=(0.0, 0.05, 0.0), surface=bump)
    code, report = touch(save_scene(tmp_path / "ridges.blend"), tmp_path / "out", *PLASTIC)
    assert code == 0
    felt = signals(tmp_path / "out", report)
    entry = {stroke["name"]: stroke for stroke in report["strokes"]}
    assert level_db(felt["on mesh"]) == pytest.approx(level_db(felt["on bump"]), abs=1.0)
    around = (0.85 * 0.1 / pitch, 1.15 * 0.1 / pitch)
    assert level_db(felt["on mesh"], *around) == pytest.approx(level_db(felt["on bump"], *around), abs=1.0)
    band = f"{BAND_WAVELENGTHS_M[np.argmin(np.abs(np.log(BAND_WAVELENGTHS_M / pitch)))] * 1e3:g} mm"
    assert entry["on mesh"]["routes"][band] == FROM_MESH
    assert entry["on mesh"]["height_source"].startswith("mesh of 'Mesh', waves from ")
    assert entry["on mesh"]["routes"]["0.125 mm"] == "prior"
    assert FROM_MESH not in entry["on bump"]["routes"].values()


def test_a_bump_on_ridges_adds_to_them():
    obj = add_ridges("Mesh", 5e-3, 200e-6)
    obj.data.materials[0] = bump_material("Fine", wavelength=0.5e-3, height=20e-6)
    close = look_at(obj)
    x, y = plane_coordinates(close)
    middle = np.hypot(x, y) < 5e-3
    expected = 100e-6 * np.sin(2.0 * np.pi * x / 5e-3) + 10e-6 * np.sin(2.0 * np.pi * x / 0.5e-3)
    error = close.height[middle] - expected[middle]
    assert np.std(error) < 5e-6
    assert close.mesh_bands[:2] == (True, True)
    assert not any(close.mesh_bands[2:])
    assert not any(close.empty_bands)
    assert "mesh of 'Mesh'" in close.height_source
    assert "Bump" in close.height_source


@pytest.mark.parametrize("radius", [0.005, 0.01, 0.05])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("normal", [(1.0, 0.2, 0.3), (0.1, 0.0, 1.0)])
def test_facets_of_a_sphere_are_no_relief(radius, smooth, normal):
    ball = add_sphere("Ball", radius, 16, 8)
    if not smooth:
        ball.data.shade_flat()
    assert look_at(ball, normal, 0.98 * radius).height is None


@pytest.mark.parametrize(("segments", "radius"), [(64, 0.02), (256, 0.02), (256, 0.05)])
def test_a_fine_sphere_is_smooth(segments, radius):
    ball = add_sphere("Ball", radius, segments, segments // 2)
    assert look_at(ball, (1.0, 0.2, 0.3), radius).height is None


@pytest.mark.parametrize(("width", "segments"), [(2e-3, 3), (1e-3, 8), (4e-3, 16)])
def test_a_bevel_is_no_relief(width, segments):
    bpy.ops.mesh.primitive_cube_add(size=0.06)
    cube = bpy.context.object
    bevel = cube.modifiers.new("Bevel", "BEVEL")
    bevel.width, bevel.segments = width, segments
    assert look_at(cube, (0.0, 0.0, 1.0), 0.03).height is None
    edge = 0.03 * np.sqrt(2.0) - 0.41 * width
    assert look_at(cube, (1.0, 0.0, 1.0), edge).height is None


def cut_cap(obj, direction, least: float) -> None:
    """Leave the vertices of a ball whose place along a direction is `least` or more: no patch sees the others."""
    vertices = np.array([vertex.co for vertex in obj.data.vertices])
    up = np.asarray(direction) / np.linalg.norm(direction)
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    gone = [vertex for vertex, place in zip(mesh.verts, vertices @ up, strict=True) if place < least]
    bmesh.ops.delete(mesh, geom=gone, context="VERTS")
    mesh.to_mesh(obj.data)
    mesh.free()


SCANNED_FROM = (0.3, -1.0, 0.2)


def add_scan(ratio: float):
    """The near side of a ball of waves longer than 10 mm, decimated."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=7, radius=0.05)
    ball = bpy.context.object
    random = np.random.default_rng(0)
    waves = random.normal(size=(40, 3))
    waves *= 2.0 * np.pi / (np.linalg.norm(waves, axis=1) * random.uniform(0.01, 0.05, 40))[:, None]
    phase = random.uniform(0.0, 2.0 * np.pi, 40)
    points = np.array([vertex.co for vertex in ball.data.vertices])
    points *= 1.0 + 0.004 * np.sin(points @ waves.T + phase).sum(axis=1, keepdims=True) / np.sqrt(40)
    ball.data.vertices.foreach_set("co", points.astype(np.float32).ravel())
    cut_cap(ball, SCANNED_FROM, 0.025)
    ball.modifiers.new("Decimate", "DECIMATE").ratio = ratio
    return ball


@pytest.mark.parametrize("ratio", [0.3, 0.1, 0.03])
def test_facets_of_a_decimated_scan_are_no_relief(ratio):
    scan = add_scan(ratio)
    bpy.context.view_layer.update()
    evaluated = scan.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    edge = np.sqrt(4.0 / np.sqrt(3.0) * np.mean([face.area for face in evaluated.polygons]))
    close = look_at(scan, SCANNED_FROM, 0.05)
    felt = BAND_WAVELENGTHS_M[np.flatnonzero(close.mesh_bands)]
    assert (felt > 3.0 * edge).all()
    assert ratio == 0.3 or close.height is None


def add_displaced(strength: float, cuts: int = 200):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cuts, y_subdivisions=cuts, size=0.05)
    grid = bpy.context.object
    grid.data.materials.append(bpy.data.materials.new("Clay"))
    modifier = grid.modifiers.new("Displace", "DISPLACE")
    modifier.texture = bpy.data.textures.new("Clouds", "CLOUDS")
    modifier.texture.noise_scale = 3e-3
    modifier.strength = strength
    return grid


def test_what_modifiers_make_is_felt(tmp_path):
    grid = add_displaced(0.2e-3)
    name, plastic = grid.name, ("--material", f"{grid.name}=smooth-plastic")
    line_stroke("on clay", surface=grid)
    scene = save_scene(tmp_path / "clay.blend")
    _, first = touch(scene, tmp_path / "out", *plastic)
    assert FROM_MESH in first["strokes"][0]["routes"].values()
    _, again = touch(scene, tmp_path / "out", *plastic)
    assert again["strokes"][0]["fresh"]
    bpy.data.objects[name].modifiers["Displace"].strength = 0.0
    save_scene(scene)
    _, changed = touch(scene, tmp_path / "out", *plastic)
    assert not changed["strokes"][0]["fresh"]
    assert set(changed["strokes"][0]["routes"].values()) == {"prior"}
    assert changed["strokes"][0]["rms_m_s2"] < first["strokes"][0]["rms_m_s2"]


def test_subdivided_ridges_are_felt():
    ridges = add_ridges("Mesh", 4e-3, 200e-6, faces=4)
    assert not any(look_at(ridges).mesh_bands[1:])
    modifier = ridges.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = 3
    assert look_at(ridges).mesh_bands[1]


def test_a_path_over_steep_ridges_stays_on_few_patches(tmp_path):
    """Flanks of 38° would each begin a patch of their own."""
    mesh = add_ridges("Mesh", 2e-3, 0.5e-3, 20)
    line_stroke("across", length=0.04, surface=mesh)
    _, report = touch(save_scene(tmp_path / "steep.blend"), tmp_path / "out", "--material", "Mesh=smooth-plastic")
    assert report["counts"]["close_ups"] <= 4
    felt = signals(tmp_path / "out", report)["across"]
    assert level_db(felt, 40.0, 60.0) > level_db(felt) - 3.0


def test_a_broken_mesh_is_named_and_others_are_felt(tmp_path):
    good = add_ridges("Mesh", 2e-3, 60e-6)
    broken = add_ridges("Broken", 2e-3, 60e-6, y=0.1)
    broken.data.vertices[5].co.z = float("nan")
    line_stroke("fine", surface=good)
    line_stroke("lost", surface=broken, centre=(0.0, 0.1, 0.0))
    code, report = touch(save_scene(tmp_path / "nan.blend"), tmp_path / "out", "--material", "Mesh=smooth-plastic")
    assert code == 1
    assert [stroke["name"] for stroke in report["strokes"]] == ["fine"]
    (failed,) = report["failed"]
    assert "Broken" in failed["why"]
    assert "validate()" in failed["why"]
    assert "\n" not in failed["why"]


def test_faces_without_area_and_loose_fins_do_no_harm():
    clean = add_ridges("Mesh", 2e-3, 60e-6)
    expected = look_at(clean).height
    vertices = [tuple(vertex.co) for vertex in clean.data.vertices]
    faces = [tuple(face.vertices) for face in clean.data.polygons]
    start = len(vertices)
    fin = [(0.0, -0.012, -1e-3), (0.0, 0.012, -1e-3)]
    count = start // 2
    middle = (count // 2, count + count // 2)
    doubled = [faces[count // 3], (middle[0], middle[1], start + 1, start), (3, 4, 4 + 0), (7, 8, 7)]
    doubled = [face for face in doubled if len(set(face)) > 2]
    dirty = add_mesh("Dirty", vertices + fin + [vertices[3]], [*faces, *doubled, (3, start + 2, 4)])
    dirty.data.materials.append(bpy.data.materials.new("Dirty plastic"))
    close = render_closeup(dirty, patch(x=-0.024), **PASSES)
    assert any("'Dirty' has 1 face without area" in note and "Degenerate Dissolve" in note for note in close.notes)
    np.testing.assert_allclose(look_at(dirty).height, expected, atol=1e-6)


def test_a_modifier_that_fails_is_named(tmp_path):
    obj = add_ridges("Mesh", 2e-3, 60e-6)
    obj.modifiers.new("Wrap", "SHRINKWRAP")
    obj.modifiers.new("Hidden", "BOOLEAN").show_viewport = False
    displace = obj.modifiers.new("Rough", "DISPLACE")
    displace.strength = 0.0
    displace.texture = bpy.data.textures.new("Photo", "IMAGE")
    notes = describe_idle_modifiers(obj, obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    assert len(notes) == 2
    assert all("object 'Mesh'" in note and "Repair or remove it." in note for note in notes)
    assert "'Wrap'" in notes[0]
    assert "'Rough'" in notes[1]
    line_stroke("over it", surface=obj)
    code, report = touch(save_scene(tmp_path / "idle.blend"), tmp_path / "out")
    assert code == 0
    assert notes[0] in report["warnings"]


def test_nothing_is_examined_on_a_coarse_mesh():
    with count_work() as work:
        assert look_at(add_plane("Plate")).height is None
    assert work.total("mesh_reliefs") == 0
    with count_work() as work:
        assert look_at(add_ridges("Mesh", 2e-3, 60e-6)).height is not None
    assert work.total("mesh_reliefs") > 0


def add_ball(name: str, radius: float = 0.05, segments: int = 400, rings: int = 60):
    """The top of a fine UV sphere, its pole at the origin. Blender's operator takes seconds for a whole one."""
    around, down = np.arange(segments) * 2.0 * np.pi / segments, np.arange(1, rings + 1)[:, None] * np.pi / 200.0
    x, y = np.sin(down) * np.cos(around), np.sin(down) * np.sin(around)
    points = radius * np.stack([x, y, np.broadcast_to(np.cos(down) - 1.0, x.shape)], axis=-1).reshape(-1, 3)
    after = (np.arange(segments) + 1) % segments
    faces = [(0, 1 + one, 1 + other) for one, other in enumerate(after)]
    for ring in range(1, 1 + segments * (rings - 1), segments):
        faces += [(ring + i, ring + segments + i, ring + segments + j, ring + j) for i, j in enumerate(after)]
    obj = add_mesh(name, [(0.0, 0.0, 0.0), *points], faces, uv=lambda co: (co.x, co.y))
    obj.data.materials.append(bpy.data.materials.new("Ball plastic"))
    return obj


SURFACES = {
    "ridges": lambda: add_ridges("Mesh", 2e-3, 60e-6),
    "steep ridges": lambda: add_ridges("Mesh", 2e-3, 0.5e-3, 20),
    "fine ridges": lambda: add_ridges("Mesh", 0.5e-3, 20e-6, 16),
    "coarse ridges": lambda: add_ridges("Mesh", 2e-3, 60e-6, 3),
    "flat": lambda: add_ridges("Mesh", 2e-3, 0.0),
    "fine ball": lambda: add_ball("Mesh"),
    "crags": lambda: add_displaced(0.2e-3),
    "bump": lambda: add_bump("Mesh", 2e-3, 60e-6),
}


@pytest.mark.parametrize("way", ["drawn", "placed", "examined"])
@pytest.mark.parametrize("surface", SURFACES)
def test_a_plan_says_of_a_mesh_s_relief_what_the_bake_does(tmp_path, capsys, surface, way):
    obj = SURFACES[surface]()
    obj.name = "Mesh"
    words = {"drawn": (), "placed": ("--stroke", "left-right-soft", "--on", "Mesh"), "examined": ("--at", "Mesh:0,0,0")}
    if way == "drawn":
        line_stroke("Along", length=0.02, surface=obj)
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    assert main(["touch", str(scene), "--plan", "--json", *words[way]]) == 0
    plan = json.loads(capsys.readouterr().out)
    _, report = touch(scene, tmp_path / "out", *words[way])
    if way == "examined":
        slot, routes = plan["probes"][0]["slot"], report["probes"][0]["routes"].values()
    else:
        slot, routes = plan["needed"][0]["slots"][0], report["strokes"][0]["routes"].values()
    assert ("ridges of its mesh" in slot["why"]) == (FROM_MESH in routes)
    assert (slot["route"] == "measured") == (FROM_MESH in routes or "measured" in routes)
