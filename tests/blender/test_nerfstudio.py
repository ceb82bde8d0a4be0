"""A nerfstudio export made here and opened again: the same surface, seen by the same cameras."""

from __future__ import annotations

import json
import shutil

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere
from closeup_builders import principled
from mathutils import Vector

from data_tools import nerfstudio_export
from data_tools.write_splats import write_inria
from hnf_blender.bridge import splat_reconstruction
from hnf_blender.bridge.cycles import read_camera
from hnf_blender.bridge.importers import CAMERA_COLLECTION, add_cameras, find_geometry, open_scene
from hnf_blender.bridge.splat_cloud import get_cloud
from hnf_core.errors import FileError, SceneError
from hnf_core.scene.camera import Camera
from hnf_core.scene.nerfstudio import NerfstudioFrame, read_transforms
from hnf_core.scene.splats.splat_file import read_splats

SPOT = np.array([0.021, -0.013, 0.012])
WIDTH, HEIGHT = 144, 96


def painted(name: str, colour):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = principled(material)
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    return material


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """A dark plate with a small bright red ball on it, exported; the ball stands off the middle."""
    folder = tmp_path_factory.mktemp("export")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_plane("Plate", 0.1).data.materials.append(painted("Dark", (0.01, 0.02, 0.05)))
    ball = add_sphere("Ball", 0.006, segments=24, rings=12)
    ball.data.materials.append(painted("Bright", (0.9, 0.05, 0.02)))
    ball.location = SPOT
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    words = [str(folder / "scene.blend"), "--out", str(folder / "out"), "--views", "3", "--samples", "4"]
    words += ["--spacing", "1.5e-3", "--width", str(WIDTH), "--height", str(HEIGHT)]
    assert nerfstudio_export.main(words) == 0
    return folder / "out"


@pytest.fixture
def copied(export, tmp_path):
    shutil.copytree(export, tmp_path / "out")
    return tmp_path / "out"


