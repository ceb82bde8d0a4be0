"""Operators and drops for reconstructions: import, real length, and drawing over splats."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from builders import add_plane
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mathutils import Vector
from panel_recorder import drawn
from splat_builders import slab, slab_file
from touch_scene import place_data

from hnf_blender.bridge import splat_reconstruction
from hnf_blender.bridge.scene.object_size import compute_metric_scale
from hnf_blender.bridge.splat_cloud import get_cloud, is_cloud, read_cloud
from hnf_blender.bridge.splat_reconstruction import TouchSurface
from hnf_blender.bridge.viewport_pick import cast_on_surface, pick_object_along_ray
from hnf_blender.ops.import_ops import SplatReader
from hnf_blender.ui.scene_panel import HNF_PT_scale
from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ignore_progress
from hnf_core.scene.splats.splat_file import open_splat_file, read_splats
from reference.splat_layouts import WRITERS, get_suffix, write_sog

pytestmark = pytest.mark.usefixtures("operators")

SQUARE = TouchSurface(
    np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32),
    np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
    np.full((4, 3), 0.25, dtype=np.float32),
    ("It is full of holes.",),
)


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Every file's surface is a square, made at once."""
    quality = SimpleNamespace(warnings=SQUARE.warnings)
    made = SimpleNamespace(vertices=SQUARE.vertices, triangles=SQUARE.triangles, colour=SQUARE.colour, quality=quality)

    def reconstruct(_splats, *, progress, **_named):
        for share in np.linspace(0.0, 1.0, 5):
            progress(Progress("looking", 0, 1, float(share)))
            if progress is not ignore_progress:
                time.sleep(0.01)
        return made

    monkeypatch.setattr(splat_reconstruction, "reconstruct_surface", reconstruct)
    place_data(monkeypatch, tmp_path / "data")


@pytest.fixture
def imported(quick, tmp_path: Path):
    assert bpy.ops.hnf.import_splats(filepath=str(slab_file(tmp_path, "slab.compressed.ply"))) == {"FINISHED"}
    return bpy.data.objects["slab"]


def test_a_dropped_file_is_added_to_what_is_open(quick, tmp_path: Path) -> None:
    add_plane("Table")
    assert bpy.ops.hnf.import_splats(filepath=str(slab_file(tmp_path))) == {"FINISHED"}
    surface = bpy.context.view_layer.objects.active
    assert (surface.name, len(surface.data.polygons)) == ("slab", 2)
    assert "Table" in bpy.context.scene.objects
    assert read_cloud(get_cloud(surface)).means.tobytes() == slab().means.tobytes()
    (material,) = surface.data.materials
    assert material.name == "slab"
    colours = surface.data.color_attributes[0]
    assert colours.data[0].color[:] == pytest.approx((0.25, 0.25, 0.25, 1.0))
    assert surface["hnf_splats_notes"] == "object 'slab': It is full of holes."
    assert (np.array(surface.matrix_world) == np.eye(4)).all()  # the file says that z is up


def test_up_is_turned_to_z(quick, tmp_path: Path) -> None:
    from data_tools.write_splats import write_inria

    for number, (comment, up) in enumerate({"": (0, -1, 0), "Vertical Axis: -z": (0, 0, -1)}.items()):
        path = tmp_path / f"s{number}.ply"
        write_inria(path, slab(), comments=(comment,) if comment else ())
        bpy.ops.hnf.import_splats(filepath=str(path))
        surface = bpy.context.view_layer.objects.active
        bpy.context.view_layer.update()
        assert (surface.matrix_world.to_3x3() @ Vector(up))[:] == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)


@pytest.mark.parametrize("damage", ["cut", "missing", "mesh", "glb mesh", "spz"])
def test_what_cannot_be_imported_adds_nothing_and_says_why(quick, tmp_path: Path, damage: str) -> None:
    path = slab_file(tmp_path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "mesh":
        path.write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    elif damage == "glb mesh":
        path.write_text('{"asset": {"version": "2.0"}}')
    elif damage == "missing":
        path.unlink()
    else:
        path = path.with_suffix(".spz")
        path.write_bytes(b"NGSP" + bytes(30))
    said = {"cut": "splats are there", "missing": "No such file", "mesh": "Stanford PLY", "glb mesh": "glTF 2.0"}
    with pytest.raises(RuntimeError, match=said.get(damage, "version 0; versions 2, 3, 4 are read")) as caught:
        bpy.ops.hnf.import_splats(filepath=str(path))
    assert str(path) in str(caught.value)
    assert len(bpy.data.objects) == len(bpy.data.meshes) == 0


@pytest.mark.parametrize("layout", WRITERS)
def test_every_layout_is_imported_and_upright(quick, tmp_path: Path, layout: str) -> None:
    """Its splats are those that the core reads, pictures of a .sog by Blender here and by Pillow there."""
    part = slab().take(np.arange(0, len(slab()), 61))
    path = WRITERS[layout](tmp_path / f"part{get_suffix(layout)}", part)
    assert bpy.ops.hnf.import_splats(filepath=str(path)) == {"FINISHED"}
    surface = bpy.context.view_layer.objects.active
    assert surface.name == "part"
    found, expected = read_cloud(get_cloud(surface)), read_splats(path)
    for field in ("means", "scales", "opacities", "harmonics"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
    bpy.context.view_layer.update()
    up = Vector(open_splat_file(path).up.direction)
    assert (surface.matrix_world.to_3x3() @ up)[:] == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert not bpy.data.images


def test_a_damaged_picture_is_named(quick, tmp_path: Path) -> None:
    path = write_sog(tmp_path / "meta.json", slab().take(np.arange(40)))
    whole = (tmp_path / "quats.webp").read_bytes()
    for damage in (b"", b"RIFF", whole[: len(whole) // 2]):
        (tmp_path / "quats.webp").write_bytes(damage)
        with pytest.raises(RuntimeError, match=r"picture 'quats\.webp' cannot be read"):
            bpy.ops.hnf.import_splats(filepath=str(path))
    assert not bpy.data.images


def test_a_reader_in_a_thread_has_the_pictures_of_a_sog(quick, tmp_path: Path) -> None:
    reading = SplatReader(write_sog(tmp_path / "a.sog", slab().take(np.arange(40))), tmp_path / "cache")
    wait(reading)
    assert reading.error is None
    assert len(reading.result.splats) == 40
    reading = SplatReader(tmp_path / "gone.sog", tmp_path / "cache")
    assert reading.is_done
    assert "No such file" in str(reading.error)


def test_no_import_in_edit_mode() -> None:
    add_plane("Table")
    bpy.context.view_layer.objects.active = bpy.data.objects["Table"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.hnf.import_splats.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.hnf.import_splats.poll()


def wait(reading: SplatReader) -> None:
    for _ in range(500):
        if reading.is_done:
            return
        time.sleep(0.01)
    raise AssertionError("it did not end")


def test_a_splat_reader_thread_reports_progress_and_stops(quick, tmp_path: Path) -> None:
    path = slab_file(tmp_path)
    reading = SplatReader(path, tmp_path / "cache")
    wait(reading)
    assert reading.error is None
    assert reading.result is not None
    assert (reading.result.name, reading.share) == ("slab", 1.0)
    stopped = SplatReader(slab_file(tmp_path, "other.ply", degree=1), tmp_path / "cache")
    stopped.stop()
    wait(stopped)
    assert (stopped.result, stopped.error) == (None, None)
    path.write_bytes(b"ply\n")
    broken = SplatReader(path, tmp_path / "cache")
    wait(broken)
    assert str(path) in str(broken.error)


def choose(*names: str) -> None:
    for obj in bpy.context.scene.objects:
        obj.select_set(obj.name in names)


def test_two_selected_objects_and_their_distance_set_the_scale() -> None:
    for name, place in (("A", (1.0, 0.0, 0.0)), ("B", (1.0, 4.0, 3.0)), ("C", (0.0, 0.0, 0.0))):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, None))
        bpy.data.objects[name].location = place
    bpy.context.view_layer.update()
    choose("A", "B", "C")
    assert not bpy.ops.hnf.set_real_length.poll()
    choose("A", "B")
    assert bpy.ops.hnf.set_real_length(length_m=0.5) == {"FINISHED"}
    assert bpy.context.scene.hnf.metres_per_unit == pytest.approx(0.1)
    bpy.data.objects["B"].location = (1.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="lie in one place"):
        bpy.ops.hnf.set_real_length(length_m=0.5)
    bpy.data.objects["B"].location = (1.0, 1e-5, 0.0)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match=r"a unit would be 1e\+08 m"):
        bpy.ops.hnf.set_real_length(length_m=1000.0)
    assert bpy.context.scene.hnf.metres_per_unit == pytest.approx(0.1)


def test_two_clicked_points_set_the_scale() -> None:
    """As the dialog after two clicks gives them; what is selected does not count then."""
    bpy.ops.mesh.primitive_plane_add()
    add_empties_apart(5.0)
    given = {"first": (0.0, 0.0, 0.0), "second": (0.3, 0.4, 0.0)}
    assert bpy.ops.hnf.set_real_length(length_m=0.25, **given) == {"FINISHED"}
    assert bpy.context.scene.hnf.metres_per_unit == pytest.approx(0.5)
    with pytest.raises(RuntimeError, match="lie in one place"):
        bpy.ops.hnf.set_real_length(length_m=0.25, first=(1.0, 0.0, 0.0), second=(1.0, 0.0, 0.0))


def add_empties_apart(units: float) -> None:
    for name, x in (("A", 0.0), ("B", units)):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, None))
        bpy.data.objects[name].location.x = x
    bpy.context.view_layer.update()
    choose("A", "B")