def codes_of(path) -> np.ndarray:
    """(H, W, 3) of 0 to 1, as they stand in the file."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(WIDTH * HEIGHT * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(HEIGHT, WIDTH, 4)[::-1, :, :3]


def test_splats_project_where_the_pictures_show_them(export) -> None:
    """The ball's middle in each picture is where the camera that was written and read says; its splats and depths
    agree with that."""
    splats = read_splats(export / "splat.ply")
    on_ball = np.linalg.norm(splats.means - SPOT, axis=1) < 0.0065
    assert on_ball.sum() > 100
    frames = read_transforms(export / "transforms.json")
    assert [frame.name for frame in frames] == ["frame_00001", "frame_00002", "frame_00003"]
    for frame in frames:
        picture = codes_of(export / frame.file_path)
        red = picture[..., 0] > 2.0 * picture[..., 2] + 0.1
        assert red.sum() > 20
        seen = np.argwhere(red)[:, ::-1].mean(axis=0) + 0.5
        uv, z = frame.camera.project(SPOT)
        assert np.abs(seen - uv).max() < 0.5
        splat_uv, splat_z = frame.camera.project(splats.means[on_ball].astype(float))
        assert np.abs(splat_uv.mean(axis=0) - uv).max() < 0.3
        column, row = np.floor(uv).astype(int)
        depth = codes_of(export / frame.depth_file_path)[..., 0] * 65.535
        assert depth[row, column] == pytest.approx(z - 0.006, abs=1e-3)
        assert splat_z.min() == pytest.approx(z - 0.006, abs=1e-3)


def test_the_export_opens_with_its_mesh_and_cameras(export) -> None:
    scene = open_scene(export / "transforms.json")
    meshes = [obj for obj in scene.objects if obj.type == "MESH"]
    assert len(meshes) == 1
    corners = np.array([meshes[0].matrix_world @ Vector(corner) for corner in meshes[0].bound_box])
    np.testing.assert_allclose(corners.min(axis=0), [-0.05, -0.05, 0.0], atol=1e-5)
    np.testing.assert_allclose(corners.max(axis=0), [0.05, 0.05, SPOT[2] + 0.006], atol=1e-4)
    assert meshes[0].data.materials[0] is not None  # that shows the points' colours
    cameras = [obj.name for obj in bpy.data.collections[CAMERA_COLLECTION].objects]
    assert cameras == ["frame_00001", "frame_00002", "frame_00003"]
    assert scene.camera.name == "frame_00001"
    frames = read_transforms(export / "transforms.json")
    assert (scene.render.resolution_x, scene.render.resolution_y) == (WIDTH, HEIGHT)
    for name, frame in zip(cameras, frames, strict=True):
        same_camera(read_camera(scene, scene.objects[name], 1.0), frame.camera)


def same_camera(found: Camera, expected: Camera) -> None:
    assert (found.kind, found.width, found.height) == (expected.kind, expected.width, expected.height)
    np.testing.assert_allclose(found.intrinsics, expected.intrinsics, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-6)


@pytest.mark.parametrize(("fl_x", "fl_y"), [(500.0, 500.0), (480.0, 520.0), (520.0, 480.0)])
@pytest.mark.parametrize(("width", "height"), [(640, 480), (300, 700)])
def test_a_lens_off_its_middle_comes_through_blender(fl_x, fl_y, width, height) -> None:
    bpy.context.scene.camera = None
    lens = np.array([[fl_x, 0.0, 0.45 * width], [0.0, fl_y, 0.6 * height], [0.0, 0.0, 1.0]])
    camera = Camera("perspective", width, height, lens, np.eye(4))
    add_cameras(bpy.context.scene, [NerfstudioFrame("images/a.png", camera)])
    bpy.context.view_layer.update()
    same_camera(read_camera(bpy.context.scene, bpy.context.scene.camera, 1.0), camera)


def test_splats_are_taken_where_no_mesh_has_colours(copied) -> None:
    transforms = copied / "transforms.json"
    assert find_geometry(transforms).name == "mesh.obj"
    (copied / "mesh.obj").unlink()
    assert find_geometry(transforms).name == "poisson_mesh.ply"
    (copied / "poisson_mesh.ply").unlink()
    assert find_geometry(transforms).name == "splat.ply"
    (copied / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert find_geometry(transforms).name == "splat.ply"
    (copied / "splat.ply").unlink()
    assert find_geometry(transforms).name == "mesh.obj"


def test_an_obj_with_a_picture_has_colours(copied) -> None:
    (copied / "poisson_mesh.ply").unlink()
    (copied / "mesh.obj").write_text("mtllib material_0.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert find_geometry(copied / "transforms.json").name == "splat.ply"
    (copied / "material_0.mtl").write_text("newmtl a\nmap_Kd material_0.png\n")
    assert find_geometry(copied / "transforms.json").name == "mesh.obj"
    (copied / "mesh.obj").write_text("mtllib ../material_0.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (copied.parent / "material_0.mtl").write_text("newmtl a\nmap_Kd material_0.png\n")
    assert find_geometry(copied / "transforms.json").name == "splat.ply"


def test_points_alone_are_refused_and_nothing_is_given_up(copied) -> None:
    for name in ("mesh.obj", "poisson_mesh.ply", "splat.ply"):
        (copied / name).unlink()
    kept = add_plane("Mine").name
    with pytest.raises(SceneError, match="points without faces"):
        open_scene(copied / "transforms.json")
    (copied / "point_cloud.ply").unlink()
    with pytest.raises(FileError, match="there is no geometry next to it"):
        open_scene(copied / "transforms.json")
    assert kept in bpy.data.objects


def test_another_json_is_refused_and_nothing_is_given_up(tmp_path) -> None:
    kept = add_plane("Mine").name
    (tmp_path / "settings.json").write_text(json.dumps({"a": 1}))
    with pytest.raises(FileError, match="no 'frames'"):
        open_scene(tmp_path / "settings.json")
    assert kept in bpy.data.objects


def test_splats_of_an_export_stand_upright_among_its_cameras(copied, monkeypatch) -> None:
    """Without the comment that says which way is up, nerfstudio's frame is z up all the same."""
    (copied / "mesh.obj").unlink()
    (copied / "poisson_mesh.ply").unlink()
    splats = read_splats(copied / "splat.ply")
    write_inria(copied / "splat.ply", splats)
    monkeypatch.setattr(splat_reconstruction, "DEFAULT_CELLS", 40)
    scene = open_scene(copied / "transforms.json")
    surface = next(obj for obj in scene.objects if get_cloud(obj) is not None)
    np.testing.assert_allclose(np.array(get_cloud(surface).matrix_world), np.eye(4), atol=1e-6)
    np.testing.assert_allclose(np.array(surface.matrix_world), np.eye(4), atol=1e-6)
    frames = read_transforms(copied / "transforms.json")
    same_camera(read_camera(scene, scene.camera, 1.0), frames[0].camera)