def test_two_selected_vertices_set_the_scale_in_the_world() -> None:
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    plane.scale = (3.0, 3.0, 3.0)
    bpy.context.view_layer.update()
    corners = np.array([vertex.co for vertex in plane.data.vertices])
    first, second = 0, int(np.argmax(np.linalg.norm(corners - corners[0], axis=1)))
    plane.data.vertices.foreach_set("select", [index in (first, second) for index in range(len(corners))])
    plane.data.edges.foreach_set("select", [False] * len(plane.data.edges))
    plane.data.polygons.foreach_set("select", [False] * len(plane.data.polygons))
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert bpy.ops.hnf.set_real_length.poll()
        assert bpy.ops.hnf.set_real_length(length_m=1.2) == {"FINISHED"}
        bpy.ops.mesh.select_all(action="SELECT")
        assert not bpy.ops.hnf.set_real_length.poll()
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    units = 3.0 * np.linalg.norm(corners[first] - corners[second])
    assert bpy.context.scene.hnf.metres_per_unit == pytest.approx(1.2 / units)


def test_the_panel_asks_for_a_length_until_there_is_one(imported) -> None:
    def texts() -> str:
        layout = drawn(HNF_PT_scale)
        assert layout is not None
        assert "hnf.set_real_length" in layout.operators
        return " ".join(text for text, _ in layout.texts)

    assert "no real-world size" in texts()
    bpy.context.scene.hnf.metres_per_unit = 0.25
    assert "no real-world size" not in texts()


def test_a_pen_draws_on_the_surface_through_its_ellipsoids(imported) -> None:
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    down, start = Vector((0.0, 0.0, -1.0)), Vector((0.3, 0.2, 5.0))
    assert is_cloud(scene.ray_cast(depsgraph, start, down)[4].original)
    hit = cast_on_surface(scene, depsgraph, None, start, down)
    assert hit is not None
    assert hit.obj == imported
    assert hit.world == pytest.approx((0.3, 0.2, 0.0), abs=1e-6)
    assert hit.normal == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert pick_object_along_ray(scene, depsgraph, None, start, down) == (imported, 0)
    assert cast_on_surface(scene, depsgraph, None, Vector((9.0, 0.0, 5.0)), down) is None
    shelf = add_plane("Shelf", 1.0)
    shelf.location = (0.3, 0.2, 1.0)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    above = cast_on_surface(scene, depsgraph, None, start, down)
    assert above is not None
    assert above.obj == shelf
    imported.hide_set(True)
    shelf.hide_set(True)
    assert cast_on_surface(scene, bpy.context.evaluated_depsgraph_get(), None, start, down) is None


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.floats(-100.0, 100.0)] * 3), st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(1e-3, 1e2))
def test_a_length_in_metres_is_that_length_after_scaling(point, way, length):
    assume(np.linalg.norm(way) > 1e-2)
    a, b = np.array(point), np.array(point) + np.array(way)
    scale = compute_metric_scale(a, b, length)
    assert np.linalg.norm(b * scale - a * scale) == pytest.approx(length, rel=1e-9)
    assert compute_metric_scale(b, a, length) == scale
    assert compute_metric_scale(2.0 * a, 2.0 * b, length) == pytest.approx(scale / 2.0, rel=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "length"),
    [
        ([0, 0, 0], [0, 0, 0], 1.0),
        ([1e6, 0, 0], [1e6 + 1e-3, 0, 0], 1.0),
        ([0, 0, 0], [1, 0, 0], 0.0),
        ([0, 0, 0], [1, 0, 0], -1.0),
        ([0, 0, 0], [1, 0, 0], np.nan),
        ([0, 0, 0], [1, 0, 0], 1e9),
        ([0, 0, 0], [1e-8, 0, 0], 1.0),
        ([0, 0, 0], [1e9, 0, 0], 1.0),
        ([0, 0, np.nan], [1, 0, 0], 1.0),
        ([0, 0], [1, 0], 1.0),
    ],
)
def test_a_length_that_says_nothing_is_refused(a, b, length):
    with pytest.raises(UsageError):
        compute_metric_scale(a, b, length)
